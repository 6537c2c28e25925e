"""The report, the advice and the exercise in German."""

import ast
import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import nbformat
import numpy as np
import polib
import pytest
from matplotlib.text import Text

import erosion
from erosion.advice.page import plot_advice, write_advice
from erosion.cli import _status
from erosion.exercises import AnswerKey, answer_key
from erosion.exercises.answer_key import IN_OTHER_UNITS, NO_NUMBER, SLIPS, TASKS, UNKNOWN_TASK
from erosion.fits import doubts
from erosion.fits.measurements import conditions, read_measurements
from erosion.fits.posterior_files import Draws
from erosion.joint_laws import Rows
from erosion.models import load_model
from erosion.output.translation import ENGLISH, Language, catalogue_path, language, languages
from erosion.parameters.materials import known_particles, known_targets, particle, target
from erosion.parameters.parameters import QUANTITIES, TABLE_1
from erosion.report import page, write_report
from erosion.report.questions import QUESTIONS, text_file

GERMAN = language("de")
TEXTS = [*(text_file(key) for key in QUESTIONS), text_file("q1").parent.parent / "phrases.md"]
ENGLISH_WORD = re.compile(r"\b(the|of|and|is|at|with|ends|by|rebound|stop|interior|jump|angle|volume|removed|for)\b")


NO_WORDS = re.compile(r"\{[{%#].*?[}%#]\}|\$\$.*?\$\$|\A## Derivation\Z", re.DOTALL)
CODE = re.compile(r"^```python.*?^```$", re.MULTILINE | re.DOTALL)


def message_blocks(source: str) -> list[str]:
    """The blocks of a text's file that hold words, which a catalogue is to translate."""
    in_formula, in_field = r"\\text\{[^}{]*[a-z]{3}", r'\{\{[^}]*"[^"]*[a-z] [a-z][^"]*"'
    blocks = [block.strip() for block in re.split(r"\n\s*\n", source)]
    return [
        block
        for block in blocks
        if re.search(in_formula, block)
        or re.search(in_field, block)
        or re.search(r"[^\W\d_]{2}", NO_WORDS.sub(" ", block))
    ]


TASK_BLOCKS = message_blocks(CODE.sub("", answer_key.TEXT.read_text("utf-8")))
SOURCE = Path(answer_key.__file__).parents[1]


def messages_of_code(path: Path) -> list[str]:
    """The messages that a module or a template gives to `say`, `text` or `_`."""
    source = path.read_text("utf-8")
    if path.suffix != ".py":
        return re.findall(r'\b_\("([^"]+)"\)', source)
    calls = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call) and node.args]
    names = [getattr(call.func, "attr", getattr(call.func, "id", "")) for call in calls]
    first = [call.args[0] for call, name in zip(calls, names, strict=True) if name in ("say", "text")]
    return [
        argument.value for argument in first if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
    ]


@pytest.mark.parametrize(
    "path",
    [
        *(SOURCE / "advice").glob("*.py"),
        *(SOURCE / "exercises").glob("*.py"),
        *SOURCE.glob("*/*.html"),
        answer_key.TEXT,
    ],
    ids=lambda path: f"{path.parent.name}/{path.name}",
)
def test_every_message_of_the_code_is_translated_with_its_fields(path: Path) -> None:
    messages = messages_of_code(path)
    assert [message for message in messages if message not in GERMAN.messages] == []
    for message in messages:
        fields = re.findall(r"\{\w+\}", message)
        assert sorted(fields) == sorted(re.findall(r"\{\w+\}", GERMAN.messages[message]))


def test_no_message_is_missing_or_fuzzy() -> None:
    catalogue = polib.pofile(str(catalogue_path("de")))
    assert [entry.msgid for entry in (*catalogue.untranslated_entries(), *catalogue.fuzzy_entries())] == []
    assert [block for block in TASK_BLOCKS if block not in GERMAN.messages] == []
    messages = [entry.msgid for entry in catalogue]
    assert [message for message in {*messages} if messages.count(message) > 1] == []


