"""Sizes that CONTRIBUTING.md asks for."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import erosion

SOURCE = Path(erosion.__file__).parent
MODULES = sorted(SOURCE.rglob("*.py"))


def functions(module: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node


@pytest.mark.parametrize("module", MODULES, ids=lambda module: str(module.relative_to(SOURCE)))
def test_modules_and_functions_are_short(module: Path):
    assert len(module.read_text("utf-8").splitlines()) <= 400
    for function in functions(module):
        lines = (function.end_lineno or 0) - function.lineno + 1
        assert lines <= 60, f"{function.name} has {lines} lines"
        # Options that are given by name alone are no burden to who calls without them.
        given = [a.arg for a in (*function.args.posonlyargs, *function.args.args) if a.arg not in ("self", "cls")]
        assert len(given) <= 7, f"{function.name} has {len(given)} parameters by position"
