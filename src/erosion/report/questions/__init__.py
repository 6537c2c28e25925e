"""The scenario's questions, one a file, and the registry of them."""

from erosion.report.questions.registry import QUESTIONS as QUESTIONS