def test_german_intervals_have_semicolons_beside_decimal_commas() -> None:
    texts = GERMAN.messages.values()
    assert [interval for text in texts for interval in re.findall(r"\(\d[\d,]*, \d[\d,]*\)", text)] == []


def test_what_a_key_says_is_translated() -> None:
    assert GERMAN.text(page.ONE_CUT) != page.ONE_CUT
    assert [words for words in page.CUTS.values() if words not in GERMAN.messages] == []
    said = [words for task in TASKS.values() for words in (task.asks, task.hint) if " = " not in words]
    assert [
        words
        for words in (*said, *(slip for _, slip in SLIPS), IN_OTHER_UNITS, NO_NUMBER, UNKNOWN_TASK)
        if GERMAN.text(words) == words
    ] == []
    names = [*known_particles(), *known_targets()]
    assert [name for name in names if GERMAN.text(name) == name] == []
    key = AnswerKey(TABLE_1, "de")
    assert str(key.check("t_c", key.answer("t_c") * 1.0131)) == (
        "t_c: 1,3 % über der Lösung. Suchen Sie das Ende zwischen zwei Schritten, nicht bei einem Schritt."
    )
    assert str(key.check("volume", 100 * key.answer("volume"))) == (
        "volume: Das ist das 100-Fache der Lösung. Gesucht ist das abgetragene Volumen."
    )
    assert str(key.check("volume", 0.0254**3 * key.answer("volume"))) == (
        "volume: In m³ ist das richtig; geben Sie den Wert in in³ an."
    )
    with pytest.raises(ValueError, match="muss eine einzelne endliche Zahl sein; es ist '1,5'"):
        key.check("volume", "1,5")
    with pytest.raises(ValueError, match=r"muss eine dieser Aufgaben sein: omega, .*; es ist 'V'"):
        key.check("V", 1.5)


def test_the_german_notebook_is_german_and_its_code_the_same() -> None:
    german, english = (
        nbformat.reads(answer_key.notebook(AnswerKey(TABLE_1, lang), title="Table 1", solved=True), as_version=4)
        for lang in ("de", "en")
    )
    words = " ".join(cell.source for cell in german.cells if cell.cell_type == "markdown")
    assert ENGLISH_WORD.findall(re.sub(r"`[^`]*`|\$[^$]*\$|\*state[^*]*\*", "", words)) == []
    assert "Wie ein Korn schneidet: Tabelle 1" in words
    code = [[cell.source for cell in book.cells if cell.cell_type == "code"] for book in (german, english)]
    differ = [(of_german, of_english) for of_german, of_english in zip(*code, strict=True) if of_german != of_english]
    assert 'key = erosion.AnswerKey(p, lang="de")' in differ[0][0]
    assert all("label(" in of_german or '"""' in of_german for of_german, _ in differ[1:])


def test_the_german_advice_is_german(tmp_path: Path) -> None:
    advice = erosion.advise(
        TABLE_1.to("si").replace(v0=100.0), particle="garnet 0.3 mm", target="aluminium 6061", models=["linearized"],
        speed_spread=0.1, cutting_fraction=1.0,
    )  # fmt: skip
    advice = dataclasses.replace(advice, outside=("oka is used outside of the range that it is made for: "
                                                  "speeds from 50 m/s to 167 m/s.",))  # fmt: skip
    page_text = write_advice(advice, tmp_path / "advice.html", "de").read_text("utf-8")
    body = page_text[page_text.index("<body>") : page_text.index("<footer>")]
    words = re.sub(r"<[^>]+>", " ", re.sub(r"<svg.*?</svg>", " ", body, flags=re.DOTALL))
    assert ENGLISH_WORD.findall(words) == []
    assert re.findall(r"\d\.\d", re.sub("„erosion .*?“", "", words)) == []  # commands are typed as they are
    assert "Granat 0,3 mm, Aluminium 6061, 100\N{NO-BREAK SPACE}m/s" in words
    assert "oka wird außerhalb des Bereichs verwendet" in words
    assert "liegt weit außerhalb dessen, was Versuche" in words
    figure = plot_advice(dataclasses.replace(advice, language=GERMAN))
    assert ENGLISH_WORD.findall(" ".join(text.get_text() for text in figure.findobj(Text))) == []
    english = write_advice(advice, tmp_path / "advice.html").read_text("utf-8")
    assert "Garnet 0.3 mm on aluminium 6061 at 100 m/s" in english


