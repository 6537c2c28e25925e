"""The questions by key, in the order of the page: a new one is a module, a text beside it and a line here."""

import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from erosion.report.case import Answer, Need, ReportCase
from erosion.report.questions import a1, a2, a3, models, q1, q2, q3, q4, q5, q6, q7, q8, slips


class Question(NamedTuple):
    """The function that answers a question, and the results that it needs, which can be computed before."""

    answer: Callable[[ReportCase], Answer]
    needs: tuple[Need, ...] = ()


QUESTIONS: Mapping[str, Question] = types.MappingProxyType(
    {
        "q1": Question(q1.answer),
        "q2": Question(q2.answer),
        "q3": Question(q3.answer),
        "q4": Question(q4.answer),
        "q5": Question(q5.answer, q5.NEEDS),
        "q6": Question(q6.answer, q6.NEEDS),
        "q7": Question(q7.answer, q7.NEEDS),
        "q8": Question(q8.answer, q8.NEEDS),
        "a1": Question(a1.answer, a1.NEEDS),
        "a2": Question(a2.answer, a2.NEEDS),
        "a3": Question(a3.answer, a3.NEEDS),
        "slips": Question(slips.answer, slips.NEEDS),
        "models": Question(models.answer, models.NEEDS),
    }
)


def text_file(key: str) -> Path:
    """The Markdown file with a question's text."""
    return Path(__file__).with_name(f"{key}.md")
