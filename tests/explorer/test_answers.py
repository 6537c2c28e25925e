"""What the page asks, and how it asks: remembered answers, single events, the latest first."""

import dataclasses
import html
import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from erosion.explorer.computed import (
    ANGLES,
    AnswerKind,
    Answers,
    Computed,
    SingleEvent,
    Stage,
    end_times,
)
from erosion.explorer.state import PageCase, PageState, own_numbers
from erosion.explorer.tab import case_toml, python_lines, results_json
from erosion.explorer.views import numbers, sensitivities, volumes
from erosion.impacts import BEYOND_LABEL, path
from erosion.impacts.batch import impact
from erosion.impacts.optimum import alpha_max
from erosion.models import Linearized, load_model, model_name
from erosion.parameters.case_files import CaseFile, load_case
from erosion.parameters.parameters import QUANTITIES, TABLE_1
from erosion.parameters.per_mass import PerMass
from erosion.plotting.labels import AT_CONTACT

CASE = PageCase.of(TABLE_1)
STATE = PageState(CASE, ("linearized",), "linearized")
TIP = str(Path(__file__).parent.parent.parent / "models" / "coulomb_tip.py")
MODELS = {"linearized": Linearized(), "tip": load_model(TIP)}
PLUGGED = PageCase.of(TABLE_1, own_numbers(MODELS)).replace(**{"tip.friction": 0.35})
SLID = PageState(PLUGGED, ("linearized", "tip"), "tip")


@pytest.mark.parametrize("event", ["rebound", "stop"])
def test_a_single_event_is_the_closed_forms_candidate(event: str) -> None:
    p = TABLE_1.replace(alpha=ANGLES[::10])
    exact = end_times(Linearized(), p)[event]
    hits = impact(SingleEvent(Linearized(), event), p)
    computed = np.where(hits.ended_by == event, hits.t_c, np.nan)
    # 1e-9 is the kernel's tolerance; where the event never happens both say so.
    np.testing.assert_allclose(computed, exact, rtol=1e-9)
    assert np.isnan(exact).any() == (event == "stop")


def fake(**compute: Callable[[str, PageCase], Any]) -> Answers:
    """Answers of these kinds, computed by these functions."""
    kinds = {name: AnswerKind(lambda _, model, case, of=of: of(model, case)) for name, of in compute.items()}
    return Answers({}, kinds)


def test_a_model_that_never_answers_is_left_out_until_it_does() -> None:
    goes_on = threading.Event()
    state = PageState(CASE, ("linearized", "plug_in"), "linearized")
    answers = fake(curve=lambda model, _: model == "linearized" or goes_on.wait())
    stage = Stage(("curve",), ("volumes",))
    work = answers.start(stage, state)
    work["linearized"].future.result(timeout=60)
    assert Computed.of(answers, state, None).of_all("curve") == {"linearized": True}
    # It computes one case at a time: another one begins when this one is answered.
    moved = dataclasses.replace(state, case=CASE.replace(k=3.0))
    assert answers.start(stage, moved)["plug_in"] is work["plug_in"]
    goes_on.set()
    work["plug_in"].future.result(timeout=60)
    assert Computed.of(answers, state, None).of_all("curve") == {"linearized": True, "plug_in": True}
    assert answers.start(stage, moved)["plug_in"] is not work["plug_in"]
    assert answers.start(stage, state) == {}


def test_an_answer_that_fails_is_a_line_on_the_page() -> None:
    answers = fake(curve=lambda model, case: 1 / int(case == CASE))
    state, stage = dataclasses.replace(STATE, case=CASE.replace(k=3.0)), Stage(("curve",), ("volumes",))
    answers.start(stage, state)["linearized"].future.result(timeout=60)
    computed = Computed.of(answers, state, None)
    assert computed.errors == ["linearized: division by zero"]
    assert computed.of_all("curve") == {}
    # An export says so, too.
    with pytest.raises(ZeroDivisionError):
        answers("curve", "linearized", state.case)


