"""The report: right numbers for any case, one whole page that needs nothing else, safe files."""

import base64
import csv
import html
import io
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fontTools.ttLib import TTFont

from erosion.impacts.trajectory import path
from erosion.models import BUILT_IN, load_model
from erosion.models.rigid import LinearizedCut
from erosion.parameters.parameters import TABLE_1
from erosion.parameters.per_mass import PerMass
from erosion.report import write_report
from erosion.report.case import Answer, ReportCase
from erosion.report.page import Text, write_text
from erosion.report.questions import QUESTIONS, additional, text_file

CLOSED = LinearizedCut()
INCH3 = 0.0254**3  # m³
UNUSUAL = TABLE_1.replace(k=12.0, psi=0.003, alpha=np.deg2rad(50), phidot0=0.4 * TABLE_1.v0 / TABLE_1.r)
CASES = {
    "Table 1": TABLE_1,
    "unusual": UNUSUAL,
    "SI, ended by a stop": TABLE_1.to("si").replace(alpha=np.pi / 3),
    "without jumps": TABLE_1.to("si").replace(v0=10.0),
}


ONE_IMPACT = ["q1", "q2", "q3", "q4"]  # without the families, whose figures take most of the time
ASKED = {"Table 1": None, "SI, ended by a stop": [*ONE_IMPACT, "q8"], "without jumps": [*ONE_IMPACT, "a1"]}
TURNING = ("linearized", "finnie", "rotating", "rotating-tan-alpha", "rotating-deformation", "as-printed")
TEXTS: dict[str, list[Text]] = {}  # of each case's report, as they were written


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The folder of each case's report: whole, or on questions of the linearized model."""
    folders = {}
    for name, p in CASES.items():
        folder, TEXTS[name] = tmp_path_factory.mktemp("report") / "new", []

        def kept(*content: Any, name: str = name) -> Text:
            TEXTS[name].append(write_text(*content))
            return TEXTS[name][-1]

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("erosion.report.page.write_text", kept)
            folders[name] = write_report(p, folder, case_name=name, only=ASKED.get(name, ONE_IMPACT)).parent
    return folders


@pytest.fixture(scope="module")
def whole(reports: dict[str, Path]) -> Path:
    """The folder of Table 1's whole report."""
    return reports["Table 1"]


@pytest.fixture(scope="module")
def page(whole: Path) -> str:
    return index(whole)


def index(folder: Path) -> str:
    return (folder / "index.html").read_text(encoding="utf-8")


def numbers(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "numbers.json").read_text(encoding="utf-8"))


def test_at_the_cusp_both_events_coincide(tmp_path: Path) -> None:
    cusp = TABLE_1.replace(k=1.0, alpha=np.arctan(0.5))
    page = write_report(cusp, tmp_path, case_name="cusp", only=["q2"]).read_text(encoding="utf-8")
    assert "both events coincide" in page
    assert "still moving forward" not in page


