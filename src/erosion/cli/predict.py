"""`erosion predict`: the wear at other angles, speeds and sizes, from the draws of a posterior."""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import reading, user_errors
from erosion.cli.fitting import as_json
from erosion.cli.options import JsonOption, PlotOption, output_option
from erosion.cli.output import Output, draw, progress_bar, require_outputs
from erosion.output.tables import to_csv
from erosion.parameters.quantities import QUANTITIES

_DRAWS = 2000  # the ends of an interval are known to some percents of its width
_COMPUTED = ("mean", "mean_low", "mean_high", "weighing_low", "weighing_high")


def predict(
    fitted: Annotated[Path, Parameter(help="The file of `erosion posterior -o` (.nc).")],
    /,
    *,
    alpha: Annotated[
        str, Parameter(help='Angles: "35 deg", "20deg, 40deg" or first : last : count.')
    ] = "10deg:90deg:9",
    v0: Annotated[str | None, Parameter(help='Speeds: "60 m/s, 120 m/s"; those of the tests without it.')] = None,
    particle: Annotated[
        str | None, Parameter(help='For r, b and m, as "garnet 0.5 mm"; those of the tests without it.')
    ] = None,
    level: Annotated[float, Parameter(help="Of the intervals.")] = 0.95,
    output: Annotated[Path | None, output_option("Write the table into this file (.csv).", ".csv")] = None,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Predict the wear from a fit, with honest intervals.

    The table has the mean at each angle and speed, the interval of the mean and
    that of a new weighing. A warning says how far a question lies outside the
    tests.
    """
    import numpy as np

    require_outputs(output, plot=plot, inputs=(fitted,))
    with user_errors():
        ends = [(1 - lazy.check_level(level)) / 2, (1 + level) / 2]
        predictor = lazy.read_predictor(fitted)
        draws = lazy.read_draws(fitted, lazy.quantities(predictor.forward.model), predictor.data.units)
    at = _conditions(predictor, v0, particle)
    asked = np.tile(_axis("alpha", alpha, predictor), (len(at), 1))
    others = {name: np.array([[one[name]] for one in at]) for name in at[0]}
    with user_errors(), progress_bar("predicting"):
        lazy.validate(dataclasses.replace(predictor.forward.p, alpha=asked, **others))
        means, weighings = (predictor.predict(asked, others, _DRAWS, noise=noise) for noise in (False, True))
    printed = Output("predict", predictor.forward.p, json=json, seed=predictor.seed)
    printed.case, lost = fitted, float(np.isnan(means).mean())
    printed.warn(
        None if draws.converged else f"{fitted}: the draws did not converge.",
        *predictor.warnings,
        *predictor.outside(asked, others),
        f"{lost:.1%} of the impacts could not be computed and are left out." if lost else None,
    )
    of_mean, of_weighing = (np.nanquantile(values, ends, axis=0) for values in (means, weighings))
    columns = {"alpha": asked, **{name: others[name] for name in ("v0", "m") if name in others}}
    columns |= dict(zip(_COMPUTED, (np.nanmean(means, axis=0), *of_mean, *of_weighing), strict=True))
    table = _Table(predictor, {name: np.broadcast_to(part, asked.shape).ravel() for name, part in columns.items()})
    table.show(printed, level)
    if output is not None:
        with user_errors():
            lazy.write_whole(output, to_csv(dict(table.in_csv())).encode())
    draw(plot, lambda: lazy.plot_means(predictor, at))
    printed.wrote(table=output, plot=plot)


def _axis(name: str, text: str, predictor: "lazy.Predictor") -> Any:
    """The values of an option, shape (n,)."""
    import numpy as np

    with reading(f"Option `--{name}`"):
        return np.atleast_1d(lazy.read_axis(text, QUANTITIES[name].dimension, predictor.data.units))


def _conditions(predictor: "lazy.Predictor", v0: str | None, particle: str | None) -> list[dict[str, float]]:
    """What is asked beside the angle, each once: the speeds and masses of the tests, or those of the options."""
    forward = predictor.forward
    with user_errors():
        size = {} if particle is None else lazy.particle(particle).parameters(predictor.data.units)
    usual = {} if "v0" in forward.names else {"v0": float(forward.p.v0)}
    groups = [{**usual, **group.values, **size} for group in lazy.conditions(predictor.data, lazy.MOST)]
    if v0 is not None:
        groups = [{**group, "v0": speed} for group in groups for speed in _axis("v0", v0, predictor).tolist()]
    return [dict(each) for each in dict.fromkeys(tuple(group.items()) for group in groups)]


@dataclasses.dataclass(frozen=True)
class _Table:
    """What is asked and what is computed, each column of shape (n,), in the units of the data."""

    predictor: "lazy.Predictor"
    columns: Mapping[str, Any]

    def _dimension(self, name: str) -> "lazy.Dimension":
        return self.predictor.data.dimension if name in _COMPUTED else QUANTITIES[name].dimension

    @functools.cached_property
    def _scales(self) -> "dict[str, lazy.Scale]":
        """The unit in which each column reads well; what is computed has that of the tests."""
        largest = {name: lazy.largest_of(part) for name, part in self.columns.items()}
        largest |= dict.fromkeys(_COMPUTED, lazy.largest_of(self.predictor.data.erosion))
        units = self.predictor.data.units
        return {name: lazy.table_scale(self._dimension(name), units, most) for name, most in largest.items()}

    def in_csv(self) -> Iterator[tuple[str, list[float]]]:
        """Headings such as "mean [mg/kg]", and their numbers."""
        for name, scale in self._scales.items():
            known = lazy.known_scales(self._dimension(name), self.predictor.data.units)
            size, unit = scale if scale in known else known[0]
            yield f"{name} [{lazy.ascii_unit(unit).replace('°', 'deg')}]", (self.columns[name] / size).tolist()

    def show(self, printed: Output, level: float) -> None:
        """As JSON, or as tables with what the intervals hold."""
        predictor, data, forward = self.predictor, self.predictor.data, self.predictor.forward
        units = {name: lazy.ascii_unit(lazy.unit_name(self._dimension(name), data.units)) for name in self.columns}
        lines = zip(*(part.tolist() for part in self.columns.values()), strict=True)
        records = [dict(zip(self.columns, line, strict=True)) for line in lines]
        name = lazy.model_name(forward.model)
        varied = dict.fromkeys(forward.names, "drawn") | {
            name: f"{len(set(part.tolist()))} values" for name, part in self.columns.items() if name in QUANTITIES
        }
        content = {"level": level, "predictions": records, **as_json(predictor.to_dict())}
        printed.document(content, {name: forward.model}, units, varied)
        cells = {name: [_digits(value / self._scales[name].size) for value in part]
                 for name, part in self.columns.items()}  # fmt: skip
        given = [column for column in self.columns if column not in _COMPUTED]
        rows = zip(*(cells[column] for column in (*given, "mean")),
                   *([f"{low} … {high}" for low, high in zip(cells[f"{of}_low"], cells[f"{of}_high"], strict=True)]
                     for of in ("mean", "weighing")), strict=True)  # fmt: skip
        heads = [f"{QUANTITIES[column].symbol} [{self._scales[column].unit}]" for column in given]
        wear, share = self._scales["mean"].unit or "1", f"{100 * level:g} %"
        heads += [f"mean [{wear}]", f"{share} of the mean", f"{share} of a new weighing"]
        title = f"{name}: {data.quantity.meaning} by the fit to {len(data):,} rows of {data.source}"
        known = None if data.error is None else data.error.in_words(data.dimension, data.units)
        error = "the error that the fit found" if known is None else f"its error, {known}"
        holds = f"The interval of the mean holds {', '.join(predictor.parts)}; that of a new weighing also {error}."
        printed.table(title, [*rows], heads, range(len(heads)))
        printed.table("how the data are read", predictor.rows(), sentences=[holds])


def _digits(value: float) -> str:
    return f"{float(f'{value:.4g}'):.10g}"
