"""What `erosion calibrate` fits, and how.

The files that `erosion calibrate` writes.

What `erosion calibrate --posterior` draws, and the files that it writes.

`--uncertain` of `erosion advise`: the fit to tests that an advice rests on, from its draws or its case file.
"""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Parameter

from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.laws import LawOptions, require_same_model
from erosion.cli.lists import LISTED
from erosion.cli.options import CaseOptions, SetOption, WholeOption, load_set, settings, with_model_of_case
from erosion.cli.output import PerMassOptions, require_outputs
from erosion.parameters.units import has_control_characters, shown

if TYPE_CHECKING:
    from erosion.advice.result import Uncertain
    from erosion.arguments import Progress
    from erosion.fits import Measurements, NextExperiment, PosteriorRanking, Ranking
    from erosion.fits.posterior_files import Draws
    from erosion.models.base import CuttingModel
    from erosion.parameters.parameters import Parameters
    from erosion.parameters.units import Dimension, System


_FREE = 'Parameters to fit, of the case or the model\'s own: "k,cutting_fraction,energy_ratio"; "k,psi" without it.'
_BOUNDS = 'Least and greatest values, of own parameters too: "psi=0.01:0.3,threshold=0:40 m/s".'


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class FitOptions(PerMassOptions):
    """What is fitted, and how."""

    free: Annotated[list[str], LISTED, Parameter(help=_FREE, show_default=False)] = dataclasses.field(
        default_factory=lambda: ["k", "psi"]
    )
    bounds: Annotated[list[str] | None, LISTED, Parameter(help=_BOUNDS)] = None
    loss: Annotated[str, Parameter(help='"linear"; "soft_l1", "huber", "cauchy" or "arctan" with outliers.')] = "linear"
    starts: Annotated[WholeOption, Parameter(help="Points to begin from; 32 without it.")] = None

    def names(self, measured: "Measurements") -> Sequence[str]:
        """All that is fitted: the free parameters, and a scale where the data has one of its own."""
        from erosion.fits.forward import SCALE

        return (*self.free, SCALE) if measured.free_scale else self.free

    def on(self, options: CaseOptions) -> "FitOptions":
        """The same with the density and the cutting fraction of the case or its target, where none are given."""
        per_mass = self.per_mass(options)
        density = None if per_mass.density is None else f"{per_mass.density!r} kg/m^3"
        return dataclasses.replace(self, density=density, cutting_fraction=per_mass.cutting_fraction)

    def arguments(self) -> dict[str, Any]:
        """The arguments of `erosion.calibrate` of the same names, but for `bounds`, which need the models."""
        return {
            "density": self.density,
            "cutting_fraction": 1.0 if self.cutting_fraction is None else self.cutting_fraction,
            "loss": self.loss,
            "starts": 32 if self.starts is None else self.starts,
        }

    def bounds_of(
        self, models: Sequence[str], units: "System", measured: "Measurements"
    ) -> dict[str, tuple[float, float]]:
        """The bounds by parameter, in the units of the case."""
        return _read_bounds(self.bounds or (), self.names(measured), models, units)


def _read_bounds(
    texts: Sequence[str], free: Sequence[str], models: Sequence[str], units: "System"
) -> dict[str, tuple[float, float]]:
    """Bounds such as "psi=0.01:0.3", by parameter, in the units of the case."""
    from erosion.parameters.units import read_quantity, unit_of

    bounds: dict[str, tuple[float, float]] = {}
    for text in texts:
        name, equals, ends = (part.strip() for part in text.partition("="))
        least, colon, greatest = (part.strip() for part in ends.partition(":"))
        if not (name and equals and least and colon and greatest):
            raise InputError(f'Option `--bounds` must be such as "psi=0.01:0.3", but is {text!r}.')
        if name not in free:
            raise InputError(f"Option `--bounds` must name free parameters ({', '.join(free)}), but has {name!r}.")
        if name in bounds:
            raise InputError(f"Option `--bounds` must give {name} once, but gives it several times.")
        dimension = dimension_of(name, models, units)
        # "1:3 GPa" is from 1 GPa. The end with the unit is read first, so that a message shows what was typed.
        shared = unit_of(least) or unit_of(greatest)
        ends_read = {}
        with reading(f"Option `--bounds`, {name},"):
            for end in sorted({least, greatest}, key=unit_of, reverse=True):
                ends_read[end] = read_quantity(end if unit_of(end) else end + shared, dimension, units)
            bounds[name] = ends_read[least], ends_read[greatest]
        if not bounds[name][0] < bounds[name][1]:
            raise InputError(f"Option `--bounds` must give {name} two ascending values, but is {text!r}.")
    return bounds


