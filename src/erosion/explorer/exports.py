"""What a tab hands out: figures, data, the case, and Python lines that compute the same."""

import csv
import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from erosion.explorer.answers import ANGLES, SPINS, Answers
from erosion.explorer.state import State
from erosion.models.base import State as Body
from erosion.parameters.case_files import dump_case
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS
from erosion.parameters.units import Dimension, unit_name
from erosion.plotting.angles import plot_optimum
from erosion.plotting.families import BestAngles, plot_best_angles
from erosion.plotting.motion import plot_end_times, plot_trajectory
from erosion.plotting.studies import plot_comparison
from erosion.plotting.style import new_axes, render
from erosion.sweeps.studies import compare
from erosion.tables import to_json


def _cut(answers: Answers, state: State) -> Figure:
    return plot_trajectory(answers.cut(state.shown, state.case))


def _volumes(answers: Answers, state: State) -> Figure:
    models = [answers.model(name, state.case) for name in state.models]
    return plot_comparison(compare(models, state.case.parameters()))


def _optimum(answers: Answers, state: State) -> Figure:
    return plot_optimum(answers.best(state.shown, state.case.at_any_angle()))


def _end_times(answers: Answers, state: State) -> Figure:
    over_angles = state.case.at_any_angle()
    fig, ax = new_axes(6.2, 4.4)
    here = state.case.numbers()["alpha"], float(answers.point(state.shown, state.case).t_c)
    ends, curve = answers.ends(state.shown, over_angles), answers.curve(state.shown, over_angles)
    plot_end_times(ax, ANGLES, ends, np.asarray(curve.t_c), units=state.case.units, marks={"case": here})
    return fig


def _spins(answers: Answers, state: State) -> Figure:
    fig, ax = new_axes(6.2, 4.4)
    curves = []
    for name in state.models:
        spins = answers.spins(name, state.case.at_any_spin())
        curves.append(BestAngles(name, SPINS, spins.alpha, spins.kind == "jump"))
    plot_best_angles(ax, curves, xlabel="$s = r\\,\\dot\\varphi_0/v_0$  initial spin")
    return fig


FIGURES: Mapping[str, tuple[str, Callable[[Answers, State], Figure]]] = {
    "cut": ("The cut and its histories", _cut),
    "volumes": ("V(α) of the checked models", _volumes),
    "optimum": ("V(α) with its maxima, jumps and regimes", _optimum),
    "end-times": ("t_c(α) with both candidates", _end_times),
    "spins": ("α_max over the spin", _spins),
}
"""By name of the file, what a figure shows and how it is drawn."""


def figure(name: str, suffix: str, answers: Answers, state: State) -> bytes:
    """One of `FIGURES` as the bytes of an "svg" or "png" file."""
    return render(FIGURES[name][1](answers, state), suffix)


def curves_csv(answers: Answers, state: State) -> bytes:
    """α [°], and of each checked model V, dV/dα, t_c and how the cut ends, over all angles."""
    columns: dict[str, Any] = {"alpha [deg]": np.rad2deg(ANGLES)}
    for name in state.models:
        curve = answers.curve(name, state.case.at_any_angle())
        for result in ("volume", "dvolume", "t_c"):
            columns[_heading(f"{name} {result}", RESULTS[result].dimension, state)] = getattr(curve, result)
        columns[f"{name} ended_by"] = curve.ended_by
    return _csv(columns)


def motion_csv(answers: Answers, state: State) -> bytes:
    """The motion of the model shown over time."""
    cut = answers.cut(state.shown, state.case)
    dimensions: dict[str, Dimension] = {
        "t": "time", "x_tip": "length", "depth": "length", "vx_tip": "speed", "vdepth": "speed", "removed": "volume",
    }  # fmt: skip
    if isinstance(cut.states, Body):
        dimensions |= {"x": "length", "y": "length", "phi": "angle", "vx": "speed", "vy": "speed"}
        dimensions |= {"omega": "angular speed"}
    return _csv({_heading(name, dimension, state): getattr(cut, name) for name, dimension in dimensions.items()})


def results_json(answers: Answers, state: State) -> bytes:
    """The case and everything that the page says of each checked model."""
    over_angles = state.case.at_any_angle()
    models = {}
    for name in state.models:
        point, best = answers.point(name, state.case), answers.best(name, over_angles)
        curve = answers.curve(name, over_angles)
        models[name] = {
            "own_parameters": state.case.own_values(name),
            "t_c": point.t_c, "ended_by": str(point.ended_by), "volume": point.volume, "dvolume": point.dvolume,
            "alpha_max": best.alpha, "volume_max": best.volume, "kind": str(best.kind), "side": str(best.side),
            "attained": bool(best.attained), "certified": bool(best.certified),
            "jumps": [vars(jump) for jump in best.jumps], "regimes": [vars(regime) for regime in best.regimes],
            "curve": {"alpha": ANGLES.tolist(), "volume": curve.volume.tolist(), "dvolume": curve.dvolume.tolist(),
                      "t_c": curve.t_c.tolist(), "ended_by": curve.ended_by.tolist()},
            "spins": {"s": SPINS.tolist(), "alpha_max": answers.spins(name, state.case.at_any_spin()).alpha.tolist()},
        }  # fmt: skip
    shown = {
        "model": state.shown,
        "sensitivities": dict(answers.sensitivities(state.shown, over_angles)),
        "turn": answers.cut(state.shown, state.case).turn,
        "warnings": list(answers.cut(state.shown, state.case).warnings),
    }
    parameters = {name: float(getattr(state.case.parameters(), name)) for name in QUANTITIES}
    content = {"parameters": {"units": state.case.units, **parameters}, "models": models, "shown": shown}
    return to_json(content).encode()


def case_toml(state: State) -> bytes:
    """The case as `erosion run --case` reads it."""
    return dump_case(state.case.parameters(), "From the explorer").encode()


def python_lines(state: State, sources: Mapping[str, str]) -> str:
    """Lines that compute what the page shows.

    Args:
        state: of the tab.
        sources: by the page's names of models, what `erosion.load_model` takes.
    """
    models = {name: _python_model(sources[name], state.case.own_values(name)) for name in state.models}
    return f"""import numpy as np
import erosion

p = erosion.{state.case.parameters()!r}
for model in ({", ".join(models.values())},):
    hit = erosion.impact(model, p, derivatives=2)
    best = erosion.alpha_max(model, p)
    print(model, hit.volume, hit.dvolume, hit.t_c, hit.ended_by, np.rad2deg(best.alpha), best.kind)

cut = erosion.simulate({models[state.shown]}, p)
print(cut)
"""


def _python_model(source: str, own: Mapping[str, float]) -> str:
    """What makes the model in Python; a name alone where it has no parameters of its own."""
    if not own:
        return repr(source)
    said = ", ".join(f"{name}={value!r}" for name, value in own.items())
    if not all(name.isidentifier() for name in own):  # "force.rate" is no keyword of Python's
        said = f"**{dict(own)!r}"
    return f"erosion.load_model({source!r}).replace({said})"


def _heading(name: str, dimension: Dimension, state: State) -> str:
    unit = unit_name(dimension, state.case.units)
    return f"{name} [{unit}]" if unit else name


def _csv(columns: Mapping[str, Any]) -> bytes:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(columns)
    # Python's own numbers print to the last bit.
    writer.writerows(zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True))
    return buffer.getvalue().encode()
