"""`erosion advise`: the nozzle's angle and the erosion to expect, on one page."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Group, Parameter

from erosion.cli import lazy
from erosion.cli.errors import InputError, user_errors
from erosion.cli.fitting import GivenFit, TestedFitOptions, section_of
from erosion.cli.lists import ModelsOption, chosen_models
from erosion.cli.options import (
    OUTPUT,
    AllAngles,
    CaseArgument,
    JsonOption,
    LangOption,
    PlotOption,
    output_option,
    read_option,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, draw, progress_bar, require_outputs, weighing


@Parameter(name="*", group=Group("Job", sort_key=7))
@dataclasses.dataclass(frozen=True)
class JobOptions:
    """What is to be removed, and with what else."""

    area: Annotated[str | None, Parameter(help='To remove from, for kg of abrasive: "2 m^2".')] = None
    depth: Annotated[str | None, Parameter(help='To remove: "50 um".')] = None
    feed: Annotated[str | None, Parameter(help='Abrasive, for the time: "5 kg/min".')] = None
    compare: Annotated[str | None, Parameter(help='Another abrasive: "aluminium oxide 0.2 mm".')] = None

    def job(self) -> "lazy.Job | None":
        """The job, where there is one."""
        area = read_option("area", self.area, "area", "si")
        depth = read_option("depth", self.depth, "length", "si")
        feed = read_option("feed", self.feed, "mass flow", "si")
        if area is None and depth is None and feed is None:
            return None
        if area is None or depth is None:
            raise InputError("--area and --depth belong together: give both.")
        with user_errors():
            return lazy.Job(area, depth, feed)


def advise(
    file: CaseArgument = None,
    /,
    *,
    case: AllAngles | None = None,
    spread: Annotated[
        str, Parameter(help="Standard deviation of the angles in the jet, about half of its half opening angle.")
    ] = "3 deg",
    speed_spread: Annotated[float, Parameter(help="Standard deviation of the speeds: 0.1 is 10 %.")] = 0.0,
    abrasive: PerMassOptions | None = None,
    model: ModelsOption = None,
    fit_of_tests: TestedFitOptions | None = None,
    shop: JobOptions | None = None,
    output: Annotated[
        Path | None, output_option("Also write it as a page, .html or .pdf, or its angles as a table, .csv.")
    ] = None,
    decimal: Annotated[str | None, Parameter(group=OUTPUT, help='Of the table, "." or ","; that of --lang.')] = None,
    plot: PlotOption = None,
    lang: LangOption = "en",
    json: JsonOption = False,
) -> None:
    """Advise a nozzle's angle: the erosion to expect, and how sure.

    Give --particle, --target and --v0. Models, correlations, the force ratio k,
    the contact ratio ψ and the spread of the jet are compared. Without
    --cutting-fraction half of the particles cut, as Finnie found.

    After tests of your own: --uncertain with the draws of `posterior -o`, or the
    case file of `calibrate --write-case`. They take the place of the ranges of k
    and ψ, and the correlations do not count.
    """
    options = with_file(case, file)
    options.refuse_angle("all angles of the nozzle are compared")
    p = options.parameters()
    deviation = read_option("spread", spread, "angle", "si")
    fit = GivenFit(fit_of_tests or TestedFitOptions(), options, section_of(options, model))
    shop = shop or JobOptions()
    job = shop.job()
    with user_errors():
        other = lazy.compared_with(shop.compare, *options.materials())
    _require(output, plot, (options.case, *fit.files, *(model or ())), lang)
    models = fit.models(chosen_models(model), p)
    abrasive = abrasive or PerMassOptions()
    uncertain, draws = fit.uncertain(models, p, has_fraction=abrasive.cutting_fraction is not None)
    per_mass = abrasive.per_mass(options, _usual_fraction(uncertain, draws))
    for chosen in models.values():
        weighing(chosen, abrasive, options)  # refuses the density of another metal than a correlation's
    with progress_bar("advise") as progress, user_errors():
        advice = lazy.advise_case(
            p, options.materials(), (deviation, speed_spread), per_mass, models, uncertain, progress
        )
        advice = dataclasses.replace(advice, doubts=fit.doubts, job=job, other=other)
    if output is not None:
        with user_errors():
            lazy.write_advice(advice, output, lang, decimal)
    draw(plot, lambda: lazy.plot_advice(dataclasses.replace(advice, language=lazy.language(lang))))
    printed = Output("advise", p, options, json=json)
    printed.warn(*advice.warnings, *(lazy.unused_columns(uncertain.laws) if uncertain else ()))
    for part in draws:
        for chosen in models.values():
            printed.warn(*part.doubts(chosen, advice.p, advice.per_mass.cutting_fraction))
    printed.document(advice.to_dict(), models, lazy.UNITS)
    printed.table("", advice.rows(), advice.headings, (), advice.reasons, [advice.title, *advice.answers])
    printed.wrote(figure=plot, page=output)


def _usual_fraction(uncertain: "lazy.Uncertain | None", draws: "Sequence[lazy.Draws]") -> float:
    """The share of the particles that cut, where nothing gives it: that of the fit, or Finnie's."""
    if uncertain is None:
        return lazy.CUTTING_FRACTION
    return next((part.cutting_fraction for part in draws if part.cutting_fraction is not None), lazy.FRACTION_OF_A_FIT)


def _require(output: Path | None, plot: Path | None, inputs: Sequence[Any], lang: str) -> None:
    """Know before computing that the page and the figure can be written, in the language."""
    with user_errors():
        lazy.language(lang)
    require_outputs(output, plot=plot, inputs=inputs)
    if output is not None:
        with user_errors():
            lazy.require_page_path(output)
