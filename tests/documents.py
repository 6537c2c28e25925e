"""Command lines in the tests' own process, and the JSON document that every verb prints."""

import json
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

Shell = Callable[..., "Printed"]
Written = Callable[[str, str | bytes], Path]


class Printed(NamedTuple):
    """What a command printed."""

    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        return json.loads(self.out)

    @property
    def result(self) -> dict[str, Any]:
        """The document's result, its numbers without their units."""
        return _without_units(self.document["result"])


def run(words: str | Sequence[str], status: int, capsys: Any) -> Printed:
    """Run a command line as a shell does; it must end with this status, and say in one line what is wrong."""
    from erosion.cli import exit_status

    capsys.readouterr()
    assert exit_status(shlex.split(words) if isinstance(words, str) else words) == status, capsys.readouterr().err
    printed = Printed(*capsys.readouterr())
    if status == 2:
        *warnings, error = printed.err.splitlines()
        assert error.startswith("erosion: "), printed
        assert all(line.startswith(("warning: ", "note: ")) for line in warnings), printed
        assert printed.out == ""
    return printed


def result_of(text: str) -> dict[str, Any]:
    """The document's result, its numbers without their units."""
    return Printed(text, "").result


def findings(document: dict[str, Any], *codes: str) -> list[dict[str, Any]]:
    """The findings of a document with one of these codes; all of them without."""
    return [one for one in document["findings"] if not codes or one["code"] in codes]


def _without_units(value: Any) -> Any:
    if isinstance(value, dict):
        if value.keys() == {"value", "unit"}:
            return value["value"]
        return {name: _without_units(item) for name, item in value.items()}
    return [_without_units(item) for item in value] if isinstance(value, list) else value
