"""One protocol of progress for every verb, and the bar that shows it."""

import inspect
import io

import pytest

import erosion
from erosion.arguments import Progress, no_progress
from erosion.cli.output import progress_bar
from erosion.report.page import write_report


class Terminal(io.StringIO):
    """A text that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("verb", [erosion.sweep, erosion.stream, erosion.rank_models, erosion.verify, write_report])
def test_every_verb_reports_its_progress_in_the_same_way(verb):
    argument = inspect.signature(verb).parameters["progress"]
    assert argument.annotation == Progress
    assert argument.default is no_progress
    assert argument.kind is inspect.Parameter.KEYWORD_ONLY


def test_the_bar_shows_the_work_and_how_much_of_it_is_done(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    with progress_bar("reading") as progress:
        progress("fitting finnie", 1, 4)
    assert "fitting finnie" in terminal.getvalue()
    assert "25%" in terminal.getvalue()


def test_without_a_terminal_no_bar_is_shown(monkeypatch):
    file = io.StringIO()
    monkeypatch.setattr("sys.stderr", file)
    with progress_bar("reading") as progress:
        progress("fitting finnie", 1, 4)
    assert file.getvalue() == ""
