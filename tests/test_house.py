"""Tests that other files name."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]


def functions_of(module: Path) -> set[str]:
    return {node.name for node in ast.parse(module.read_text("utf-8")).body if isinstance(node, ast.FunctionDef)}


def test_slow_tests_exist(entries_of_no_test):
    """`make durations` writes the table anew."""
    assert not entries_of_no_test


def test_no_name_of_a_test_holds_the_path_of_a_checkout(request):
    """It would have another name elsewhere, which `slow.txt` does not list."""
    assert not [test.nodeid for test in request.session.items if str(ROOT) in test.nodeid]


def test_a_test_holds_each_known_limit():
    rows = [row for row in (ROOT / "docs" / "limits.md").read_text("utf-8").splitlines() if row.startswith("| ")]
    limits = [row for row in rows if not row.startswith("| limit |")]
    assert limits
    for limit in limits:
        file, test = re.findall(r"`(tests/\S+\.py)::(test_\w+)`", limit)[0]
        assert test in functions_of(ROOT / file), limit