def dimension_of(name: str, models: Sequence[Any], units: "System") -> "Dimension":
    """What a parameter is measured in: of an impact, of one of the models (names or models), or a factor."""
    from erosion.models import load_model
    from erosion.models.own_parameters import own_parameters
    from erosion.parameters.quantities import QUANTITIES

    if name in QUANTITIES:
        return QUANTITIES[name].dimension
    for model in models:
        with user_errors():
            own = own_parameters(load_model(model))
        if name in own:
            return own[name].quantity.dimension
    return "1"


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class FitFiles:
    """The files that are asked for."""

    plot: Annotated[Path | None, Parameter(help="Draw data, fits and band into this file (.svg, .png, .pdf).")] = None
    openfoam: Annotated[Path | None, Parameter(help="Write OpenFOAM ParticleErosion coefficients.")] = None
    fluent: Annotated[Path | None, Parameter(help="Write the angle function as a piecewise-linear table.")] = None
    write_case: Annotated[Path | None, Parameter(help="Write the best fit as a case file, for --case.")] = None

    @property
    def paths(self) -> tuple[Path | None, ...]:
        """All of them."""
        return self.plot, self.openfoam, self.fluent, self.write_case

    def require_writable(self, inputs: Sequence[Any]) -> None:
        """Know before the fit that all files can be written, and that none of them is read."""
        require_outputs(self.openfoam, self.fluent, self.write_case, plot=self.plot, inputs=inputs)

    def write(self, ranking: "Ranking", level: float, options: CaseOptions) -> tuple[list[Path], list[str]]:
        """Write the files; gives their paths, and what they lack."""
        from erosion.fits import CalibrationError, to_case, to_fluent, to_openfoam
        from erosion.output.files import write_whole

        best, warnings = ranking.best, []
        texts: list[tuple[Path, str]] = []
        # What cannot be represented is refused before anything is written.
        with user_errors(CalibrationError):
            for path, to_form in ((self.openfoam, to_openfoam), (self.fluent, to_fluent)):
                if path is not None:
                    form = to_form(best)
                    texts.append((path, form.text()))
                    warnings += [form.warning] if form.warning else []
            if self.write_case is not None:
                text = to_case(best, str(self.write_case), **options.names(), doubts=ranking.doubts)
                texts.append((self.write_case, text))
            written = []
            if self.plot is not None:
                from erosion.plotting.fits import plot_calibration
                from erosion.plotting.style import save_plot

                written.append(save_plot(plot_calibration(ranking.best_first, level), self.plot))
            for path, text in texts:
                write_whole(path, text.encode())
                written.append(path)
        return written, warnings


_PRIOR = 'Law of a parameter before the data: "psi=uniform(0.01, 0.2)"; repeat it for other parameters, or "noise".'


