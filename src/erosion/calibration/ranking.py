"""Which variant of the model fits the data best."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.calibration.fitting import calibrate
from erosion.calibration.least_squares import CalibrationError
from erosion.calibration.measurements import read_measurements
from erosion.calibration.result import Calibration
from erosion.models import load_model, model_name, usable_models
from erosion.models.base import CuttingModel
from erosion.parameters.parameters import Parameters
from erosion.parameters.units import unit_name
from erosion.tables import Row, to_html, to_text

_SAME = 1e-5  # of the typical erosion: fits nearer than this are one curve under two names


@dataclasses.dataclass(frozen=True)
class Ranking:
    """Fits of several models to the same data, the best first.

    Args:
        fits: by ascending AICc.
        ties: groups of models, by name, whose fits are the same curve: no data of this kind
            tells them apart.
        failures: a sentence for each model that could not be fitted.
    """

    fits: tuple[Calibration, ...]
    ties: tuple[tuple[str, ...], ...]
    failures: tuple[str, ...]

    @property
    def best(self) -> Calibration:
        """The fit of least AICc."""
        return self.fits[0]

    @property
    def names(self) -> tuple[str, ...]:
        """The models, the best first."""
        return tuple(model_name(one.model) for one in self.fits)

    @property
    def weights(self) -> np.ndarray:
        """Akaike weights, how likely each model is if one of them is right; they sum to 1."""
        likely = np.exp([(self.best.aicc - one.aicc) / 2 for one in self.fits])
        return likely / likely.sum()

    def tied_with(self, name: str) -> tuple[str, ...]:
        """The other models that give the same curve as this one."""
        return next((tuple(one for one in tie if one != name) for tie in self.ties if name in tie), ())

    @property
    def statements(self) -> tuple[str, ...]:
        """What the reader must know of models that cannot be told apart, failures, the best fit's own."""
        ties = [f"{', '.join(tie[:-1])} and {tie[-1]} give the same curve: these data cannot tell them apart."
                for tie in self.ties]  # fmt: skip
        return (*ties, *self.failures, *self.best.statements)

    def rows(self) -> list[Row]:
        """A row of a table for each model."""
        rows = []
        for name, one, weight in zip(self.names, self.fits, self.weights, strict=True):
            values = ", ".join(
                f"{key} = {value:.4g}" + (" (not determined)" if key in one.undetermined else "")
                for key, value in one.estimates.items()
            )
            rows.append(
                Row(name, f"{one.aicc - self.best.aicc:.4g}", f"{weight:.1%}", f"{one.leave_one_out:.4g}", values)
            )
        return rows

    @property
    def headings(self) -> tuple[str, ...]:
        """Of the table's columns."""
        unit = unit_name(self.best.data.dimension, self.best.p.units)
        return ("model", "ΔAICc", "weight", "left-out error" + (f" [{unit}]" if unit else ""), "estimates")

    def __str__(self) -> str:
        return "\n".join([to_text(self.title, self.rows(), self.headings), *self.statements])

    def _repr_html_(self) -> str:
        return to_html(self.title, self.rows(), self.headings) + "".join(f"<p>{one}</p>" for one in self.statements)

    @property
    def title(self) -> str:
        """How many models, and what they were fitted to."""
        return f"{len(self.fits)} models fitted to {len(self.best.data):,} rows of {self.best.data.source}"


def rank_models(
    p: Parameters,
    data: Any,
    free: Sequence[str],
    *,
    models: Sequence[CuttingModel | str | Path] | None = None,
    progress: Callable[[str], None] = lambda line: None,
    **options: Any,
) -> Ranking:
    """Fit several models to the same data and order them by AICc.

    Args:
        p: the case: the first guess of the free parameters, and the values of all others.
        data: as for `calibrate`.
        free: the parameters to fit, the same for all models.
        models: models, names or paths; every registered model without it.
        progress: is told which model is being fitted.
        options: `bounds`, `density`, `loss` and `starts` of `calibrate`.

    Raises:
        ValueError: for arguments or data that cannot be used.
        CalibrationError: if no model could be fitted.
    """
    measured = read_measurements(data, p.units)
    fits, failures = [], []
    chosen = usable_models() if models is None else list(models)
    names = [str(one) for one in chosen if isinstance(one, (str, Path))]
    if not chosen or len(set(names)) != len(names):
        raise ValueError(f"Argument `models` must name one or several different models, but is {chosen}.")
    for model in [load_model(one) for one in chosen]:
        progress(f"fitting {model_name(model)}")
        try:
            fits.append(calibrate(model, p, measured, free, **options))
        except CalibrationError as error:
            failures.append(f"{model_name(model)}: {error}")
    if not fits:
        raise CalibrationError(" ".join(failures))
    # Models of one curve differ by rounding: they stay in the order given.
    fits.sort(key=lambda one: round(one.aicc, 3))
    return Ranking(tuple(fits), _ties(fits), tuple(failures))


def _ties(fits: Sequence[Calibration]) -> tuple[tuple[str, ...], ...]:
    """Groups of models with one curve."""
    near = _SAME * float(np.sqrt(np.mean(fits[0].data.erosion ** 2)))
    groups: list[list[Calibration]] = []
    for one in fits:
        group = next((group for group in groups if np.abs(group[0].fitted - one.fitted).max() < near), None)
        if group is None:
            groups.append([one])
        else:
            group.append(one)
    return tuple(tuple(model_name(one.model) for one in group) for group in groups if len(group) > 1)