def test_answers_are_of_the_own_parameters_of_the_case() -> None:
    answers = Answers(MODELS)
    model = load_model(TIP).replace(friction=0.35)
    hit, best = impact(model, TABLE_1, derivatives=2), alpha_max(model, TABLE_1)
    assert answers("point", "tip", PLUGGED).volume == hit.volume
    assert answers("cut", "tip", PLUGGED).volume == pytest.approx(hit.volume, rel=1e-8)
    assert answers("best", "tip", PLUGGED).alpha == best.alpha
    assert answers("spins", "tip", PLUGGED).alpha[30] == pytest.approx(best.alpha, abs=1e-10)
    # Another model's answer is remembered while the slider of this one moves, and a curve while the angle's does.
    answers("point", "linearized", PLUGGED)
    moved = PLUGGED.replace(**{"tip.friction": 0.1})
    assert answers.remembered("point", "linearized", moved) is not None
    assert answers.remembered("point", "tip", moved) is None
    assert answers.remembered("best", "tip", PLUGGED.replace(alpha=0.5)) is not None
    # Own parameters move the best angle, too.
    rates = answers("sensitivities", "tip", PLUGGED)
    option, _, said = sensitivities(Computed(SLID, {("sensitivities", "tip"): rates}), MODELS)
    assert option["yAxis"]["data"][0] == "μ"
    move = np.rad2deg(0.01 * 0.35 * rates["friction"])
    assert option["series"][0]["data"][0] == pytest.approx(move, abs=1e-6)
    assert f"μ {move:+.3g}°" in said
    assert option["title"]["text"] == ""  # the page merges options, and would keep another one


def test_a_best_angle_that_nothing_is_known_to_move_has_the_reason() -> None:
    plateau = alpha_max("linearized", TABLE_1, objective="t_c")
    state = PageState(CASE, ("linearized",), "linearized")
    answers = {("best", "linearized"): plateau, ("sensitivities", "linearized"): plateau.sensitivities}
    option, _, said = sensitivities(Computed(state, answers), ["linearized"])
    assert option["title"]["text"] == f"not known: {plateau.without_sensitivities}"
    assert option["title"]["text"] in said


UNITS = {"units": "inch-pound"}


def test_what_is_handed_out_has_the_own_parameters() -> None:
    lines = python_lines(SLID, {"linearized": "linearized", "tip": TIP})
    assert f"erosion.load_model({TIP!r}).replace(friction=0.35)" in lines
    scope: dict = {}
    exec(lines, scope)
    assert scope["hit"].volume == impact(load_model(TIP).replace(friction=0.35), TABLE_1, derivatives=2).volume
    assert scope["best"].alpha == alpha_max(load_model(TIP).replace(friction=0.35), TABLE_1).alpha
    assert scope["p"] == TABLE_1
    content = json.loads(results_json(Answers(MODELS), SLID))
    impacts = {name: results["impact"] for name, results in content["models"].items()}
    names = {"linearized": "linearized", "tip": model_name(MODELS["tip"])}
    numbers = {name: float(getattr(TABLE_1, name)) / QUANTITIES[name].size("inch-pound") for name in QUANTITIES}
    for name, result in (*impacts.items(), ("tip", content["shown"]["cut"])):
        assert result["model"] == names[name]
        assert result["own_parameters"] == ({"friction": 0.35} if name == "tip" else {})
        assert result["parameters"] == {name: pytest.approx(number) for name, number in numbers.items()} | UNITS
    assert impacts["tip"]["volume"] == pytest.approx(scope["hit"].volume / 0.0254**3, rel=1e-14)


def test_what_is_handed_out_says_how_far_the_body_turns() -> None:
    state = dataclasses.replace(
        STATE, models=("rotating",), shown="rotating", case=STATE.case.replace(alpha=np.deg2rad(35))
    )
    content = json.loads(results_json(Answers({"rotating": load_model("rotating")}), state))["models"]["rotating"]
    cut = path(load_model("rotating"), TABLE_1.replace(alpha=np.deg2rad(35)))
    assert content["impact"]["turn"] == pytest.approx(cut.turn, rel=1e-7)
    assert content["impact"]["turned_beyond"] is cut.turned_beyond is True
    assert [content["curve"]["turned_beyond"][i] for i in (0, 92, 200)] == [False, True, False]


def test_a_curve_is_dotted_where_the_body_of_its_model_turns_too_far() -> None:
    """Of a model that is not the one drawn, too; its row says so at the angle of the case."""
    models = {"linearized": Linearized(), "rotating": load_model("rotating")}
    answers, case = Answers(models), CASE.replace(alpha=np.deg2rad(35))
    known = {(kind, name): answers(kind, name, case) for kind in ("curve", "turned", "point") for name in models}
    computed = Computed(PageState(case, tuple(models), "linearized"), known)
    dotted = [line for line in volumes(computed, models)[0]["series"] if line.get("legend") == BEYOND_LABEL]
    assert [line["name"] for line in dotted] == [f"rotating, {BEYOND_LABEL}"]
    drawn = [degrees for degrees, volume in dotted[0]["data"] if volume is not None]
    assert (min(drawn), max(drawn)) == (pytest.approx(29.1, abs=0.4), pytest.approx(42.9, abs=0.4))
    _, still, turns = numbers(computed, models)[0].split("<tr class=")[-3:]
    assert (BEYOND_LABEL in html.unescape(still), BEYOND_LABEL in html.unescape(turns)) == (False, True)


