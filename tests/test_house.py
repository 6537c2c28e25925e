"""Tests that other files name."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def functions_of(module: Path) -> set[str]:
    return {node.name for node in ast.parse(module.read_text("utf-8")).body if isinstance(node, ast.FunctionDef)}


def test_slow_tests_exist(entries_of_no_test):
    """`make durations` writes the table anew."""
    assert not entries_of_no_test


def test_no_name_of_a_test_holds_the_path_of_a_checkout(request):
    """It would have another name elsewhere, which `slow.txt` does not list."""
    assert not [test.nodeid for test in request.session.items if str(ROOT) in test.nodeid]


@pytest.mark.parametrize("page", ["docs/limits.md", "tests/promises.md"])
def test_tests_hold_each_row_of_a_page(page):
    text = (ROOT / page).read_text("utf-8").partition("## Known, and held by no test")[0]
    rows = re.findall(r"^- .*$", text, re.MULTILINE)
    assert rows
    for row in rows:
        tests = re.findall(r"`(tests/\S+\.py)::(test_\w+)`", row)
        benchmarks = re.findall(r"`(benchmarks/\S+\.py)`", row)
        assert tests or benchmarks, row
        assert all(test in functions_of(ROOT / file) for file, test in tests), row
        assert all((ROOT / file).is_file() for file in benchmarks), row


def test_the_readme_shows_what_the_commands_print(shell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = re.findall(
        r"^erosion ((?:run|optimum)\b.*?) +# (.*)$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE
    )
    assert len(lines) == 2
    for command, numbers in lines:
        printed = shell(command).out
        for number in re.findall(r"\d+\.\d+", numbers):
            assert number in printed, command
