"""Sizes that CONTRIBUTING.md asks for."""

import ast
from collections.abc import Iterator
from pathlib import Path

import erosion

SOURCE = Path(erosion.__file__).parent
MODULES = sorted(SOURCE.rglob("*.py"))


def functions(module: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node


def test_modules_and_functions_are_short():
    long = []
    for module in MODULES:
        lines = len(module.read_text("utf-8").splitlines())
        long += [f"{module}: {lines} lines"] if lines > 600 else []
        for function in functions(module):
            lines = (function.end_lineno or 0) - function.lineno + 1
            # Options that are given by name alone are no burden to who calls without them.
            given = [a.arg for a in (*function.args.posonlyargs, *function.args.args) if a.arg not in ("self", "cls")]
            if lines > 90 or len(given) > 7:
                long.append(f"{module}, {function.name}: {lines} lines, {len(given)} parameters by position")
    assert not long


def test_slow_tests_exist(entries_of_no_test):
    """`make durations` writes the table anew."""
    assert not entries_of_no_test
