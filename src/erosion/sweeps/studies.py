"""Ready-made sweeps: several models over the angle, and how cuts end over angle and spin."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from erosion.parameters.parameters import Parameters, require_scalars
from erosion.parameters.ranges import QUARTER_DEGREES
from erosion.sweeps.grid import Model
from erosion.sweeps.sweep import sweep

_SPINS = 91  # s from -0.9 to 0.9


def compare(models: Sequence[Model], p: Parameters, *, alpha: Any = None) -> xr.Dataset:
    """Several models over the same angles, each with its angle of greatest removal.

    Args:
        models: models, their names or paths.
        p: one case; its `alpha` is not used.
        alpha: angles, shape (n,) [rad]; every quarter of a degree without it.

    Returns:
        Over (model, alpha): volume, dvolume, d2volume, t_c and ended_by (codes, see their attributes), and
        volume_at_contact, if a model removes something beside the cut; over model: alpha_max, volume_max,
        alpha_max_kind, alpha_max_ended_by.

    Raises:
        ValueError, TypeError: as `sweep`.
    """
    if isinstance(models, str) or not isinstance(models, Sequence):
        raise TypeError(f"Argument `models` must be a list of models, but is {models!r}.")
    return sweep(models, p, alpha=QUARTER_DEGREES if alpha is None else alpha, derivatives=2, optimum=True)


def regimes(model: Model, p: Parameters, *, alpha: Any = None, phidot0: Any = None) -> xr.Dataset:
    """How cuts end and what they remove over angle and spin, with the best angle of each spin.

    Args:
        model: a model, its name or path.
        p: one case; its `alpha` and `phidot0` are not used.
        alpha: angles, shape (n,) [rad]; every half degree without it.
        phidot0: spins, shape (k,) [rad/s]; without it s = r φ̇0/v0 from -0.9 to 0.9.

    Returns:
        Over (phidot0, alpha): volume, dvolume, d2volume, t_c and ended_by; over phidot0:
        alpha_max, volume_max, alpha_max_kind, alpha_max_ended_by.

    Raises:
        ValueError, TypeError: as `sweep`.
    """
    if phidot0 is None:
        require_scalars(p)
        phidot0 = np.linspace(-0.9, 0.9, _SPINS) * float(p.v0 / p.r)
    angles = QUARTER_DEGREES[1::2] if alpha is None else alpha
    return sweep(model, p, phidot0=phidot0, alpha=angles, derivatives=2, optimum=True)
