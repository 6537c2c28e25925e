"""How a particle leaves the surface: its velocity and spin after an impact, from the model's state at the cut's end."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from erosion.exports.particle import ExportError, angles, in_si, particle_of
from erosion.exports.tables import SHARES, labelled, require_rows
from erosion.impacts.outcomes import OTHER_ENDS, end_names
from erosion.impacts.states import states_at
from erosion.models import model_name
from erosion.models.base import ZERO, CuttingModel, State
from erosion.models.correlated import Correlated
from erosion.ode.precision import require_float64
from erosion.parameters.parameters import Parameters

_ANGLES = np.deg2rad(np.arange(2.5, 89, 2.5))  # at 90° nothing is cut, and there is no rebound to follow
_RTOL = 1e-12


def restitution(model: CuttingModel | str | Path, p: Parameters, *, alpha: Any = None, v0: Any = None) -> xr.Dataset:
    """Coefficients of restitution and the spin after the impact, over speed and angle.

        table = erosion.restitution("rotating", p)
        table.e_n.sel(v0=p.v0, method="nearest").plot()

    All velocities are those of the centre of mass, which is what a CFD code moves; the tip moves otherwise where the
    body turns. They are taken when the cut ends:

    - **rebound**: the tip has left the target. e_n = -ẏ/(v₀ sin α), e_t = ẋ/(v₀ cos α).
    - **stop** (and an event of a plug-in): the tip no longer moves along the surface, but is still within the target,
      and the model follows it no further. e_t is that of this moment.

    Where the centre of mass still moves into the target when the cut ends, the target takes what is left of the
    normal motion, as it is plastic: e_n = 0. `vx` and `vy` hold the velocities of the end itself.

    - **no-cut**: the model has no rebound without a cut: all are NaN. So are they where an impact fails.

    The losses of the normal motion are the model's: a force that follows the depth, as all built-in ones do, gives
    back what it took, so that a body that does not turn rebounds with e_n = 1.

    Args:
        model: a model of a rigid body, its name, or the path of its file.
        p: the case, all scalars; its `alpha` is not used.
        alpha: angles, shape (n,) [rad]; every 2.5° below 90° without it.
        v0: speeds, shape (n,) [speed]; seven from half to twice the case's without it.

    Returns:
        Over (v0, alpha), in the units of the case: `e_n`, `e_t` [-], `spin` φ̇ after the impact [rad/s] (positive
        moves the tip forward), `vx`, `vy` [speed], and `ended_by` (codes, see its attributes). e_t is NaN at 90°,
        where there is no tangential velocity before the impact.

    Raises:
        ExportError: for a model without the motion of a rigid body, as correlations are.
        ValueError: for parameters that are arrays or out of range.
    """
    require_float64()
    particle = particle_of(model, p)
    alpha = _ANGLES if alpha is None else angles(alpha)
    speeds = in_si("v0", v0, p, SHARES * particle.speed)
    shape = (speeds.size, alpha.size)
    require_rows(speeds.size * alpha.size)
    each_alpha, each_speed = (np.broadcast_to(axis, shape).ravel() for axis in (alpha, speeds[:, None]))
    impacts = particle.p.replace(alpha=each_alpha, v0=each_speed)
    end = states_at(particle.model, impacts, np.full(each_alpha.size, np.inf), _RTOL)
    if isinstance(particle.model, Correlated) or not isinstance(end.state, State):
        raise ExportError(f"{model_name(particle.model)} has no motion of a rigid body: it says nothing of rebounds.")
    names = end_names(particle.model)
    has_motion = ~np.isin(end.outcome, [names.index(name) for name in OTHER_ENDS])
    vx, vy, spin = (np.where(has_motion, rate, np.nan) for rate in (end.state.vx, end.state.vy, end.state.omega))
    normal, tangential = each_speed * np.sin(each_alpha), each_speed * np.cos(each_alpha)
    tangential[np.cos(each_alpha) <= ZERO] = np.nan
    arrays = {"e_n": np.maximum(-vy / normal, 0.0), "e_t": vx / tangential, "spin": spin, "vx": vx, "vy": vy}
    dataset = labelled(
        particle, p, "rebounds", {"v0": speeds, "alpha": alpha}, {name: v.reshape(shape) for name, v in arrays.items()}
    )
    codes = {"long_name": "how the cut ended", "flag_values": np.arange(len(names), dtype=np.int8)}
    meanings = {"flag_meanings": " ".join(names)}
    dataset["ended_by"] = (("v0", "alpha"), end.outcome.astype(np.int8).reshape(shape), codes | meanings)
    return dataset