class Drawn(NamedTuple):
    """What was drawn: the posteriors of all models, and the next experiment if it is asked for."""

    posteriors: "PosteriorRanking"
    experiment: "NextExperiment | None"


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class DrawOptions:
    """What is drawn, and into which files."""

    posterior: Annotated[
        bool, Parameter(negative="", help="Also draw all values that data and priors leave, and find the evidence.")
    ] = False
    prior: Annotated[list[str] | None, Parameter(negative="", help=_PRIOR)] = None
    draws: Annotated[WholeOption, Parameter(help="Of each of 4 populations; 500 without it.")] = None
    seed: Annotated[WholeOption, Parameter(help="The same seed gives the same draws.")] = None
    output: Annotated[
        Path | None,
        Parameter(
            name=("--output", "-o"),
            help="Keep the likeliest model's draws in this file (.nc), for --uncertain of map, stream and advise.",
        ),
    ] = None
    plot_pairs: Annotated[Path | None, Parameter(help="Draw each pair of parameters.")] = None
    plot_traces: Annotated[Path | None, Parameter(help="Draw the populations, one draw after the other.")] = None
    plot_prediction: Annotated[Path | None, Parameter(help="Draw the bands of the curve, with its jumps.")] = None
    plot_best_angles: Annotated[Path | None, Parameter(help="Draw the angles of greatest removal.")] = None
    next_experiment: Annotated[
        bool, Parameter(negative="", help="Say at which angle and speed one more row would tell most.")
    ] = False
    next_speeds: Annotated[
        list[str] | None,
        LISTED,
        Parameter(help='That can be tested next: "60 m/s,110 m/s"; those of the data without it.'),
    ] = None
    plot_next_experiment: Annotated[
        Path | None, Parameter(help="Draw how much a row would tell, over angle and speed.")
    ] = None

    @property
    def seed_used(self) -> int | None:
        """The seed of the draws, where there are any."""
        return (0 if self.seed is None else self.seed) if self.posterior else None

    @property
    def figures(self) -> dict[str, Path]:
        """The figures that are asked for, by the name of their function."""
        names = ("plot_pairs", "plot_traces", "plot_prediction", "plot_best_angles", "plot_next_experiment")
        return {name: path for name in names if (path := getattr(self, name)) is not None}

    def require_sense(self, p: "Parameters", taken: Sequence[Path | None], inputs: Sequence[Any]) -> None:
        """Know before computing that the options go together, and that all files can be written.

        Args:
            p: the case.
            taken: other files that the verb writes.
            inputs: what the verb reads.
        """
        if not self.posterior:
            for field in dataclasses.fields(self):
                given = getattr(self, field.name)
                if given is not None and given is not False:
                    raise InputError(f"Option `--{field.name.replace('_', '-')}` needs `--posterior`.")
            return
        if self.output is not None and self.output.suffix != ".nc":
            raise InputError(f"Option `--output` must end in .nc, but is {self.output}.")
        self.speeds(p)
        from erosion.plotting.style import require_plot_path

        with user_errors():
            for path in self.figures.values():
                require_plot_path(path)
        require_outputs(self.output, *self.figures.values(), *taken, inputs=inputs)

    def laws(self, measured: "Measurements", models: Sequence[Any], fit: FitOptions) -> Mapping[str, Any]:
        """The laws that are given, by parameter; checked before anything is computed."""
        return _read_priors(self.prior or (), fit.names(measured), models, measured)

    def drawn(
        self,
        p: "Parameters",
        ranking: "Ranking",
        fit: FitOptions,
        laws: Mapping[str, Any],
        progress: "Progress",
    ) -> "Drawn | None":
        """The posteriors of the models that are ranked, and the next experiment; None where they are not asked for."""
        if not self.posterior:
            return None
        free = [name for name in fit.free if any(name in ranked.names for ranked in ranking.ranked)]
        from erosion.fits import ConvergenceWarning, rank_posteriors

        with warnings.catch_warnings():
            # The result says it in its own sentences.
            warnings.simplefilter("ignore", ConvergenceWarning)
            posteriors = rank_posteriors(
                p,
                ranking.best.data,
                free,
                models=[ranked.problem.forward.model for ranked in ranking.ranked],
                priors={name: law for name, law in laws.items() if name in free or name not in fit.free},
                progress=progress,
                **{name: fit.arguments()[name] for name in ("density", "cutting_fraction")},
                draws=500 if self.draws is None else self.draws,
                seed=self.seed_used or 0,
            )
        return Drawn(posteriors, self._experiment(posteriors, p))

    def speeds(self, p: "Parameters") -> list[float]:
        """The speeds that can be tested next, if they are given."""
        from erosion.parameters.units import read_quantity

        with reading("Option `--next-speeds`"):
            speeds = [read_quantity(text, "speed", p.units) for text in self.next_speeds or ()]
        if not all(speed > 0 for speed in speeds):
            raise InputError(
                f"Option `--next-speeds` must list positive speeds, but is {', '.join(self.next_speeds or ())}."
            )
        return speeds

    def _experiment(self, posteriors: "PosteriorRanking", p: "Parameters") -> "NextExperiment | None":
        """Where one more row tells most, of all models together; None where that is not asked for."""
        if not (self.next_experiment or self.next_speeds or self.plot_next_experiment):
            return None
        import numpy as np

        from erosion.fits.experiments import DEGREES, next_experiment

        forward, speeds = posteriors.best.likelihood.forward, self.speeds(p)
        if not speeds and "v0" not in forward.of_impact:
            speeds = np.unique(forward.data.conditions.get("v0", float(p.v0))).tolist()
        others = {"v0": np.array(speeds)} if speeds else {}
        with user_errors():
            return next_experiment(posteriors, {"alpha": np.deg2rad(DEGREES)[:, None], **others})

    def write(self, drawn: "Drawn") -> list[Path]:
        """Write the files; gives their paths."""
        from erosion.plotting import fits as figures
        from erosion.plotting.style import save_plot

        posterior, written = drawn.posteriors.best, []
        with user_errors():
            for name, path in self.figures.items():
                result: Any = posterior.alpha_max() if name == "plot_best_angles" else posterior
                if name == "plot_next_experiment":
                    result = drawn.experiment
                written.append(save_plot(getattr(figures, name)(result), path))
            if self.output is not None:
                written.append(posterior.save(self.output))
        return written


