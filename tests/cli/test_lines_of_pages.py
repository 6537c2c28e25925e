"""The command lines that pages show: the parser knows each verb, option and kind of value. None of them computes."""

import re
import shlex
from pathlib import Path

import cyclopts
import pytest

from erosion.cli import app
from erosion.cli.errors import InputError

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md"), *ROOT.glob("docs/develop/*.md")]


def lines_of(text: str) -> list[str]:
    """Those in blocks of code, and those within a sentence."""
    block = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
    blocks = "".join(block.findall(text)).replace("\\\n", " ")
    shown = re.findall(r"^(?:\$ )?(erosion .*)$", blocks, re.MULTILINE)
    return shown + re.findall(r"`(erosion [a-z]+[^`]*)`", block.sub("", text))


def words_of(line: str) -> list[str]:
    """The verb and its arguments, without comments and what a pipe leads to; an ellipsis stays for a file."""
    _, *words = shlex.split(re.split(r" \\?\| ", line)[0].replace("\n", " "), comments=True)
    return words if len(words) > 1 else [*words, "--help"]  # a verb that is only named


LINES = [
    pytest.param(words_of(line), id=f"{page.name}: {' '.join(line.split())}")
    for page in PAGES
    for line in lines_of(page.read_text("utf-8"))
]


def test_most_lines_are_found() -> None:
    assert len(LINES) > 60


def test_an_option_that_a_sentence_names_is_one_of_a_verb() -> None:
    verbs = [app[name] for name in app if not name.startswith("-")]
    known = {name for verb in verbs for option in verb.assemble_argument_collection() for name in option.names}
    named = {name for page in PAGES for name in re.findall(r"`(--[a-z0-9-]+)", page.read_text("utf-8"))}
    assert named - known == set()


@pytest.mark.parametrize("words", LINES)
def test_a_line_of_a_page_is_a_command(words: list[str]) -> None:
    try:
        app.parse_args(words, exit_on_error=False, print_error=False)
    except (cyclopts.CycloptsError, InputError) as error:
        pytest.fail(str(error))
