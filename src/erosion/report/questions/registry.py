"""The questions by key, in the order of the page: a new one is a module and a line here."""

import types
from collections.abc import Callable, Mapping

from erosion.report.case import Answer, Case
from erosion.report.questions import a1, a2, a3, models, q1, q2, q3, q4, q5, q6, q7, q8, slips

QUESTIONS: Mapping[str, Callable[[Case], Answer]] = types.MappingProxyType(
    {
        "q1": q1.answer,
        "q2": q2.answer,
        "q3": q3.answer,
        "q4": q4.answer,
        "q5": q5.answer,
        "q6": q6.answer,
        "q7": q7.answer,
        "q8": q8.answer,
        "a1": a1.answer,
        "a2": a2.answer,
        "a3": a3.answer,
        "slips": slips.answer,
        "models": models.answer,
    }
)
