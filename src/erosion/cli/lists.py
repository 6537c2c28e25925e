"""Options that are lists, and the verbs that list and check: `materials`, `models`, `validate` and `verify`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.options import MODEL, JsonOption, PlotOption
from erosion.cli.output import Output, draw, progress_bar, require_outputs
from erosion.output.files import is_file
from erosion.output.tables import briefly


def read_list(text: str) -> list[str]:
    """The items of a list, with commas between them; a ValueError where there is none."""
    items = [item.strip() for item in text.split(",") if item.strip()]
    if not items:
        raise ValueError(f"must list one item or more, but is {briefly(text)}")
    return items


def read_models(text: str) -> list[str]:
    """The models that a text names; the path of a file may have a comma."""
    return [text] if is_file(text) else read_list(text)


LISTED = Parameter(
    negative="", converter=lambda kind, tokens: [item for token in tokens for item in read_list(token.value)]
)
IgnoreOption = Annotated[
    list[str] | None, LISTED, Parameter(help='Columns of the table to leave out, such as "frequency".')
]
ModelOption = Annotated[
    str, Parameter(name="--model", group=MODEL, help="A name, see `erosion models`, or the path of a Python file.")
]
ModelsOption = Annotated[
    list[str] | None,
    Parameter(
        name="--model",
        negative="",
        converter=lambda kind, tokens: [item for token in tokens for item in read_models(token.value)],
        group=MODEL,
        help='Names or paths of files: "linearized,rotating", or "all".',
    ),
]


def chosen_models(names: Sequence[str] | Any) -> Any:
    """The models that are named, where "all" stands for every usable one."""
    if not isinstance(names, list) or "all" not in names:
        return names
    others = [name for name in names if name != "all"]
    return list(dict.fromkeys((*lazy.usable_models(), *others)))


def refuse_same(models: "Mapping[str, lazy.CuttingModel]") -> None:
    """Refuse two names of one model, as "dnv" and "dnv:carbon-steel" are for a target of steel.

    Args:
        models: by the names that are given; correlations are made for the target.
    """
    first: dict[str, str] = {}
    for name, model in models.items():
        other = first.setdefault(lazy.called(name, model), name)
        if other != name:
            raise InputError(
                f"Option `--model` must name different models, but `{other}` and `{name}` are the same here: "
                f"{lazy.called(name, model)}."
            )


_NOTE = (
    "ψ of a target whose flow stress is its Vickers hardness is 2; the others leave ψ as it is. "
    'A table of your own in TOML has the same form: --target "mine.toml: my alloy".'
)


def materials(
    file: Annotated[Path | None, Parameter(help="A table of your own (TOML) instead of the package's.")] = None,
    /,
    *,
    json: JsonOption = False,
) -> None:
    """List the particles and targets that have a name, with sources."""
    before = "" if file is None else f"{file}: "
    with user_errors():
        # Any size will do: it is not shown.
        particles = [lazy.particle(f"{before}{name} 1 mm") for name in lazy.known_particles(file)]
        targets = [lazy.target(f"{before}{name}") for name in lazy.known_targets(file)]
    output = Output("materials", json=json)
    output.document({"particles": [*map(_particle, particles)], "targets": [*map(_target, targets)]})
    rows = [(item.name, _span(item.density, item.density_range), item.hardness, item.source) for item in particles]
    if rows:
        output.table("Particles", rows, ("particle", "density [kg/m³]", "hardness", "source"), (1,))
    if targets:
        output.table("Targets", [_row(item) for item in targets], _TARGET, (1, 2), [_NOTE])


_TARGET = ("target", "density [kg/m³]", "flow stress [MPa]", "by", "source")


def _row(item: "lazy.Target") -> tuple[str, ...]:
    density = "" if item.density is None else _span(item.density, item.density_range)
    low, high = item.flow_stress_range
    stress = _span(item.flow_stress / 1e6, (low / 1e6, high / 1e6))
    return item.name, density, stress, "" if item.vickers is None else f"{item.vickers:g} HV", item.source


def _span(value: float, ends: tuple[float, float] | None) -> str:
    """A value, and the range where it has one."""
    low, high = ends or (value, value)
    return f"{value:.4g}" if low == high else f"{value:.4g} ({low:.4g} to {high:.4g})"


def _particle(item: "lazy.Particle") -> dict[str, Any]:
    return {"name": item.name, **_quantity("density", item.density, "kg/m^3", item.density_range),
            "hardness": item.hardness, "shape": item.shape, "source": item.source}  # fmt: skip


def _target(item: "lazy.Target") -> dict[str, Any]:
    return {"name": item.name, **_quantity("density", item.density, "kg/m^3", item.density_range),
            **_quantity("flow_stress", item.flow_stress, "Pa", item.flow_stress_range),
            "vickers": item.vickers, "psi": item.psi, "correlations": list(item.correlations),
            "source": item.source}  # fmt: skip


def _quantity(name: str, value: float | None, unit: str, ends: tuple[float, float] | None) -> dict[str, Any]:
    return {name: {"value": value, "unit": unit}, f"{name}_range": {"value": list(ends or ()), "unit": unit}}


def models(
    *,
    path: Annotated[
        Path | None,
        Parameter(help="Also list the model files in this folder. They are run as Python: list only what you trust."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """List every model with its equations and its own parameters.

    A model that cannot be used is listed with the reason; the exit status is
    then 1. Correlations, which stand below the table, may be named wherever a
    model may.
    """
    with user_errors():
        catalogue = lazy.available_models(path)
    output = Output("models", json=json)
    own = {name: _own(info) for name, info in catalogue.items()}
    described = {
        name: {key: getattr(info, key) for key in ("summary", "equations", "error")} | {"own_parameters": own[name]}
        for name, info in catalogue.items()
    }
    output.document({"models": described})
    rows: list[tuple[str, str]] = []
    for name, info in catalogue.items():
        rows.append((name, info.error or f"{info.summary}  {info.equations}"))
        for parameter, its in own[name].items():
            meaning = f"  {its['symbol']}, {its['meaning']}" if its["symbol"] != parameter else ""
            rows.append(("", f"{parameter} = {its['value']:g}{meaning}"))
    correlations = (
        f"Correlations of engineers can take the place of a model: {', '.join(lazy.CORRELATIONS)}. "
        'Some have a table of targets: "dnv:duplex".'
    )
    output.table("", rows, ("model", "what it says, and the source's equations"), (), [correlations])
    broken = [name for name, info in catalogue.items() if info.error]
    if broken:
        raise RuntimeError(f"{len(broken)} of {len(catalogue)} models cannot be used.")


def _own(info: "lazy.ModelInfo") -> dict[str, dict[str, Any]]:
    """Value and names of a model's own parameters; none of a model that cannot be used."""
    own = {} if info.error else lazy.own_parameters(info.make())
    return {
        name: {
            "value": float(parameter.value),
            "symbol": parameter.quantity.symbol,
            "meaning": parameter.quantity.meaning,
        }
        for name, parameter in own.items()
    }


