"""The scenario's questions, each a module that computes and a Markdown file that tells, and the registry of them."""

from erosion.report.questions.registry import QUESTIONS as QUESTIONS
from erosion.report.questions.registry import text_file as text_file
