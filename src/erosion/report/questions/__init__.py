"""The scenario's questions and their registry; a question has a module that computes and a Markdown file."""

from erosion.report.questions.registry import QUESTIONS as QUESTIONS
from erosion.report.questions.registry import text_file as text_file