@pytest.mark.parametrize("name", CASES)
def test_numbers_are_those_of_the_closed_forms(reports: dict[str, Path], name: str) -> None:
    p, record = CASES[name], numbers(reports[name])
    q1, q2, q3, q4 = (record["answers"][key] for key in ("q1", "q2", "q3", "q4"))
    k, alpha = float(p.k), float(p.alpha)
    omega = np.sqrt(k * p.sigma * p.b * p.psi / p.m)
    assert q1["omega"] == pytest.approx(omega, rel=1e-14)
    assert q1["y_amplitude"] == pytest.approx(p.v0 * np.sin(alpha) / omega, rel=1e-14)
    assert q1["x_slope"] == pytest.approx(p.v0 * (np.cos(alpha) - np.sin(alpha) / k), rel=1e-13)
    # The solver works to 1e-12 a step.
    assert q1["largest_difference"]["y"] < 1e-10 * q1["y_amplitude"]

    stops = np.tan(alpha) > k / 2
    t_c = (np.arccos(1 - k / np.tan(alpha)) if stops else np.pi) / omega
    assert q2["t_c"] == pytest.approx(t_c, rel=1e-12)
    assert q2["t_c_numerical"] == pytest.approx(t_c, rel=1e-10)
    assert q2["ended_by"] == q2["ended_by_numerical"] == ("stop" if stops else "rebound")
    assert (q2["candidates"]["stop"] is not None) == stops
    assert q2["cusp"] == pytest.approx(np.arctan(k / 2), rel=1e-15)

    scale = p.m * p.v0**2 / (p.sigma * p.psi)
    below = (np.sin(2 * alpha) - 2 / k * np.sin(alpha) ** 2) / k
    volume = scale * (np.cos(alpha) ** 2 / 2 if stops else below)
    assert q3["volume"] == pytest.approx(volume, rel=1e-13)
    assert q3["volume_numerical"] == pytest.approx(volume, rel=1e-10)
    assert q3["volume_from_speeds"] == pytest.approx(volume, rel=1e-10)
    errors = [q3["volume_midpoint"][n] / volume - 1 for n in ("10", "100", "1000")]
    # Its error is -h²/24 times the difference of the integrand's slope b(ẏẋ + yẍ) at both ends.
    x_slowing, end = -p.sigma * p.b * p.psi / p.m, CLOSED.state(t_c, p)
    slopes = p.b * (end.vy * end.vx + x_slowing * end.y**2 - p.v0**2 * np.sin(alpha) * np.cos(alpha))
    assert errors[1] == pytest.approx(float(-((t_c / 100) ** 2) / 24 * slopes / volume), rel=0.01)
    # Second order: ten times the panels, a hundredth of the error.
    assert errors[0] < 0.02
    assert errors[0] / errors[1] == pytest.approx(100, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(100, rel=0.1)

    # The kernel's V′ has 1e-12 of its scale; V″ turns that into an angle.
    assert q4["alpha_max"] == pytest.approx(np.arctan(k) / 2, abs=1e-10)
    assert q4["volume_max"] == pytest.approx(scale * (np.sqrt(1 + k**2) - 1) / k**2, rel=1e-10)


def leaves(value: Any) -> Iterator[float]:
    """Every number of a record, and how many items its lists and dictionaries have."""
    if isinstance(value, dict | list):
        yield len(value)
        for item in value.values() if isinstance(value, dict) else value:
            yield from leaves(item)
    elif isinstance(value, int | float):
        yield abs(value)


@pytest.mark.parametrize("name", CASES)
def test_every_number_that_a_text_prints_is_in_the_files_of_numbers(reports: dict[str, Path], name: str) -> None:
    record = numbers(reports[name])
    for key, text in zip(record["answers"], TEXTS[name], strict=True):
        known = set(leaves(record["answers"][key])) | set(leaves(record["parameters"]))
        assert len(text.printed) > 2
        assert [number for number in text.printed if np.isfinite(number) and abs(number) not in known] == [], key


def sections_of(folder: Path) -> dict[str, str]:
    page = (folder / "index.html").read_text(encoding="utf-8")
    return {found[1]: found[0] for found in re.finditer(r'<section id="(\w+)">.*?</section>', page, re.DOTALL)}


def test_each_question_names_the_angles_at_which_a_body_turns_by_more_than_90_degrees(reports: dict[str, Path]) -> None:
    """The models' sentence beside trajectories of their own."""
    p, folder = TABLE_1, reports["Table 1"]
    sentences = {key: html.unescape(re.sub("<[^>]*>", "", found[1])) for key, section in sections_of(folder).items()
                 if (found := re.search(r'<p class="note validity">(.*?)</p>', section, re.DOTALL))}  # fmt: skip
    ranges = {model: (float(low or 0), float(high or 90))
              for models, low, high in re.findall(r"(?:; |: )(\S.*?) (?:from ([\d.]+)° )?(?:on|(?:up )?to ([\d.]+)°)",
                                                  sentences["models"]) for model in models.split(", ")}  # fmt: skip
    assert {"finnie", "rotating", "as-printed"} <= set(ranges) < set(BUILT_IN)
    for model in TURNING:
        low, high = ranges.get(model, (90, 90))
        for degrees_ in (0.01, low - 1, low + 0.1, (low + high) / 2, high - 0.1, high + 1, 89.9):
            if 0 < degrees_ < 90:
                cut = path(load_model(model), p.replace(alpha=np.deg2rad(degrees_)))
                assert (low <= degrees_ <= high) == cut.turned_beyond, (model, degrees_)
    turned = numbers(folder)["turned_beyond"]
    assert set(sentences) == {key for key, models in turned.items() if models}
    assert all(angles in sentences[key] for key, models in turned.items() for angles in models.values())
    assert not {"q1", "q2", "q3", "q4", "q5", "q6", "q7", "q8"} & set(sentences)


def test_rotation_is_answered_within_the_limit_of_validity_too(tmp_path: Path) -> None:
    p = TABLE_1.replace(k=1.0)
    write_report(p, tmp_path, only=["a1"])
    a1 = numbers(tmp_path)["answers"]["a1"]["rotating"]
    assert np.rad2deg(a1["alpha_max"]) == pytest.approx(39.99624582, abs=2e-7)
    assert a1["turned_beyond_at_max"]
    # The first angle at which the body turns by 90°, by trajectories on both sides.
    for aside, beyond in ((-1e-5, False), (1e-5, True)):
        cut = path(load_model("rotating"), p.replace(alpha=a1["valid_alpha_max"] + aside))
        assert (abs(cut.turn) > np.pi / 2) == beyond
    assert a1["valid_volume_max"] < a1["volume_max"]


def test_families_follow_the_laws_of_the_linearized_model(whole: Path) -> None:
    p, record = TABLE_1, numbers(whole)["answers"]
    families = {"v0": record["q5"], "m": record["q6"]["m"], "r": record["q6"]["r"], "sigma": record["q7"],
                "psi": record["q8"]["psi"], "k": record["q8"]["k"]}  # fmt: skip
    scale = float(p.volume_scale)
    for quantity_, power in (("v0", 2), ("m", 1), ("r", 0), ("sigma", -1), ("psi", -1)):
        family = families[quantity_]
        assert len(family["values"]) >= 5
        # docs/physics.md, closed forms; V″ turns the 1e-12 of V′ into an angle.
        np.testing.assert_allclose(family["alpha_max"], np.arctan(p.k) / 2, rtol=0, atol=1e-10)
        expected = scale * (np.array(family["values"]) / float(getattr(p, quantity_))) ** power * (np.sqrt(5) - 1) / 4
        np.testing.assert_allclose(family["volume_max"], expected, rtol=1e-10)
        assert family["sensitivity"] == pytest.approx(0, abs=1e-10)
    ratios = np.array(families["k"]["values"])
    np.testing.assert_allclose(families["k"]["alpha_max"], np.arctan(ratios) / 2, rtol=0, atol=1e-10)
    # k dα_max/dk = ½ k/(1 + k²) = 0.2 for k = 2.
    assert families["k"]["sensitivity"] == pytest.approx(0.2, abs=1e-9)


def test_rotation_answers_with_the_settled_figures(whole: Path) -> None:
    answers = numbers(whole)["answers"]
    # tests/golden-numbers.md, as printed there.
    a1 = answers["a1"]
    assert np.rad2deg(a1["rotating"]["alpha_max"]) == pytest.approx(25.571827308, abs=1e-8)
    assert np.rad2deg(a1["rotating-full-torque"]["alpha_max"]) == pytest.approx(23.884236296, abs=1e-8)
    (jump,) = a1["rotating"]["jumps"]
    assert np.rad2deg(jump["alpha"]) == pytest.approx(42.92255530, abs=2e-8)
    spins = a1["rotating"]["over_spin"]
    settled = ((-0.5, 47.14), (-0.25, 46.81), (-0.2, 48.2356), (-0.1, 29.98), (0.1, 22.27), (0.25, 20.39), (0.5, 29.51))
    for s, degrees_ in settled:
        i = spins["s"].index(s)
        assert np.rad2deg(spins["alpha_max"][i]) == pytest.approx(degrees_, abs=0.006)
        assert spins["kind"][i] == ("jump" if s == -0.2 else "interior")
    assert np.rad2deg(a1["turn"]["told"][0]["turn"]) == pytest.approx(69.7, abs=0.05)
    # V depends on Ω = rω/v₀ alone: the sensitivities are as its exponents.
    again = a1["again"]
    rates = [again[name]["sensitivity"] for name in ("v0", "r", "m", "sigma", "psi")]
    assert rates == pytest.approx(np.array([-1, 1, -0.5, 0.5, 0.5]) * rates[1], rel=1e-6)
    at_one = again["k"]["values"].index(1.0)
    assert again["k"]["kind"][at_one] == "jump"
    assert np.rad2deg(again["k"]["alpha_max"][at_one]) == pytest.approx(39.99624582, abs=2e-7)


def test_the_spin_has_a_sensitivity_where_the_body_spins() -> None:
    assert "phidot0" not in additional.sensitivities(ReportCase(TABLE_1, "Table 1"))
    rates = additional.sensitivities(ReportCase(TABLE_1.replace(phidot0=0.1 * TABLE_1.v0 / TABLE_1.r), "spinning"))
    without, rate = rates["phidot0"]
    assert without == 0
    # 0.1 more spin takes α from 22.27° to about 20.4° at 0.25, see above.
    assert rate is not None
    assert np.deg2rad(-3) < rate < np.deg2rad(-1)
    # Of Ω and s alone: the speed moves both, the stress only Ω.
    (_, speed), (_, stress) = rates["v0"], rates["sigma"]
    assert stress is not None
    assert speed == pytest.approx(-2 * stress - rate, rel=1e-6)


def test_other_force_ratios_and_the_printed_equations(whole: Path) -> None:
    answers = numbers(whole)["answers"]
    # tests/golden-numbers.md.
    assert answers["a2"]["kind"] == "boundary"
    assert not answers["a2"]["attained"]
    assert answers["a2"]["supremum"] == pytest.approx(3.45455e-4 * INCH3, rel=1e-6)
    assert answers["a2"]["largest_difference"] < 1e-11
    assert answers["a2"]["volume_at_case"] == pytest.approx(3.050444415488e-4 * INCH3, rel=1e-11)
    for pair in answers["a3"]["pairs"].values():
        assert pair["largest_difference"] < 1e-11
        assert pair["alpha_max"] == pytest.approx(pair["alpha_max_of_tan_alpha"], abs=1e-9)
    printed = answers["slips"]["as-printed"]
    assert printed["volume"] == pytest.approx(4.9551209838e-4 * INCH3, rel=1e-10)
    assert printed["t_c"] == pytest.approx(7.46068867e-5, rel=1e-8)
    assert printed["only_falls"]
    assert {name: np.rad2deg(found["alpha_max"]) for name, found in answers["models"].items()} == pytest.approx(
        {"linearized": 31.717474411, "tan-alpha": 0, "velocity-aligned": 0, "finnie": 16.845033763,
         "rotating": 25.571827308, "rotating-full-torque": 23.884236296, "rotating-tan-alpha": 28.600916123,
         "rotating-velocity-aligned": 28.600916123, "rotating-tan-alpha-full-torque": 23.404489,
         "rotating-velocity-aligned-full-torque": 23.404489, "linearized-deformation": 39.6901724,
         "finnie-deformation": 17.8092449, "rotating-deformation": 30.8712426, "as-printed": 0}, abs=1e-6)  # fmt: skip


def test_what_is_left_out_is_said(reports: dict[str, Path], page: str) -> None:
    """Curves that others hide have no entry of a legend; the linearized model knows no spin."""
    for force in ("", "rotating-"):
        assert f"<code>{force}velocity-aligned</code> lies on <code>{force}tan-alpha</code>" in page
    drawn = (reports["Table 1"] / "figures" / "models.svg").read_text(encoding="utf-8")
    assert {name for name in BUILT_IN if f" ({name}) -->" not in drawn} == {
        "velocity-aligned", "rotating-velocity-aligned", "rotating-velocity-aligned-full-torque"}  # fmt: skip
    said = [name for name, folder in reports.items() if "has no part in questions 1 to 8" in index(folder)]
    assert said == ["unusual"]


def test_csv_holds_the_numbers_of_the_json(whole: Path) -> None:
    with (whole / "numbers.csv").open(encoding="utf-8", newline="") as file:
        rows = dict(list(csv.reader(file))[1:])
    answers = numbers(whole)["answers"]
    assert float(rows["answers.q5.alpha_max.2"]) == answers["q5"]["alpha_max"][2]
    assert float(rows["answers.a1.rotating.alpha_max"]) == answers["a1"]["rotating"]["alpha_max"]
    assert rows["answers.models.tan-alpha.kind"] == "boundary"


@pytest.mark.parametrize("name", ["Table 1", "unusual"])
def test_page_is_well_formed_and_its_ids_are_unique(reports: dict[str, Path], name: str) -> None:
    text = (reports[name] / "index.html").read_text(encoding="utf-8")
    root = ET.fromstring(text.removeprefix("<!DOCTYPE html>"))
    ids = [element.get("id") for element in root.iter() if element.get("id")]
    assert len(ids) == len(set(ids))
    links = {(element.get("href") or "")[1:] for element in root.iter("{http://www.w3.org/1999/xhtml}a")}
    assert links <= set(ids)
    assert len(list(root.iter("{http://www.w3.org/2000/svg}svg"))) == (26 if name == "Table 1" else 7)
    assert len(list(root.iter("{http://www.w3.org/1998/Math/MathML}math"))) > 40
    for element in root.iter("{http://www.w3.org/1998/Math/MathML}mi"):
        assert element.text != "&"


def test_page_is_self_contained(page: str) -> None:
    for attribute in re.findall(r'(?:src|href|action|data|poster|srcset)="([^"]*)"', page):
        assert attribute.startswith(("#", "data:image/png;base64,")) or attribute == "data:,"
    for address in re.findall(r"url\(([^)]*)\)", page):
        assert address.startswith(("#", "data:font/woff;base64,"))
    for forbidden in ("<script", "@import", "javascript:", "<iframe", " onload"):
        assert forbidden not in page
    assert "default-src 'none'" in page


def test_the_font_of_formulas_has_their_signs_and_lets_roots_grow(page: str) -> None:
    (data,) = re.findall(r"data:font/woff;base64,([^)]*)\)", page)
    font = TTFont(io.BytesIO(base64.b64decode(data)))
    # A browser makes a root as high as what it holds by the font's table of larger signs.
    signs_of_font = font.getBestCmap() or {}
    assert signs_of_font[ord("√")] in font["MATH"].table.MathVariants.VertGlyphCoverage.glyphs
    formulas = re.sub(r"<[^>]*>", "", "".join(re.findall(r"<math.*?</math>", page, flags=re.DOTALL)))
    signs = set(map(ord, html.unescape(formulas))) - {ord("\n"), 0x2061, 0x2062}
    assert sorted(map(chr, signs - signs_of_font.keys())) == []


def test_same_case_same_bytes(tmp_path: Path) -> None:
    first, second = (
        {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
        for folder in (write_report(TABLE_1, tmp_path / name, only=["q8"]).parent for name in "ab")
    )
    assert first == second
    names = sorted(str(path) for path in first)
    assert names[0] == "figures/best-angle-over-k.svg"
    assert names[-3:] == ["index.html", "numbers.csv", "numbers.json"]
    assert len(names) == 3 + 3


def test_only_answers_what_is_asked_in_the_pages_order(tmp_path: Path) -> None:
    said: list[tuple[str, int, int]] = []

    def progress(line: str, done: int, parts: int) -> None:
        said.append((line, done, parts))

    page = write_report(TABLE_1, tmp_path, only=["q4", "q3"], progress=progress)
    assert list(numbers(tmp_path)["answers"]) == ["q3", "q4"]
    assert re.findall(r'<section id="(q\d)"', page.read_text(encoding="utf-8")) == ["q3", "q4"]
    assert said == [("Question 3", 0, 2), ("Question 4", 1, 2), ("The page", 2, 2)]


@pytest.mark.parametrize(
    ("changes", "only", "message"),
    [
        *(({}, only, r"'q1', 'q2', 'q3', 'q4'") for only in (["q4", "q99"], [], "q4")),
        ({"alpha": 2.0}, None, "`alpha` must be in"),
        ({"v0": ["100 m/s", "200 m/s"]}, None, "`v0` must be a scalar"),
    ],
)
def test_what_makes_no_report_is_refused_before_anything_is_written(
    tmp_path: Path, changes: dict[str, Any], only: Any, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        write_report(TABLE_1.replace(**changes), tmp_path / "new", only=only)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("place", ["file", "file/below"])
def test_a_place_that_cannot_be_written_is_named_in_one_sentence(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(OSError, match=r": the report cannot be written there \([^()\n]*\)\.$") as caught:
        write_report(TABLE_1, tmp_path / place)
    assert str(caught.value).startswith(f"{tmp_path / place}: ")
    assert (tmp_path / "file").read_text() == "not a folder"


def test_a_normal_impact_cuts_nothing_and_says_so(tmp_path: Path) -> None:
    page = write_report(TABLE_1.replace(alpha=np.pi / 2), tmp_path, only=ONE_IMPACT).read_text(encoding="utf-8")
    assert "the cut stops before it begins" in page
    assert "With the numbers of this case" not in page
    answers = numbers(tmp_path)["answers"]
    assert answers["q3"]["volume"] == answers["q2"]["t_c"] == 0.0
    assert answers["q4"]["alpha_max"] == pytest.approx(np.arctan(2.0) / 2, abs=1e-10)


BACKWARD = TABLE_1.replace(phidot0=-1.2 * TABLE_1.v0 / TABLE_1.r)


def test_where_the_tip_moves_backward_nothing_is_cut_and_that_is_said(tmp_path: Path) -> None:
    text = write_report(BACKWARD, tmp_path, only=["a2"]).read_text(encoding="utf-8")
    assert "nothing is cut at all with this spin" in text
    assert numbers(tmp_path)["answers"]["a2"]["rotating"]["kind"] == "none"


@pytest.fixture(scope="module")
def backward() -> tuple[ReportCase, Answer]:
    case = ReportCase(BACKWARD, "backward")
    return case, additional.body_may_turn(case)


def test_a_case_name_is_text_not_html(tmp_path: Path) -> None:
    page = write_report(TABLE_1, tmp_path, case_name="<b>a & b</b>", only=["q2"]).read_text(encoding="utf-8")
    assert "&lt;b&gt;a &amp; b&lt;/b&gt;" in page
    assert "<b>a" not in page


def test_every_question_has_its_text_and_every_text_its_question() -> None:
    assert {path.stem for path in text_file("q1").parent.glob("*.md")} == set(QUESTIONS)


def test_the_best_angle_is_told_per_mass_of_abrasive(tmp_path):
    per_mass = PerMass(density=2700.0, cutting_fraction=0.05)
    write_report(TABLE_1, tmp_path, only=["q4"], per_mass=per_mass)
    q4 = numbers(tmp_path)["answers"]["q4"]
    at_best = float(CLOSED.volume(TABLE_1.replace(alpha=q4["alpha_max"])))
    assert q4["erosion_ratio_max"] == pytest.approx(float(per_mass.erosion_ratio(at_best, TABLE_1)))
    assert q4["specific_volume"] == pytest.approx(float(per_mass.specific_volume(CLOSED.volume(TABLE_1), TABLE_1)))