def _read_priors(
    texts: Sequence[str], free: Sequence[str], models: Sequence[Any], measured: "Measurements"
) -> Mapping[str, Any]:
    """Laws such as "psi=uniform(0.01, 0.2)", by parameter."""
    from erosion.distributions import LAWS, read_distribution
    from erosion.fits.tempering import NOISE

    known = (*free, NOISE) if measured.uncertainty is None else free
    laws: dict[str, Any] = {}
    for text in texts:
        name, _, law = (part.strip() for part in text.partition("="))
        if name not in known:
            raise InputError(
                f'Option `--prior` must be such as "{known[0]}=uniform(1, 3)", of {", ".join(known)}, but is {text!r}.'
            )
        if name in laws:
            raise InputError(f"Option `--prior` must give {name} once, but gives it several times.")
        dimension = measured.dimension if name == NOISE else dimension_of(name, models, measured.units)
        with reading(f"Option `--prior`, {name},"):
            read = read_distribution(law, name, dimension, measured.units)
        if read is None:
            listed = ", ".join((*LAWS, "samples"))
            raise InputError(f"Option `--prior`, {name}, must be a law ({listed}), but is {law!r}.")
        laws[name] = read
    return laws


FIELDS = ("model", "set", "uncertain", "correlation", "warning")
"""The fields of [advise] in a case file."""

_UNCERTAIN = (
    "In place of the ranges of k and ψ: the file of `calibrate --posterior -o` (.nc), draws in a .csv file, or "
    '"k=normal(2, 0.2)"; repeat it for other parameters.'
)


def section_of(case: CaseOptions, models: Sequence[str] | None) -> Mapping[str, Any]:
    """The table [advise] of a case file, with the model that the file names for all verbs."""
    return with_model_of_case(case.section("advise", FIELDS, parameters=False), case, models)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class TestedFitOptions:
    """What tests have said of the metal; texts as they are typed."""

    uncertain: Annotated[list[str] | None, Parameter(negative="", help=_UNCERTAIN)] = None
    own: SetOption = None


