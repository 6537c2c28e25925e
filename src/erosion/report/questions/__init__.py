"""The scenario's questions in two chapters. The Markdown file of a question tells what its chapter computes."""

import types
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from erosion.report.case import Answer, Need, ReportCase
from erosion.report.questions import additional, linearized


class Question(NamedTuple):
    """The function that answers a question, and the results that it needs, which can be computed before."""

    answer: Callable[[ReportCase], Answer]
    needs: tuple[Need, ...] = ()


QUESTIONS: Mapping[str, Question] = types.MappingProxyType(
    {
        "q1": Question(linearized.solutions),
        "q2": Question(linearized.end_of_cut),
        "q3": Question(linearized.removed_volume),
        "q4": Question(linearized.best_angle, linearized.NEEDS_OF_BEST),
        "q5": Question(linearized.speeds, linearized.NEEDS),
        "q6": Question(linearized.sizes_and_masses, linearized.NEEDS),
        "q7": Question(linearized.materials, linearized.NEEDS),
        "q8": Question(linearized.guesses, linearized.NEEDS),
        "a1": Question(additional.body_may_turn, additional.NEEDS),
        "a2": Question(additional.ratio_is_tan_alpha, additional.NEEDS_OF_TAN_ALPHA),
        "a3": Question(additional.force_opposes_motion, additional.NEEDS_OF_PAIRS),
        "slips": Question(additional.slips, additional.NEEDS_OF_READINGS),
        "models": Question(additional.all_models, additional.NEEDS_OF_MODELS),
    }
)
"""By key, in the order of the page: a new question is a function, a text in this folder and a line here."""


def text_file(key: str) -> Path:
    """The Markdown file with a question's text."""
    return Path(__file__).with_name(f"{key}.md")
