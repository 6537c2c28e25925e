"""Beyond a turn of 90° a model of a single tip does not hold: every verb and every figure says so."""

import html
import json
import re
import shlex
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from jax import lax
from matplotlib.text import Text
from scipy import stats

import erosion
from erosion.cfd.map_result import MapSummary
from erosion.explorer.computed import Answers, Computed
from erosion.explorer.state import PageCase, PageState
from erosion.explorer.tab import results_json
from erosion.explorer.views import numbers, volumes
from erosion.impacts import BEYOND_LABEL, OF_TURN
from erosion.plotting.sweeps import plot_regimes
from tests.cfd.tables import Table, hump
from tests.documents import Shell, findings

P = erosion.TABLE_1.replace(k=1.0)
SHALLOW = P.replace(alpha=np.deg2rad(30.0))
IMPACTS = (
    "x [m],y [m],z [m],count,diameter [mm],density [kg/m^3],speed [m/s],angle [deg]\n"
    "0.2,0.1,0,5,0.2,2650,100,10\n0.6,0.2,0,5,0.2,2650,100,30\n"
)
PLATE = """solid plate
facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet
facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet
endsolid plate
"""
# Of `rotating`, k = 1.
ROWS = "angle [deg],volume [in^3/impact],uncertainty [in^3]\n10,9.443e-5,1e-6\n25,1.2601e-4,1e-6\n30,1.2676e-4,1e-6\n"
CALIBRATED = "calibrate rows.csv --k 1 --free psi --write-case fit.toml"
VERBS = {
    "run": "run --k 1 --alpha 30deg",
    "optimum": "optimum --k 1 --max-turn any",
    "compare": "compare --k 1",
    "compare with correlations": "compare --k 1 --correlations dnv",
    "sweep": "sweep --k 1 --alpha 10deg:80deg:8 -o out.csv",
    "sweep over two axes": "sweep --k 1:2:8 --alpha 10deg:80deg:8 -o out.csv",
    "stream": "stream --k 1 --alpha 'normal(30deg, 2deg)' --n 256 --no-best-angle",
    "map": "map impacts.csv --surface plate.stl --surface-unit m --k 1",
    "advise": "advise --k 1",
    "calibrate": CALIBRATED,
    "posterior": "posterior rows.csv --k 1 --free psi --draws 125",
    "predict": "predict fit.nc --alpha 30deg",
    "export": "export --k 1 --table table.csv",
}


class Said(NamedTuple):
    """What a verb says of cuts that turn too far.

    Args:
        json: the sentences of the document, or of the file of numbers.
        words: the text around the table; of a command that says nothing, nothing is read.
        figure: the text of the figure; None where the verb has none.
    """

    json: list[str]
    words: str
    figure: str | None


def said_by_command(verb: str, model: str, shell: Shell) -> Said:
    words = [*shlex.split(VERBS[verb]), "--model", model]
    if verb == "predict":
        shell([*shlex.split(CALIBRATED), "--model", model])
        words = words[:-2]
    option = {"export": None, "posterior": "--plot-prediction"}.get(verb, "--plot")
    drawn = [] if option is None else [option, "figure.svg"]
    sentences = [finding["text"] for finding in findings(shell([*words, *drawn, "--json"]).document, *OF_TURN)]
    figure = html.unescape(Path("figure.svg").read_text("utf-8")) if drawn else None
    return Said(sentences, shell([*words, *drawn]).err if sentences else "", figure)


def said_by_report(model: str, shell: Shell) -> Said:
    """Of the question about the model."""
    shell(["report", "--k", "1", "--only", {"rotating": "slips", "linearized": "q3"}[model], "-o", model])
    (turned,) = json.loads(Path(model, "numbers.json").read_text("utf-8"))["turned_beyond"].values()
    page = re.sub("<svg.*?</svg>|<[^>]*>", "", Path(model, "index.html").read_text("utf-8"), flags=re.DOTALL)
    figures = "".join(file.read_text("utf-8") for file in Path(model, "figures").iterdir())
    return Said([f"{name} {turned[name]}" for name in {model} & {*turned}], page, html.unescape(figures))


def said_by_explorer(model: str) -> Said:
    """By its export, its table and its curves."""
    answers, state = Answers({model: erosion.load_model(model)}), PageState(PageCase.of(SHALLOW), (model,), model)
    cut = json.loads(results_json(answers, state))["shown"]["cut"]
    computed = Computed.of(answers, state, None)
    table, (option, *_) = html.unescape(numbers(computed, [model])[0]), volumes(computed, [model])
    assert (BEYOND_LABEL in table) == (model == "rotating")
    return Said([finding["text"] for finding in cut["findings"]], table, str(option))


