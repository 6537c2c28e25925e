"""`calibrate`: the parameters with which a model comes nearest to measured erosion."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from erosion.arguments import check_whole
from erosion.calibration.forward import Forward, check_free
from erosion.calibration.least_squares import LOSSES, fit, make_problem
from erosion.calibration.measurements import Measurements, read_measurements
from erosion.calibration.result import Calibration
from erosion.models import load_model
from erosion.models.base import CuttingModel
from erosion.models.own_parameters import require_one_impact
from erosion.parameters.parameters import Parameters, validate
from erosion.parameters.units import about, example, has_unit, read_quantity, shown

_GREATEST = 1e100  # m³ or m³/kg


def calibrate(
    model: CuttingModel | str | Path,
    p: Parameters,
    data: Any,
    free: Sequence[str],
    *,
    bounds: Mapping[str, Sequence[float]] | None = None,
    density: float | str | None = None,
    cutting_fraction: float = 1.0,
    loss: str = "linear",
    starts: int = 32,
) -> Calibration:
    """Fit parameters of a model to measured erosion, by least squares.

    Args:
        model: a model, its name, or the path of its file; the first guess of its own parameters.
        p: the case: the first guess of the free parameters, and the values of all others.
        data: a CSV file, columns by header, or `Measurements`; see `read_measurements`.
        free: the parameters to fit, of the case or the model's own: ["k", "psi"]; or
            "cutting_fraction".
        bounds: (least, greatest) of free parameters, in the case's units; by default a factor
            of 100 about the first guess, and of the spin ±2 v₀/r about it; of an own parameter
            that starts at zero or below it, ±2 times its size (of zero: 1), but not below its least
            value; of an own speed with a least value, up to the data's greatest normal speed. The first guess is
            the case, but ψ, σ or the cutting fraction, the first of these that is free, is
            guessed from the size of the data; and an own stress is σψ at first, if that fits better.
        density: of the target [density], a number in the case's units or "2.7 g/cm^3"; needed
            for data of mass loss.
        cutting_fraction: the share of the particles that cut as the model says, in (0, 1]:
            volumes are multiplied by it. The first guess where it is free.
        loss: "linear" for least squares; "soft_l1", "huber", "cauchy" or "arctan" where some
            rows may be far off (`scipy.optimize.least_squares`).
        starts: number of points to begin from. V(α) of a turning body jumps, so the misfit
            has several valleys. The best fits with one parameter at its least value are further starts.

    Returns:
        Estimates, their errors, and sentences on parameters that the data does not determine.

    Raises:
        ValueError: for arguments or data that cannot be used (data: `MeasurementError`).
        CalibrationError: where the model's impacts fail.

    References:
        The cutting fraction: I. Finnie, Erosion of surfaces by solid particles, Wear 3 (1960)
        87-103: about half of the particles cut in the idealized manner.
    """
    forward = make_forward(model, p, data, free, density, cutting_fraction)
    if loss not in LOSSES:
        raise ValueError(f"Argument `loss` must be one of {', '.join(LOSSES)}, but is {loss!r}.")
    starts = check_whole("starts", starts, 1)
    _require_enough(forward.data, len(forward.names))
    problem = make_problem(forward, forward.data, bounds or {})
    return Calibration(*fit(problem, loss, starts))


def make_forward(
    model: CuttingModel | str | Path,
    p: Parameters,
    data: Any,
    free: Sequence[str],
    density: float | str | None,
    cutting_fraction: float,
) -> Forward:
    """The model's prediction of what was measured; arguments and errors as of `calibrate`."""
    model = load_model(model)
    validate(p)
    require_one_impact(model, p)
    measured = read_measurements(data, p.units)
    if not isinstance(cutting_fraction, (int, float, np.number)) or not 0 < cutting_fraction <= 1:
        raise ValueError(f"Argument `cutting_fraction` must be above 0 and at most 1, but is {cutting_fraction!r}.")
    names = check_free(free, measured, model)
    return Forward(model, p, names, measured, _density(density, measured, p), float(cutting_fraction))


def _require_enough(measured: Measurements, free: int) -> None:
    """Refuse data from which nothing can be fitted."""
    if len(measured) <= free:
        parameters = f"{free} free parameter" + ("s" if free > 1 else "")
        raise ValueError(
            f"Argument `data` must have at least {free + 1} rows for {parameters}, as no degree of freedom "
            f"is left otherwise, but has {len(measured)}."
        )
    if not np.any(measured.erosion):
        raise ValueError("Argument `data` must have erosion other than zero.")
    greatest = float(np.max(np.abs(measured.erosion)))
    if not 1 / _GREATEST <= greatest <= _GREATEST:  # squares are summed
        raise ValueError(f"Argument `data` must have erosion that a metal can have, but has {greatest:g} (SI) at most.")


def _density(density: float | str | None, data: Measurements, p: Parameters) -> float | None:
    if density is None:
        if data.needs_density:
            raise ValueError(
                "Argument `density` of the target must be given, as the data has mass losses: a model removes volume."
            )
        return None
    if isinstance(density, str):
        if not has_unit(density):
            such_as = example("density", p.units)
            raise ValueError(f"Argument `density` must carry its unit, such as {such_as}, but is {shown(density)}.")
        with about("Argument `density`"):
            density = read_quantity(density, "density", p.units)
    if not isinstance(density, (int, float, np.number)) or not (np.isfinite(density) and density > 0):
        raise ValueError(f"Argument `density` must be positive and finite, but is {density!r}.")
    return float(density)
