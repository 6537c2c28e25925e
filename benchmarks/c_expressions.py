"""A problem's expressions as C: what they compute is recorded, differentiated, and written out."""

import types
from collections.abc import Mapping, Sequence
from typing import Any, Union

Term = Union["Recorded", float]


class Recorded:
    """A number that an expression has computed.

    Args:
        operation: one of "+", "-", "*", "/", "exp", or what C calls a number that is given.
        of: the numbers it is computed from.
    """

    def __init__(self, operation: str, *of: Term) -> None:
        self.operation, self.of = operation, of

    def __add__(self, other: Term) -> Term:
        return _made("+", self, other)

    def __radd__(self, other: Term) -> Term:
        return _made("+", other, self)

    def __sub__(self, other: Term) -> Term:
        return _made("-", self, other)

    def __rsub__(self, other: Term) -> Term:
        return _made("-", other, self)

    def __mul__(self, other: Term) -> Term:
        return _made("*", self, other)

    def __rmul__(self, other: Term) -> Term:
        return _made("*", other, self)

    def __truediv__(self, other: Term) -> Term:
        return _made("/", self, other)

    def __rtruediv__(self, other: Term) -> Term:
        return _made("/", other, self)

    def __neg__(self) -> Term:
        return _made("*", -1.0, self)


def _made(operation: str, a: Term, b: Term) -> Term:
    """A number of two, without what adds nothing and multiplies by one."""
    if not isinstance(a, Recorded) and not isinstance(b, Recorded):
        return {"+": a + b, "-": a - b, "*": a * b, "/": a / (b or 1.0)}[operation]
    zero_a, zero_b = a == 0.0 if isinstance(a, float) else False, b == 0.0 if isinstance(b, float) else False
    if operation in "+-" and zero_b:
        return a
    if operation == "+" and zero_a:
        return b
    if operation == "*" and (zero_a or zero_b):
        return 0.0
    if operation == "/" and zero_a:
        return 0.0
    if operation == "*" and a == 1.0:
        return b
    if operation in "*/" and b == 1.0:
        return a
    return Recorded(operation, a, b)


def _exp(x: Term) -> Term:
    return Recorded("exp", x)


RECORDED = types.SimpleNamespace(exp=_exp)
"""The functions of expressions that are recorded."""


def given(name: str, count: int) -> list[Recorded]:
    """The numbers of a C array."""
    return [Recorded(f"{name}[{i}]") for i in range(count)]


def tangents(outputs: Sequence[Term], seeds: Mapping[Recorded, Term]) -> list[Term]:
    """The derivatives of outputs along those of given numbers."""
    known: dict[Term, Term] = dict(seeds)

    def of(term: Term) -> Term:
        if not isinstance(term, Recorded):
            return 0.0
        if term not in known:
            parts = [of(part) for part in term.of]
            known[term] = _tangent(term, parts) if parts else 0.0
        return known[term]

    return [of(output) for output in outputs]


def _tangent(term: Recorded, by: Sequence[Term]) -> Term:
    if term.operation == "exp":
        return term * by[0]
    (a, b), (da, db) = term.of, by
    match term.operation:
        case "+":
            return _made("+", da, db)
        case "-":
            return _made("-", da, db)
        case "*":
            return _made("+", _made("*", da, b), _made("*", a, db))
        case "/":
            return _made("/", _made("-", da, _made("*", term, db)), b)
    raise NotImplementedError(term.operation)


def function(head: str, outputs: Mapping[str, Term], *, returns: str = "") -> str:
    """A C function of a head that sets outputs, by what C calls them; or `returns` one of them."""
    lines: list[str] = []
    names: dict[Recorded, str] = {}

    def name(term: Any) -> str:
        if not isinstance(term, Recorded):
            return repr(float(term))
        if not term.of:
            return term.operation
        if term not in names:
            parts = [name(part) for part in term.of]
            value = f"exp({parts[0]})" if term.operation == "exp" else f" {term.operation} ".join(parts)
            names[term] = f"v{len(names)}"
            lines.append(f"  const double {names[term]} = {value};")
        return names[term]

    sets = [f"  {target} = {name(term)};" for target, term in outputs.items()]
    if returns:
        sets = [f"  double {sets[0].strip()}", f"  return {returns};"]
    return "\n".join([head, "{", *lines, *sets, "}"])
