"""What `erosion calibrate --posterior` draws, and the files that it writes."""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from cyclopts import Parameter

from erosion.cli.errors import InputError, reading, user_errors
from erosion.cli.fit_options import FitOptions, dimension_of
from erosion.cli.lists import LISTED
from erosion.cli.options import WholeOption
from erosion.cli.output import require_outputs

if TYPE_CHECKING:
    from erosion.arguments import Progress
    from erosion.calibration import Measurements, Ranking
    from erosion.parameters.parameters import Parameters
    from erosion.posteriors import NextExperiment, PosteriorRanking

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
        from erosion.posteriors import ConvergenceWarning, rank_posteriors

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

        from erosion.posteriors.experiments import DEGREES, next_experiment

        forward, speeds = posteriors.best.likelihood.forward, self.speeds(p)
        if not speeds and "v0" not in forward.of_impact:
            speeds = np.unique(forward.data.conditions.get("v0", float(p.v0))).tolist()
        others = {"v0": np.array(speeds)} if speeds else {}
        with user_errors():
            return next_experiment(posteriors, {"alpha": np.deg2rad(DEGREES)[:, None], **others})

    def write(self, drawn: "Drawn") -> list[Path]:
        """Write the files; gives their paths."""
        from erosion.plotting import posteriors as figures
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
    from erosion.posteriors.priors import NOISE

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