def validate(
    *,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Compare models and correlations with published numbers.

    Each number has its source. It was measured, or comes from a fit to tests.
    Misses are shown; the exit status is 0 all the same, because a model that
    misses a measurement is computed no worse for it: see `erosion verify`.
    """
    require_outputs(plot=plot)
    with progress_bar("comparing"):
        validation = lazy.against_published()
    draw(plot, lambda: lazy.plot_validation(validation))
    output = Output("validate", json=json)
    output.document(validation.to_dict())
    output.table(validation.title, validation.rows(), validation.headings, (1, 2, 4), validation.conclusions)
    output.wrote(figure=plot)


def verify(
    files: Annotated[list[str] | None, Parameter(negative="", show=False)] = None,
    /,
    *,
    model: ModelsOption = None,
    json: JsonOption = False,
) -> None:
    """Check models against exact and independent solutions.

    The exit status is 1 if an error is out of bounds.

    It checks all models, or those of --model: closed forms, identities, scaling
    and units; the batch against trajectories, scipy and (where it is installed)
    heyoka; derivatives against differences. All models take less than a minute
    on two cores.
    """
    models = chosen_models([*(files or []), *(model or [])])

    with user_errors():
        loaded = {name: lazy.load_model(name) for name in models}
    output = Output("verify", json=json)
    with progress_bar("compiling") as progress:
        verification = lazy.verify(models or None, progress=progress)
    output.warn(*(f"{name} is not installed: one reference solution fewer." for name in verification.absent))
    output.document(verification.to_dict(), loaded)
    failures = [f"✗ {check}" for check in verification.failures]
    output.table(verification.title, verification.rows(), verification.headings, (1, 2, 3), failures)
    if not verification.passed:
        raise RuntimeError(f"{len(verification.failures)} of {len(verification.checks)} checks are out of bounds.")