DOUBTS = {
    "fitted.toml: AICc needs at least 6 rows for so many parameters, but there are 5: the models are in the order of "
    "their residuals' variance. Measure more, or free fewer parameters.": "mindestens 6 Zeilen, es sind 5",
    "The data do not decide between k, psi and e: fix one of them, or measure at 10°. Measure more, or free fewer "
    "parameters.": "zwischen k, psi und e: Legen Sie einen davon fest, oder messen Sie bei 10°. Messen Sie mehr",
    "rows.csv: 160.5 g/kg is far from what tests on ductile metals find at 112 m/s, about 0.13 to 1.3 g/kg (fits to "
    "tests: DNVGL-RP-O501, 2015, table 3-1).": "rows.csv: 160,5 g/kg liegt",
    "fitted.toml: 120 m/s is 1.33 × the fastest test.": "120 m/s: das 1,33-Fache des schnellsten Versuchs.",
    "post.nc: 35% of the draws of k lie in the lowest hundredth of its prior, normal(2, 0.2): prior and data disagree, "
    "or the prior is too narrow.": "35 % der Ziehungen von k liegen im untersten Hundertstel der A-priori-Verteilung "
    "normal(2, 0.2): Sie",
    "post.nc: k has no influence on these data and cannot be determined. Its draws are those of the prior.": "Seine",
    "post.nc: k and psi cannot be told apart: only k/psi is determined. How far the ridge goes, the priors say.": "Wie",
    "post.nc: The uncertainties do not explain the misfit: χ² is 12.5 for 12 rows. The intervals hold only if the "
    "model were right.": "χ² ist 12,5 bei 12 Zeilen. Die Intervalle gelten nur",
}


@pytest.mark.parametrize("path", ["my fits/f.toml", r"C:\fits\my.toml", r"D:\my fits\post.nc", "a.b/rows 2.csv", "oka"])
def test_a_doubt_begins_with_any_path(path: str) -> None:
    doubt = f"{path}: The errors and intervals hold only if the model were right."
    said = f"{path}: Fehler und Intervalle gelten nur, wenn das Modell richtig wäre."
    assert GERMAN.sentences(f"{doubt} Fix it. {doubt}") == f"{said} Legen Sie den Wert fest. {said}"


@pytest.mark.parametrize("doubt", DOUBTS)
def test_doubts_that_a_case_file_keeps_are_translated(doubt: str) -> None:
    said = GERMAN.sentences(doubt)
    assert DOUBTS[doubt] in said
    assert ENGLISH_WORD.findall(said) == []
    assert GERMAN.sentences(f"Nobody says 1.5. {doubt} Nor this") == f"Nobody says 1.5. {said} Nor this"
    assert ENGLISH.sentences(doubt) == doubt


def test_every_doubt_on_draws_is_translated() -> None:
    rows, own = Rows(columns={"r": np.ones(2)}), "energy_ratio = 3"
    draws = Draws(rows, Path("post.nc"), "", own, "", TABLE_1, 1.0, has_scale=True, converged=False)
    model = load_model("linearized-deformation")
    said = draws.doubts(model, TABLE_1.replace(k=1.5, psi=0.1, sigma=3e5), 0.5)
    assert len(said) == 7
    assert [ENGLISH_WORD.findall(GERMAN.sentences(doubt)) for doubt in said] == [[]] * 7
    assert GERMAN.sentences(said[1]) == "post.nc: Die Ziehungen gelten für k = 2, aber der Fall hat 1,5."


