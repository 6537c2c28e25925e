"""One impact by the engine of the batches, in a millisecond once it is compiled."""

import numpy as np

from erosion.impacts.outcomes import OTHER_ENDS, end_names
from erosion.impacts.states import states_at
from erosion.models import model_name
from erosion.models.base import NO_CUT, CuttingModel
from erosion.ode.precision import require_float64
from erosion.parameters.parameters import Parameters
from erosion.trajectory.trajectory import SimulationError, Trajectory

_RTOL = 1e-12


def path(model: CuttingModel, p: Parameters, points: int = 201) -> Trajectory:
    """Follow one impact from contact to the end of the cut, with dV/dα.

    `erosion.simulate` gives the same by diffrax; arguments are not checked here.

    Raises:
        SimulationError: where the impact fails or does not end.
    """
    require_float64()
    end = states_at(model, p, np.array([np.inf]), _RTOL)
    name = end_names(model)[int(end.outcome[0])]
    if name in OTHER_ENDS and name != NO_CUT:
        raise SimulationError(f"{model_name(model)}: {OTHER_ENDS[name]}.")
    t_c = float(end.time[0])
    t = np.linspace(0.0, t_c, points) if name != NO_CUT else np.zeros(1)
    # The end itself is known better than what is integrated to that time.
    times = np.where(np.arange(t.size) < t.size - 1, t, np.inf) if name != NO_CUT else t
    states = states_at(model, p, times, _RTOL)
    x_tip, depth, vx_tip, vdepth = map(np.asarray, states.tip)
    return Trajectory(
        model=model,
        p=p,
        t=t,
        states=states.state,
        x_tip=x_tip,
        depth=depth,
        vx_tip=vx_tip,
        vdepth=vdepth,
        removed=states.volume,
        removal_rate=states.removal_rate,
        t_c=t_c,
        ended_by=name,
        volume=float(end.volume[0]),
        dvolume=float(end.dvolume[0]),
        _interpolate=lambda t: states_at(model, p, t, _RTOL).state,
    )
