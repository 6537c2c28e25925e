"""One impact from contact to its end: the histories of its motion."""

import dataclasses
import math
from collections.abc import Callable

import jax
import numpy as np
from jax.typing import ArrayLike

from erosion.array_types import ModelState
from erosion.models import model_name
from erosion.models.base import CuttingModel, State
from erosion.models.registry import impact_to_dict
from erosion.ode.solution import path_of
from erosion.parameters.parameters import Parameters
from erosion.parameters.quantities import RESULTS, contact_rows, result_row
from erosion.tables import Record, Result, Row, abbreviate, format_number, to_plain


class SimulationError(RuntimeError):
    """An impact that could not be followed to its end."""


class TurnWarning(UserWarning):
    """The body turned so far that "the tip" is no longer one."""


@dataclasses.dataclass(frozen=True)
class Trajectory(Result):
    """One cut from contact to its end.

    Arrays have shape (points,) and run over times `t` from 0 to `t_c`, in the units of `p`.

    Args:
        model, p: what was simulated.
        t: times [s].
        x, y: displacement of the centre of mass [length]; y is positive into the target.
        phi: orientation [rad]; π/2 is upright.
        vx, vy: velocity of the centre of mass [speed].
        omega: φ̇ [rad/s].
        x_tip, depth: position of the cutting tip [length].
        vx_tip, vdepth: velocity of the tip [speed].
        removed: volume removed so far [volume]; the first is what is removed at contact.
        removal_rate: dV/dt [volume/s].
        t_c: when the cut ends [s]; 0 where nothing is cut.
        ended_by: "rebound", "stop", "no-cut", or the name of a plug-in's event.
        volume: removed volume [volume], b ∫ depth dx_tip and what is removed at contact.
        states: the model's own state over `t`, a pytree of arrays.
        dvolume: dV/dα [volume/rad], where it was computed.
        at: state at any time(s) in [0, t_c].
    """

    model: CuttingModel
    p: Parameters
    t: np.ndarray
    states: ModelState
    x_tip: np.ndarray
    depth: np.ndarray
    vx_tip: np.ndarray
    vdepth: np.ndarray
    removed: np.ndarray
    removal_rate: np.ndarray
    t_c: float
    ended_by: str
    volume: float
    _interpolate: Callable[[np.ndarray], ModelState] = dataclasses.field(repr=False)
    dvolume: float | None = None

    def at(self, t: ArrayLike) -> ModelState:
        """The state at time(s) `t` [s].

        Raises:
            ValueError: for a time outside [0, t_c].
        """
        times = np.asarray(t, dtype=float)
        if not np.all((times >= 0) & (times <= self.t_c)):
            raise ValueError(f"Argument `t` must be in [0, t_c] = [0, {self.t_c:.12g}] s, but is {t}.")
        flat = self._interpolate(times.reshape(-1))
        return jax.tree.map(lambda leaf: np.asarray(leaf).reshape(times.shape)[()], flat)

    @property
    def x(self) -> np.ndarray:
        """Displacement of the centre of mass along the surface [length]."""
        return np.asarray(self._body().x)

    @property
    def y(self) -> np.ndarray:
        """Displacement of the centre of mass into the target [length]."""
        return np.asarray(self._body().y)

    @property
    def phi(self) -> np.ndarray:
        """Orientation [rad]; π/2 is upright."""
        return np.asarray(self._body().phi)

    @property
    def vx(self) -> np.ndarray:
        """Velocity of the centre of mass along the surface [speed]."""
        return np.asarray(self._body().vx)

    @property
    def vy(self) -> np.ndarray:
        """Velocity of the centre of mass into the target [speed]."""
        return np.asarray(self._body().vy)

    @property
    def omega(self) -> np.ndarray:
        """Spin φ̇ [rad/s]."""
        return np.asarray(self._body().omega)

    @property
    def volume_at_contact(self) -> float:
        """The volume removed at contact by deformation, beside the cut [volume]."""
        return float(self.removed[0])

    @property
    def max_depth(self) -> float:
        """The tip's greatest depth on the grid of `t`, refined by a cubic [length]."""
        if len(self.t) < 2:
            return 0.0
        deepest = float(self.depth.max())
        # In shares of t_c and of the depth, whose powers neither overflow nor vanish.
        depth, step = self.depth / deepest, np.diff(self.t / self.t_c)
        from_, to = (step * rate for rate in (self.vdepth[:-1], self.vdepth[1:]))
        from_, to = from_ * (self.t_c / deepest), to * (self.t_c / deepest)
        # The cubic of each step, and where its derivative a θ² + b θ + from vanishes.
        a, b = 3 * (from_ + to - 2 * np.diff(depth)), 2 * (3 * np.diff(depth) - 2 * from_ - to)
        with np.errstate(all="ignore"):
            q = -(b + np.copysign(np.sqrt(b * b - 4 * a * from_), b)) / 2
            theta = np.stack([q / a, from_ / q])
            values = depth[:-1] + theta * (from_ + theta * (b / 2 + theta * (a / 3)))
        turning = values[(theta > 0) & (theta < 1)]
        return deepest * float(np.max(turning, initial=1.0))

    @property
    def turn(self) -> float:
        """How far the body turned, φ(t_c) - φ(0) [rad]."""
        return float(self.phi[-1] - self.phi[0]) if isinstance(self.states, State) else math.nan

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader of these numbers should know, as plain sentences."""
        return tuple(said for said in (self.turn_warning, self.model.outside_of_range(self.p)) if said is not None)

    @property
    def turn_warning(self) -> str | None:
        """The sentence on a body that turned too far, if it did."""
        greatest = np.abs(self.phi - self.phi[0]).max() if isinstance(self.states, State) else 0.0
        if greatest <= np.pi / 2:
            return None
        return (
            f"The body turned by {np.rad2deg(greatest):.1f}° during the cut, more than 90°: the edge that cut "
            "first has left the surface, so the model's single tip no longer describes the contact."
        )

    def rows(self) -> list[Row]:
        """The results as rows of a table."""
        return [
            result_row("t_c", self.t_c, self.p.units),
            Row("ended_by", "", self.ended_by, "", "how the cut ends"),
            result_row("volume", self.volume, self.p.units),
            *contact_rows(self.volume_at_contact, self.p.units),
            *([] if self.dvolume is None else [result_row("dvolume", self.dvolume, self.p.units)]),
            result_row("max_depth", self.max_depth, self.p.units),
            *self._state_rows(),
        ]

    def _state_rows(self) -> list[Row]:
        """How far a rigid body turned; of a state of the model's own, each part at the end."""
        if isinstance(self.states, State):
            return [result_row("turn", self.turn, self.p.units)]
        parts = jax.tree_util.tree_flatten_with_path(self.states)[0]
        return [
            Row(
                ".".join(path_of(keys)) or "state",
                "",
                format_number(values[-1]),
                "",
                "of the model's own state, at the end",
            )
            for keys, values in parts
        ]

    def __repr__(self) -> str:
        return (
            f"Trajectory({model_name(self.model)!r}, {len(self.t)} points, t_c={abbreviate(self.t_c)}, "
            f"ended_by={self.ended_by!r}, volume={abbreviate(self.volume)}, p={self.p!r})"
        )

    @property
    def title(self) -> str:
        """The model and the angle of attack."""
        return f"{model_name(self.model)}: one impact at α = {np.rad2deg(float(self.p.alpha)):.6g}°"

    @property
    def statements(self) -> list[str]:
        """The warnings, as the table shows them."""
        return [f"warning: {line}" for line in self.warnings]

    def to_dict(self) -> Record:
        """Model and case, how the cut ends and what it removes, and the units; without the histories."""
        names = ("t_c", "volume", "volume_at_contact", "dvolume", "max_depth", "turn")
        numbers = {name: getattr(self, name) for name in names}
        units = {name: RESULTS[name].unit(self.p.units) for name in names}
        content = {**numbers, "ended_by": self.ended_by, "units": units, "warnings": self.warnings}
        return impact_to_dict(self.model, self.p) | to_plain(content)

    def _body(self) -> State:
        if not isinstance(self.states, State):
            raise AttributeError(f"{type(self.model).__name__} keeps a state of its own: use `.states`.")
        return self.states