@dataclasses.dataclass(frozen=True)
class GivenFit:
    """The options with the table [advise] of the case file; options win.

    Args:
        options: of the fit.
        case: of the impact.
        section: the table.
    """

    options: TestedFitOptions
    case: CaseOptions
    section: Mapping[str, Any]

    def __post_init__(self) -> None:
        _ = self.doubts  # are read before anything is computed

    @property
    def files(self) -> list[str]:
        """The files that are read."""
        return self._laws.files

    def models(self, names: Sequence[str] | None, p: "Parameters") -> "dict[str, CuttingModel]":
        """The models by name: those of --model, of the case file, of the draws, or the usual ones."""
        from erosion.advice.advise import MODELS

        chosen = list(names or self._model_of_file or self._model_of_draws() or MODELS)
        own = settings(self.options.own, self.section, f"{self.case.case}: `set` of [advise]")
        if own and len(chosen) > 1:
            raise InputError(f"{next(iter(own.values()))[0]} needs one model, but there are {', '.join(chosen)}.")
        from erosion.models import called

        loaded = {name: load_set(name, own, self.case, p.units) for name in chosen}
        return {called(name, model): model for name, model in loaded.items()}

    def uncertain(
        self, models: "Mapping[str, CuttingModel]", p: "Parameters", *, has_fraction: bool
    ) -> "tuple[Uncertain | None, list[Draws]]":
        """The laws, or None where there are none, and the posteriors' files that were read.

        Args:
            models: by name.
            p: the case.
            has_fraction: whether --cutting-fraction is given.
        """
        from erosion.advice.result import Uncertain

        given = self._laws
        _, laws, draws = given.read(next(iter(models.values())), p.units, {})
        for model in models.values():
            require_same_model(draws, model, given.uncertain[0])
        if not laws:
            return None, draws
        in_options = self.options.uncertain is not None
        uncertain = Uncertain(laws, "" if in_options else str(self.case.case))
        with user_errors():
            uncertain.require_of_metal(models, given.uncertain[0])
        self._refuse_options_beside(uncertain, has_fraction=has_fraction)
        return uncertain, draws

    def _refuse_options_beside(self, uncertain: "Uncertain", *, has_fraction: bool) -> None:
        """An `InputError` for an option that sets what has a law: one of the two would be left aside."""
        from erosion.fits.forward import FRACTION

        options = {name: name for name in self.case.given()}
        options |= {text.partition("=")[0].strip(): "set" for text in self.options.own or ()}
        if has_fraction:
            options[FRACTION] = "cutting-fraction"
        if self.options.uncertain is None and self.case.target is not None:
            options["sigma"] = "target"
        for name, option in options.items():
            if name in uncertain.laws:
                raise InputError(f"Option `--{option}` cannot set {name}, which has a law in {uncertain}.")

    @property
    def doubts(self) -> tuple[str, ...]:
        """The warning of the case file's table, that the tests were in units of their own for example."""
        warning = self.section.get("warning")
        if warning is None:
            return ()
        if not isinstance(warning, str) or not warning.strip() or has_control_characters(warning):
            raise InputError(
                f"{self.case.case}: field `warning` of [advise] must be a sentence, but is {shown(warning)}."
            )
        return (f"{self.case.case}: {warning}",)

    @property
    def _model_of_file(self) -> list[str] | None:
        name = self.section.get("model")
        if not (name is None or isinstance(name, str)):
            raise InputError(f"{self.case.case}: field `model` of [advise] must be a name, but is {name!r}.")
        return None if name is None else [name]

    def _model_of_draws(self) -> list[str] | None:
        from erosion.fits.posterior_files import model_of_draws

        paths = [path for path in self.files if path.endswith(".nc")]
        with user_errors():
            return [model_of_draws(path) for path in paths[:1]] or None

    @property
    def _laws(self) -> Any:
        """The laws of the options; without one those of the case file, with their correlation."""
        section = self.section if self.options.uncertain is None else {}
        where = f"{self.case.case}: field `{{}}` of [advise]"
        return LawOptions(uncertain=self.options.uncertain).with_section(section, where)
