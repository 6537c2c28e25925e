"""The code of tests/golden-numbers.md: its tables against a second solver, and against the package."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "golden-numbers.md"


@pytest.mark.slow
def test_the_golden_numbers_are_those_of_two_solvers(monkeypatch: pytest.MonkeyPatch) -> None:
    code = "\n".join(re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL))
    assert code.count("assert ") > 15
    monkeypatch.chdir(PAGE.parent)  # the page reads its own tables
    exec(compile(code, str(PAGE), "exec"), {})