@pytest.mark.filterwarnings("ignore::erosion.impacts.trajectory.TurnWarning")
@pytest.mark.parametrize("verb", [*VERBS, "report", "explore"])
def test_a_verb_says_where_the_body_turns_too_far(verb: str, shell: Shell, tmp_path: Path, monkeypatch: Any) -> None:
    """In the table, in the JSON and in the legend of the figure."""
    monkeypatch.chdir(tmp_path)
    for name, text in {"impacts.csv": IMPACTS, "plate.stl": PLATE, "rows.csv": ROWS}.items():
        Path(name).write_text(text)
    for model, is_said in (("rotating", True), ("linearized", False)):  # which does not turn
        if verb == "report":
            said = said_by_report(model, shell)
        else:
            said = said_by_explorer(model) if verb == "explore" else said_by_command(verb, model, shell)
        assert len(said.json) == is_said
        assert all(text in said.words for text in said.json)
        if said.figure is not None:
            assert (BEYOND_LABEL in said.figure) == is_said


def test_a_prediction_says_so_where_it_is_asked_and_a_fit_where_it_was_measured(tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_text(ROWS)
    data = erosion.read_measurements(tmp_path / "rows.csv", P.shown_in)
    fit = erosion.calibrate(erosion.FitProblem("rotating", P, data, free=["psi"]))
    (turned,) = (finding for finding in fit.findings if finding.code in OF_TURN)
    assert (turned.numbers["turned"], turned.numbers["impacts"]) == (2, 3)
    for alpha, is_beyond in ((0.05, False), (0.5, True)):
        codes = [finding.code for finding in erosion.predict(fit, alpha).findings]
        assert ("turned_beyond_at_draws" in codes) == is_beyond
    beyond, none = np.deg2rad([30.0, 35.0]), np.deg2rad(3.0)
    for alpha, share in ((beyond, 1.0), (np.append(beyond, [none] * 2), 0.5)):
        (turned,) = (finding for finding in erosion.predict(fit, alpha).findings if finding.code in OF_TURN)
        assert (turned.numbers["share"], "32" in turned.text) == (share, False)


def small_map() -> Any:
    rows = Table(
        count=[1.0] * 2, mass=[1e-7] * 2, diameter=[4e-4] * 2, speed=[110.0] * 2, alpha=[0.1, 0.5], face=[0, 1]
    )
    return erosion.erosion_map("rotating", P.to("si"), rows, hump(2, 1))


def test_the_figure_of_regimes_says_so_in_its_legend() -> None:
    regimes = erosion.regimes("rotating", P, alpha=np.linspace(0.1, 1.5, 8), phidot0=[-1000.0, 0.0])
    assert any(BEYOND_LABEL in text.get_text() for text in plot_regimes(regimes).findobj(Text))


def test_a_table_says_so_too() -> None:
    stream = erosion.stream(
        "rotating", SHALLOW, n=256, best_angle=False, sensitivities=False, alpha=stats.norm(0.5, 0.02)
    )
    for result in (erosion.alpha_max("rotating", P, max_turn=None), stream, MapSummary(small_map())):
        (turned,) = (finding for finding in result.findings if finding.code in OF_TURN)
        assert turned.text in str(result)
        assert turned.text in result._repr_html_()


def test_no_angle_is_the_best_where_the_body_turns_too_far_at_each() -> None:
    """Between 20° and 30° of k = 1 every cut turns the body by more than 90°."""
    best = erosion.alpha_max("rotating", P, alpha_range=(np.deg2rad(20), np.deg2rad(30)))
    (always,) = best.findings
    assert (str(best.kind), always.code) == ("none", "turned_at_each_angle")
    assert always.numbers["max_turn"] == pytest.approx(np.pi / 2)
    assert always.text in str(best)


@pytest.mark.parametrize("model", ["linearized-deformation", "velocity-aligned"])
def test_a_model_without_rotation_leaves_out_the_spin(model: str) -> None:
    spinning = P.replace(phidot0=55_000.0)
    best, still = (erosion.alpha_max(model, p) for p in (spinning, P))
    np.testing.assert_array_equal([best.alpha, best.volume, best.turn], [still.alpha, still.volume, still.turn])
    cut = erosion.simulate(model, spinning.replace(alpha=0.3))
    assert (cut.turn, cut.turned_beyond, erosion.impact(model, spinning).turn) == (0.0, False, 0.0)
    closed = erosion.models.load_model(model).closed_form()
    assert closed is not None
    assert closed.state(cut.t_c, spinning).phi == np.pi / 2


class Pushes(erosion.models.ForceLaw):
    """The force of the metal with the wrong sign, F_x = c depth."""

    def __call__(self, state: Any, tip: Any, p: erosion.Parameters) -> Any:
        return p.stiffness * tip.depth, -p.k * p.stiffness * tip.depth

    def typical_ratio(self, p: erosion.Parameters) -> Any:
        return p.k


@pytest.mark.filterwarnings("ignore::erosion.impacts.trajectory.TurnWarning")
def test_a_force_of_the_wrong_sign_is_said_wherever_it_is_used() -> None:
    model = erosion.models.Rotating(force=Pushes())
    with pytest.warns(UserWarning, match="F_x is positive"):
        cut = erosion.simulate(model, P)
    swept = erosion.sweep(model, P, alpha=np.linspace(0.2, 0.4, 3))
    assert "pushed_forward" in swept.attrs["findings"]
    jet = erosion.stream(model, P, n=64, best_angle=False, sensitivities=False, alpha=stats.norm(0.3, 0.01))
    for result in (cut, jet, erosion.alpha_max(model, P, max_turn=None), erosion.verify(model)):
        assert "pushed_forward" in [finding.code for finding in result.findings]
    right = erosion.models.Rotating(force=erosion.models.ConstantRatio(), torque=erosion.models.FullTorque())
    assert "pushed_forward" not in [finding.code for finding in erosion.simulate(right, SHALLOW).findings]


class OfOneImpact(erosion.models.ConstantRatio):
    """A right law that takes no arrays, as `cond` does not."""

    def __call__(self, state: Any, tip: Any, p: erosion.Parameters) -> Any:
        forward = lax.cond(tip.depth > 0.1 * p.r, lambda: -1.5 * tip.depth, lambda: -tip.depth) * p.stiffness
        return forward, p.k * forward


def test_a_law_of_one_impact_is_asked_for_one() -> None:
    model = erosion.models.Rotating(force=OfOneImpact())
    assert "pushed_forward" not in erosion.sweep(model, P, alpha=np.linspace(0.05, 0.1, 3)).attrs.get("findings", "")
    best = erosion.alpha_max(model, P.replace(k=np.array([2.0, 3.0])))
    assert best.certified.all()
    assert best.findings == ()


def test_the_share_that_turns_too_far_is_a_number_of_streams_and_maps() -> None:
    of_angle = {"n": 256, "best_angle": False, "sensitivities": False, "alpha": stats.uniform(0.1, 0.4)}
    stream = erosion.stream("rotating", P, **of_angle)
    angles = np.linspace(0.1, 0.5, 2001)
    turned = erosion.impact("rotating", P.replace(alpha=angles)).turn > np.pi / 2
    assert stream.to_dict()["turned_share"] == stream.to_dataset()["turned_share"].item()
    assert stream.to_dict()["turned_share"] == pytest.approx(np.mean(turned), abs=2e-3)
    assert 0.1 < np.mean(turned) < 0.9
    assert small_map()["turned_share"] == 0.5  # of 0.1 and 0.5 rad
    assert erosion.stream("linearized", P, **of_angle).to_dict()["turned_share"] == 0.0
    assert "turned_share" not in erosion.stream("ecrc", P.to("si"), **of_angle).to_dict()


def test_the_turn_is_a_number_of_an_impact_and_of_an_optimum() -> None:
    best = erosion.alpha_max("rotating", P, max_turn=None)
    with pytest.warns(erosion.TurnWarning):
        followed = erosion.simulate("rotating", P.replace(alpha=best.alpha))
    assert best.turn == pytest.approx(followed.turn, rel=1e-8)
    assert erosion.impact("rotating", P.replace(alpha=best.alpha)).turn == pytest.approx(followed.turn, rel=1e-8)
    assert json.loads(json.dumps(best.to_dict()))["turn"] == best.turn
    # At the limit the body has turned by as much as is allowed.
    assert erosion.alpha_max("rotating", P).turn == pytest.approx(np.pi / 2, abs=1e-6)
    assert np.isnan(erosion.alpha_max("ecrc", P.to("si")).turn)