def test_places_of_two_numbers_have_no_english_word() -> None:
    rows = {"angle [deg]": [20, 40, 20, 40], "speed [m/s]": [60, 60, 90, 90], "erosion [mg/kg]": [5, 8, 7, 9]}
    data = read_measurements(rows, "si")
    worst = doubts.worst_row(data, np.zeros(4), conditions(data))
    forward = SimpleNamespace(free=(), predict_many=lambda allowed, at: (at["alpha"], 2 * at["alpha"]))
    problem: Any = SimpleNamespace(forward=forward, data=data)
    remedy = doubts.advise(problem, ["k"], np.zeros((2, 1)), 0.01)
    scatter = "The residuals are 1, the rows scatter about a smooth curve by 2 (probability 3):"
    assert GERMAN.sentences(f"{remedy} {scatter} {worst}.") == (
        "Legen Sie den Wert fest, oder messen Sie bei 85°, v₀ = 60 m/s. Die Residuen betragen 1, die Zeilen streuen um "
        "eine glatte Kurve mit 2 (Wahrscheinlichkeit 3): Bei 40°, v₀ = 90 m/s ergibt der Fit 0 mg/kg, die Daten "
        "ergeben 9 mg/kg."
    )


def test_the_sentences_of_a_fit_that_are_translated_are_those_of_the_code() -> None:
    trees = [ast.parse(path.read_text("utf-8")) for path in SOURCE.rglob("*.py")]
    texts = [node.value for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    said = "\n".join(text for text in texts if isinstance(text, str)).casefold()
    entries = [entry.msgid for entry in polib.pofile(str(catalogue_path("de"))) if ("fits", "") in entry.occurrences]
    assert len(entries) > 50
    pieces = {piece.strip().casefold() for message in entries for piece in re.split(r"\{\w+\}|[:;,.()]| or ", message)}
    assert [piece for piece in pieces if len(piece) > 12 and piece not in said] == []


def test_sources_of_materials_are_translated_but_for_titles() -> None:
    titles = r"What is the specific gravity of copper slag|Handbook of \w+ and \w+|Department of \w+"
    sources = {particle(f"{name} 1 mm").source for name in known_particles()} | {
        target(name).source for name in known_targets()
    }
    words = " ".join(re.sub(titles, "", GERMAN.cited(source)) for source in sources)
    assert re.findall(rf"{ENGLISH_WORD.pattern}|\b(?:density|hardness|annealed|to|least|table)\b", words) == []


@pytest.mark.parametrize("verb", ["advise", "exercise", "report"])
def test_an_unknown_language_is_refused_before_anything_is_computed(
    verb: str, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    name = tmp_path / {"advise": "a.html", "exercise": "a.ipynb", "report": "r"}[verb]
    assert languages() == ["en", "de"]
    assert _status([verb, "--lang", "fr", "-o", str(name)]) == 2
    assert capsys.readouterr().err == "erosion: Option `--lang` must be one of en, de, but is 'fr'.\n"
    assert not name.exists()


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.stem)
def test_every_block_of_every_text_is_translated(path: Path) -> None:
    blocks = message_blocks(path.read_text("utf-8"))
    assert blocks
    assert [block for block in blocks if block not in GERMAN.messages] == []


def test_the_catalogue_has_no_translation_of_what_is_no_longer_there() -> None:
    blocks = {block for path in TEXTS for block in message_blocks(path.read_text("utf-8"))}
    blocks |= set(TASK_BLOCKS)
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
    assert "das 1,175-Fache des Werts bei 20°" in words
    assert [label for label in labels if ENGLISH_WORD.search(label) or re.search(r"\d\.\d", label)] == []
    assert "Winkel des größten Abtrags" in " ".join(labels)
    # Numbers are read by programs: they are the same in all languages.
    assert '"ended_by": "rebound"' in (tmp_path / "numbers.json").read_text("utf-8")
