"""`erosion advise`: the nozzle's angle and the erosion to expect, on one page."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from erosion.cli.errors import user_errors
from erosion.cli.fitting import GivenFit, TestedFitOptions, section_of
from erosion.cli.kept_programs import start_engine
from erosion.cli.lists import ModelsOption, chosen_models
from erosion.cli.options import (
    OUTPUT,
    AllAngles,
    CaseArgument,
    JsonOption,
    LangOption,
    PlotOption,
    read_option,
    with_file,
)
from erosion.cli.output import Output, PerMassOptions, print_paths, print_table, progress_bar, require_outputs, weighing

if TYPE_CHECKING:
    from erosion.advice.result import Advice, Uncertain
    from erosion.fits.posterior_files import Draws


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
    output: Annotated[
        Path | None,
        Parameter(name=("--output", "-o"), group=OUTPUT, help="Also write it as a page: advice.html or advice.pdf."),
    ] = None,
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
    _require(output, plot, (options.case, *fit.files, *(model or ())), lang)
    models = fit.models(chosen_models(model), p)
    abrasive = abrasive or PerMassOptions()
    uncertain, draws = fit.uncertain(models, p, has_fraction=abrasive.cutting_fraction is not None)
    per_mass = abrasive.per_mass(options, _usual_fraction(uncertain, draws))
    for chosen in models.values():
        weighing(chosen, abrasive, options)  # refuses the density of another metal than a correlation's
    start_engine()
    from erosion.advice.advise import advise_case
    from erosion.joint_laws import unused_columns

    with progress_bar("advise") as progress, user_errors():
        advice = advise_case(p, options.materials(), (deviation, speed_spread), per_mass, models, uncertain, progress)
        advice = dataclasses.replace(advice, doubts=fit.doubts)
    with user_errors():
        _write(advice, output, plot, lang)
    printed = Output("advise", p, options.case, json=json)
    for message in advice.warnings:
        if message not in printed.warnings:
            printed.warn(message)
    printed.warn_all([] if uncertain is None else [unused_columns(uncertain.laws)])
    for part in draws:
        printed.warn_all([part.doubts(model, advice.p, advice.per_mass.cutting_fraction) for model in models.values()])
    if json:
        from erosion.advice.result import UNITS

        printed.document(advice.to_dict(), models, UNITS)
        return
    print_table(advice.title, advice.rows(), advice.headings, (), advice.conclusions)
    print_paths(figure=plot, page=output)


def _usual_fraction(uncertain: "Uncertain | None", draws: "Sequence[Draws]") -> float:
    """The share of the particles that cut, where nothing gives it: that of the fit, or Finnie's."""
    from erosion.advice.advise import CUTTING_FRACTION, FRACTION_OF_A_FIT

    if uncertain is None:
        return CUTTING_FRACTION
    return next((part.cutting_fraction for part in draws if part.cutting_fraction is not None), FRACTION_OF_A_FIT)


def _require(output: Path | None, plot: Path | None, inputs: Sequence[Any], lang: str) -> None:
    """Know before computing that the page and the figure can be written, in the language."""
    from erosion.output.language import language

    with user_errors():
        language(lang)
    require_outputs(output, plot=plot, inputs=inputs)
    if output is not None:
        from erosion.advice.page import require_page_path

        with user_errors():
            require_page_path(output)


def _write(advice: "Advice", output: Path | None, plot: Path | None, lang: str) -> None:
    """Write the page and the figure that are asked for."""
    from erosion.output.language import language

    if output is not None:
        from erosion.advice.page import write_advice

        write_advice(advice, output, lang)
    if plot is not None:
        from erosion.advice.page import plot_advice
        from erosion.plotting.style import save_plot

        save_plot(plot_advice(dataclasses.replace(advice, language=language(lang))), plot)
