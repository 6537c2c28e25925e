"""The questions by key, in the order of the page: a new one is a module and a line here."""

import types
from collections.abc import Callable, Mapping

from erosion.report.case import Answer, Case
from erosion.report.questions import q1, q2, q3, q4

QUESTIONS: Mapping[str, Callable[[Case], Answer]] = types.MappingProxyType(
    {"q1": q1.answer, "q2": q2.answer, "q3": q3.answer, "q4": q4.answer}
)
