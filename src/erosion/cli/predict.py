"""`erosion predict`: the wear at other angles, speeds and sizes, from the draws of a posterior."""

import dataclasses
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
        lazy.check_level(level)
        predictor = lazy.read_predictor(fitted)
        draws = lazy.read_draws(fitted, lazy.quantities(predictor.forward.model), predictor.data.units)
    at = _conditions(predictor, v0, particle)
    asked = np.tile(_axis("alpha", alpha, predictor), (len(at), 1))
    others = {name: np.array([[one[name]] for one in at]) for name in at[0]}
    with user_errors(), progress_bar("predicting"):
        lazy.validate(dataclasses.replace(predictor.forward.p, alpha=asked, **others))
        table = lazy.predictions(predictor, asked, others, level)
        csv = to_csv(dict(table.in_csv())).encode()
    printed = Output("predict", predictor.forward.p, json=json, seed=predictor.seed)
    printed.case = fitted
    printed.warn(None if draws.converged else f"{fitted}: the draws did not converge.", *table.warnings)
    model = predictor.forward.model
    varied = {name: f"{len(set(column.tolist()))} values" for name, column in table.asked.items()}
    printed.document(
        as_json(table.to_dict()),
        {lazy.model_name(model): model},
        table.units,
        dict.fromkeys(predictor.forward.names, "drawn") | varied,
    )
    printed.table(table.title, table.rows(), table.headings, range(len(table.headings)))
    printed.table("how the data are read", predictor.rows(), sentences=table.conclusions)
    if output is not None:
        with user_errors():
            lazy.write_whole(output, csv)
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
