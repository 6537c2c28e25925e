"""Sizes that CONTRIBUTING.md asks for, and tests that other files name."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import erosion

ROOT = Path(__file__).parents[1]
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


def test_a_test_holds_each_known_limit():
    rows = [row for row in (ROOT / "docs" / "limits.md").read_text("utf-8").splitlines() if row.startswith("| ")]
    limits = [row for row in rows if not row.startswith("| limit |")]
    assert limits
    for limit in limits:
        file, test = re.findall(r"`(tests/\S+\.py)::(test_\w+)`", limit)[0]
        assert test in {function.name for function in functions(ROOT / file)}, limit