def test_the_exported_motion_of_a_body_has_its_turn() -> None:
    answers, state = Answers({"rotating": load_model("rotating")}), PageState(CASE, ("rotating",), "rotating")
    motion, cut = json.loads(results_json(answers, state))["shown"]["motion"], answers("cut", "rotating", CASE)
    assert (motion["phi"], motion["omega"]) == (cut.phi.tolist(), cut.omega.tolist())


def test_curves_and_case_are_exact(tmp_path) -> None:
    answers = Answers({"linearized": Linearized()})
    content = json.loads(results_json(answers, STATE))
    hits = impact(Linearized(), TABLE_1.replace(alpha=ANGLES), derivatives=2)
    assert content["models"]["linearized"]["curve"]["volume"] == pytest.approx(hits.volume / 0.0254**3, rel=1e-14)
    cut = path(Linearized(), TABLE_1)
    assert content["shown"]["motion"]["depth"] == pytest.approx(cut.depth / 0.0254, rel=1e-14, abs=1e-30)
    assert b"alpha = 0.3490658503988659" in case_toml(answers, STATE)
    weighed = dataclasses.replace(STATE, per_mass=PerMass(2700, 0.5))
    (tmp_path / "case.toml").write_bytes(case_toml(answers, weighed))
    assert CaseFile.read(tmp_path / "case.toml").per_mass() == weighed.per_mass


def test_an_exported_case_holds_its_model_and_own_parameters(tmp_path) -> None:
    """`erosion run case.toml` computes the impact of the page."""
    answers = Answers(MODELS)
    for state in (SLID, dataclasses.replace(SLID, shown="linearized")):
        (tmp_path / "case.toml").write_bytes(case_toml(answers, state))
        source, own = CaseFile.read(tmp_path / "case.toml").model()
        assert source is not None
        p = load_case(tmp_path / "case.toml")
        volume = float(impact(load_model(source).replace(**own), p, derivatives=2).volume)
        assert volume == answers("point", state.shown, state.case).volume


def test_the_share_of_deformation_is_shaded_for_the_model_drawn() -> None:
    models = {"linearized": Linearized(), "deforming": load_model("linearized-deformation")}
    answers, case = Answers(models), PageCase.of(TABLE_1, own_numbers(models))
    curves = {("curve", name): answers("curve", name, case) for name in models}
    shaded = []
    for shown in models:
        cut = {("cut", shown): answers("cut", shown, case)}
        computed = Computed(PageState(case, tuple(models), shown), curves | cut)
        shaded = [line for line in volumes(computed, models)[0]["series"] if line["name"] == AT_CONTACT]
        assert len(shaded) == (shown == "deforming") == ("areaStyle" in str(shaded))
        assert ("removed at contact" in numbers(computed, models)[0]) == (shown == "deforming")
    # V_D = V* sin²α/(2e), in 10⁻⁴ in³.
    degrees, at_contact = np.array(shaded[0]["data"], float).T
    expected = np.sin(np.deg2rad(degrees)) ** 2 / 3.2 * float(TABLE_1.volume_scale) / (1e-4 * 0.0254**3)
    np.testing.assert_allclose(at_contact, expected, atol=2e-5)


def test_a_volume_has_its_amount_per_mass_below_it() -> None:
    answers, case = Answers({"linearized": Linearized()}), PageCase.of(TABLE_1, ())
    point = {("point", "linearized"): answers("point", "linearized", case)}
    computed = Computed(PageState(case, ("linearized",), "linearized"), point)
    # 1.81644e-4 in³ of 2.855e-7 slinch.
    assert "1.8164·10⁻⁴ in³<br><small>59,530 mm³/kg</small></td>" in numbers(computed, ["linearized"])[0]
    # Of a twentieth of the particles, and of aluminium.
    weighed = dataclasses.replace(computed.state, per_mass=PerMass(2700, 0.05))
    few = dataclasses.replace(computed, state=weighed)
    assert "<small>2,977 mm³/kg</small><br><small>8.037 g/kg</small></td>" in numbers(few, ["linearized"])[0]
    # An amount that is asked for and more than ten times what tests find is not shown.
    many = dataclasses.replace(computed, state=dataclasses.replace(weighed, per_mass=PerMass(2700, 0.5)))
    text = numbers(many, ["linearized"])[0]
    assert "<small>more than ten times what tests find</small></td>" in text
    assert "g/kg" not in text
