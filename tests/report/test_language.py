"""The report in German."""

import re
from pathlib import Path
from typing import Any

import polib
import pytest
from matplotlib.text import Text

from erosion.cli import _status
from erosion.parameters.parameters import QUANTITIES, TABLE_1
from erosion.report import page, write_report
from erosion.report.language import ENGLISH, Language, catalogue_path, language, languages, message_blocks
from erosion.report.questions import QUESTIONS, text_file

GERMAN = language("de")
TEXTS = [*(text_file(key) for key in QUESTIONS), text_file("q1").parent.parent / "phrases.md"]
ENGLISH_WORD = re.compile(r"\b(the|of|and|is|at|with|ends|by|rebound|stop|interior|jump|angle|volume|removed|for)\b")


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_every_block_of_every_text_is_translated(path: Path) -> None:
    blocks = message_blocks(path.read_text("utf-8"))
    assert blocks
    assert [block for block in blocks if block not in GERMAN.messages] == []


def test_the_catalogue_has_no_translation_of_what_is_no_longer_there() -> None:
    blocks = {block for path in TEXTS for block in message_blocks(path.read_text("utf-8"))}
    entries = polib.pofile(str(catalogue_path("de"))).translated_entries()
    of_files = {entry.msgid for entry in entries if any(file.endswith(".md") for file, _ in entry.occurrences)}
    assert of_files - blocks == set()


def names_in_fields(text: str) -> list[str]:
    """The names in a text's fields, in any order; words in quotes may be translated."""
    inside = " ".join(field for pair in re.findall(r"\{\{(.*?)\}\}|\{%(.*?)%\}", text) for field in pair)
    return sorted(re.findall(r"\b[a-z_]+\b", re.sub(r'"[^"]*"', "", inside)))


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_a_translation_has_the_fields_and_figures_of_its_text(path: Path) -> None:
    for block in message_blocks(path.read_text("utf-8")):
        translated = GERMAN.messages[block]
        assert names_in_fields(block) == names_in_fields(translated), block
        assert re.findall(r"\]\(([^)]*)\)", block) == re.findall(r"\]\(([^)]*)\)", translated)


def test_parameters_and_parts_are_translated() -> None:
    for quantity in QUANTITIES.values():
        assert GERMAN.text(quantity.meaning) != quantity.meaning
    assert GERMAN.text("Question 4") == "Frage 4"
    assert GERMAN.text("this case, 20.5°") == "dieser Fall, 20,5°"
    assert GERMAN.text("ends by rebound") == "endet durch Abprall"
    assert GERMAN.text("nobody knows 3") == "nobody knows 3"


def test_numbers_have_decimal_commas_where_the_language_has() -> None:
    assert GERMAN.number("2.9766 mm³, 1.5 to 2.25") == "2,9766 mm³, 1,5 to 2,25"
    assert GERMAN.number_tex(r"1.5\times 10^{-3}") == r"1{,}5\times 10^{-3}"
    assert ENGLISH.number("2.5") == "2.5"
    assert ENGLISH.number_tex("2.5") == "2.5"


def test_english_texts_stay_as_they_are() -> None:
    source = text_file("q4").read_text("utf-8")
    assert ENGLISH.template(source) == source
    assert Language("xx", {"# Title": "# Titel"}).template("# Title\n\nRest.\n") == "# Titel\n\nRest.\n"


def test_an_unknown_language_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert languages() == ["en", "de"]
    assert _status(["report", "--lang", "fr", "-o", str(tmp_path / "r")]) == 2
    assert capsys.readouterr().err == "erosion: Option `--lang` must be one of en, de, but is 'fr'.\n"
    assert not (tmp_path / "r").exists()


@pytest.mark.slow
def test_the_german_page_and_its_figures_are_german(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    labels: list[str] = []
    translate = page.translate_figure

    def collect(figure: Any, of: Language) -> None:
        translate(figure, of)
        labels.extend(text.get_text() for text in figure.findobj(Text))

    monkeypatch.setattr(page, "translate_figure", collect)
    only = ["q1", "q2", "q3", "q4", "q5", "q8", "a3", "slips"]
    written = write_report(TABLE_1, tmp_path, only=only, lang="de").read_text("utf-8")
    assert '<html lang="de"' in written
    body = written[written.index("<body>") : written.index("<footer>")]
    words = re.sub(r"<[^>]+>", " ", re.sub(r"<(svg|math).*?</\1>", " ", body, flags=re.DOTALL))
    assert ENGLISH_WORD.findall(words) == []
    assert re.findall(r"\d\.\d", words) == []
    assert "<mn>31,717474411</mn>" in written
    assert "das 1,175-fache des Werts bei 20°" in words
    assert [label for label in labels if ENGLISH_WORD.search(label) or re.search(r"\d\.\d", label)] == []
    assert "Winkel des größten Abtrags" in " ".join(labels)
    # Numbers are read by programs: they are the same in all languages.
    assert '"ended_by": "rebound"' in (tmp_path / "numbers.json").read_text("utf-8")
