"""The exports of a tab: figures, data, the case, and Python lines that compute the same numbers."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from erosion.explorer.computed import ANGLES, SPINS, Answers
from erosion.explorer.state import PageState
from erosion.models import State as Body
from erosion.output.language import ENGLISH, Language
from erosion.output.tables import to_csv, to_json
from erosion.parameters.case_files import dump_case, dump_per_mass
from erosion.parameters.parameters import QUANTITIES
from erosion.parameters.quantities import RESULTS, Dimension, unit_name


def curves_csv(answers: Answers, state: PageState) -> bytes:
    """A table over all angles: α [°], and for each checked model V, dV/dα, t_c and how the cut ends."""
    columns: dict[str, Any] = {"alpha [deg]": np.rad2deg(ANGLES)}
    for name in state.models:
        curve = answers("curve", name, state.case)
        for result in ("volume", "dvolume", "t_c"):
            columns[_heading(f"{name} {result}", RESULTS[result].dimension, state)] = getattr(curve, result)
        columns[f"{name} ended_by"] = curve.ended_by
    return _csv(columns)


def motion_csv(answers: Answers, state: PageState) -> bytes:
    """The motion of the model shown over time."""
    cut = answers("cut", state.shown, state.case)
    dimensions: dict[str, Dimension] = {
        "t": "time", "x_tip": "length", "depth": "length", "vx_tip": "speed", "vdepth": "speed", "removed": "volume",
    }  # fmt: skip
    if isinstance(cut.states, Body):
        dimensions |= {"x": "length", "y": "length", "phi": "angle", "vx": "speed", "vy": "speed"}
        dimensions |= {"omega": "angular speed"}
    return _csv({_heading(name, dimension, state): getattr(cut, name) for name, dimension in dimensions.items()})


def results_json(answers: Answers, state: PageState) -> bytes:
    """The case, and all numbers that the page shows of each checked model."""
    models = {}
    for name in state.models:
        point, best, curve, spins = (answers(kind, name, state.case) for kind in ("point", "best", "curve", "spins"))
        models[name] = {
            "own_parameters": state.case.own_values(name),
            "t_c": point.t_c, "ended_by": str(point.ended_by), "volume": point.volume, "dvolume": point.dvolume,
            **state.per_mass.to_dict(point.volume, state.case.parameters()),
            "alpha_max": best.alpha, "volume_max": best.volume, "kind": str(best.kind), "side": str(best.side),
            "attained": bool(best.attained), "certified": bool(best.certified),
            "jumps": [vars(jump) for jump in best.jumps], "regimes": [vars(regime) for regime in best.regimes],
            "curve": {"alpha": ANGLES.tolist(), "volume": curve.volume.tolist(), "dvolume": curve.dvolume.tolist(),
                      "t_c": curve.t_c.tolist(), "ended_by": curve.ended_by.tolist()},
            "spins": {"s": SPINS.tolist(), "alpha_max": spins.alpha.tolist()},
        }  # fmt: skip
    cut = answers("cut", state.shown, state.case)
    shown = {
        "model": state.shown,
        "sensitivities": dict(answers("sensitivities", state.shown, state.case)),
        **({"turn": cut.turn} if math.isfinite(cut.turn) else {}),
        "warnings": list(cut.warnings),
    }
    parameters = {name: float(getattr(state.case.parameters(), name)) for name in QUANTITIES}
    content = {"parameters": {"units": state.case.units, **parameters}, "models": models, "shown": shown}
    return to_json(content).encode()


def case_toml(_: Answers, state: PageState) -> bytes:
    """The case as a file for `erosion run`."""
    return (dump_case(state.case.parameters(), "From the explorer") + dump_per_mass(state.per_mass)).encode()


def python_lines(state: PageState, sources: Mapping[str, str]) -> str:
    """Lines of Python that compute the numbers of the page.

    Args:
        state: the state of the tab.
        sources: the argument of `erosion.load_model` for each model, by its name on the page.
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
    """The Python expression of a model; without own parameters it is the model's name."""
    if not own:
        return repr(source)
    arguments = ", ".join(f"{name}={value!r}" for name, value in own.items())
    if not all(name.isidentifier() for name in own):  # "force.rate" cannot be a keyword argument in Python
        arguments = f"**{dict(own)!r}"
    return f"erosion.load_model({source!r}).replace({arguments})"


def _heading(name: str, dimension: Dimension, state: PageState) -> str:
    unit = unit_name(dimension, state.case.units)
    return f"{name} [{unit}]" if unit else name


def _csv(columns: Mapping[str, Any]) -> bytes:
    return to_csv({heading: np.asarray(column).tolist() for heading, column in columns.items()}).encode()


def _figure(name: str, suffix: str, answers: Answers, state: PageState, language: Language = ENGLISH) -> bytes:
    # Imported here: matplotlib, scipy and xarray would delay the first page.
    from erosion.explorer.figures import FIGURES
    from erosion.plotting.style import render, translate_figure

    figure = FIGURES[name](answers, state)
    translate_figure(figure, language)
    return render(figure, suffix)


Export = tuple[str, Callable[..., bytes]]
FIGURES: Mapping[str, Export] = {
    f"{name}.{suffix}": (f"{title} ({suffix.upper()})", partial(_figure, name, suffix))
    for name, title in (
        ("cut", "The cut and its histories"),
        ("volumes", "V(α) of the checked models"),
        ("optimum", "V(α) with its maxima, jumps and regimes"),
        ("end-times", "t_c(α) with both candidates"),
        ("spins", "α_max over the spin"),
    )
    for suffix in ("svg", "png")
}
TABLES: Mapping[str, Export] = {
    "curves.csv": ("Curves over α (CSV)", curves_csv),
    "motion.csv": ("Motion of the model drawn (CSV)", motion_csv),
    "explorer.json": ("All numbers (JSON)", results_json),
}
CASES: Mapping[str, Export] = {"case.toml": ("The case (TOML)", case_toml)}
"""What a tab exports, by the name of the file: its title, and the function that makes it."""
