"""`erosion stream`: a jet of particles whose parameters vary."""

import dataclasses
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.laws import LAW_FIELDS, LawOptions, case_and_laws
from erosion.cli.lists import ModelOption
from erosion.cli.options import (
    LAWS,
    CaseArgument,
    CaseOptions,
    JsonOption,
    PlotOption,
    SetOption,
    WholeOption,
    output_option,
    read_whole,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing

_NO_LAW = (
    'A stream must have a law of a parameter, an option such as --v0 "normal(110 m/s, 10 m/s)" or the same in the '
    "case's table [stream], but has none."
)


def stream(
    file: CaseArgument = None,
    /,
    *,
    case: CaseOptions | None = None,
    model: ModelOption | None = None,
    own: SetOption = None,
    joint: LawOptions | None = None,
    abrasive: PerMassOptions | None = None,
    n: Annotated[WholeOption, Parameter(name="--n", group=LAWS, help="Particles: 1e6; a million without it.")] = None,
    seed: Annotated[WholeOption, Parameter(group=LAWS, help="The same seed gives the same stream.")] = None,
    points: Annotated[str | None, Parameter(group=LAWS, help='"sobol" (scrambled) or "random".')] = None,
    best_angle: Annotated[bool, Parameter(help="Look for the nozzle's angle that removes most.")] = True,
    output: Annotated[Path | None, output_option("Keep it in this file (.nc), to go on from.", ".nc")] = None,
    plot: PlotOption = None,
    json: JsonOption = False,
) -> None:
    """Compute the erosion by a stream of particles, and its best angle.

    Any parameter of the case may vary: --alpha "normal(20deg, 3deg)",
    --v0 "lognormal(110 m/s, 0.1)", --phidot0 "uniform(-1e4, 1e4)",
    --m "weibull(50ug, 3)", --r "rosin-rammler(1mm, 3, 0.2mm)",
    --v0 "samples(jet.csv)". A model's own parameters may vary as well:
    --set "friction=normal(0.2, 0.02)". What is one number for all particles but
    not known is --uncertain: its error does not average out. A case file gives
    the same in a table [stream]; options win.
    """
    options = with_file(case, file)
    section = options.section("stream", ("model", "n", "seed", "points", "set", *LAW_FIELDS))
    jet = case_and_laws(options, "stream", section, model, own, joint)
    with reading(f"{options.case}: field `n` of [stream]"):
        count = read_whole(section.get("n", 2**20)) if n is None else n
    require_outputs(plot=plot, inputs=jet.inputs)
    number = section.get("seed", 0) if seed is None else seed
    printed = Output("stream", jet.p, options, json=json, seed=number)
    varied, uncertain, draws = jet.read_laws()
    if not (varied or uncertain):
        raise InputError(_NO_LAW)
    with user_errors(TypeError, fields=options.fields("stream", section, n=n, seed=seed, points=points)):
        made = lazy.StreamOptions(count, number, points or section.get("points", "sobol"), best_angle, store=output)
        job = lazy.prepare_stream(jet.model, jet.p, varied, made, uncertain)
    per_mass = weighing(jet.model, abrasive, options)
    printed.warn(*lazy.unused_columns({**varied, **uncertain}), *lazy.columns_apart(varied))
    for part in draws:
        printed.warn(*part.doubts(jet.model, jet.p, per_mass.cutting_fraction))
    try:
        with progress_bar("stream") as progress:
            result = dataclasses.replace(job.run(progress), per_mass=per_mass)
    except lazy.StreamInterrupted as interrupted:
        if interrupted.partial is not None:
            _show(dataclasses.replace(interrupted.partial, per_mass=per_mass), jet.name, printed)
        raise
    draw(plot, lambda: lazy.plot_stream(result))
    _show(result, jet.name, printed)


def _show(result: "lazy.Stream", name: str, output: Output) -> None:
    output.warn(*result.warnings, result.erosion_warning)
    described = ("model", "own_parameters", "parameters", "laws", "units")
    content = result.to_dict()
    numbers = {name: value for name, value in content.items() if name not in described}
    units = content["units"] | dict.fromkeys(("quantiles",), content["units"]["mean_volume"])
    if "alpha_max" in units:
        units["alpha_max_interval"] = units["alpha_max"]
    output.document(numbers, {name: result.model}, units, result.laws_in_words())
    output.table(result.title, result.rows())
