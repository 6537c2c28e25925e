"""Switches: the places where rates, integrals or event functions break are located as events are.

An operation whose result breaks as time or the state moves is replaced by the same operation in a fixed *mode*. The
mode is one more number of the state. Its rate is zero, so between two events all functions are smooth. A *bound* is a
function that is positive within the mode and falls to zero where the mode ends; it is an event of the lane whose reset
sets the next mode. So no step crosses a break unseen, the error control sees fast bounds, and derivatives by the time
of a break follow from the rules for events.

A user's problem, its state and its events know nothing of this: modes and bounds are parts of the `Motion` alone.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import ClosedJaxpr

from erosion.arguments import Flag, Number, Scalar
from erosion.ode.modes import LOOPS, Rewriting, is_always_zero
from erosion.ode.motion import Augmented, Motion
from erosion.ode.reduction import WholeMotion, evaluate, reduced_motion_of
from erosion.ode.signature import Signature

_MOST = 32  # modes: a problem with more of them is integrated across its breaks


class Switches:
    """The modes of a signature's motion, and its functions in given modes.

    Args:
        signature: of problem and arguments.
        by_hand: whether only the problem's `breaks` are.
        of_time: whether what depends on time alone may have modes; else nothing but `count` and `others` is known.
    """

    def __init__(self, signature: Signature, *, by_hand: bool, of_time: bool = True) -> None:
        start = jax.eval_shape(lambda parameters: WholeMotion(signature, parameters).start(), signature.structs())
        rows, integrals = len(start), len(signature.problem.integrals)

        def look(parameters: list[Number], elements: list[Scalar]) -> tuple[list[Scalar], list[Scalar], list[Scalar]]:
            motion = WholeMotion(signature, parameters)
            at = Augmented(tuple(elements[:rows]), tuple(elements[rows:]))
            rate = motion.rate(at)
            return list(rate.state), list(rate.integrals), motion.events(at)

        structs = signature.structs(), [jax.ShapeDtypeStruct((), np.float64)] * (rows + integrals)
        closed, shapes = jax.make_jaxpr(look, return_shape=True)(*structs)
        structure = jax.tree.structure(shapes)
        made_by = {made: equation for equation in closed.jaxpr.eqns for made in equation.outvars}
        self.moves = [not is_always_zero(atom, made_by) for atom in closed.jaxpr.outvars[:rows]]
        of_lane = len(closed.jaxpr.invars) - rows - integrals
        varies = [False] * of_lane + self.moves + [True] * integrals
        if signature.equations.timed and not of_time:
            varies[of_lane] = False

        def rewritten(parameters: list[Number], elements: list[Scalar], modes: list[Scalar] | None) -> dict[str, Any]:
            rewriting = Rewriting(modes, by_hand=by_hand)
            found = rewriting.results(closed, [*parameters, *elements], varies)
            rates, rates_of_integrals, events = jax.tree.unflatten(structure, found)
            self._switch_of_bound = [bound.switch for bound in rewriting.bounds]
            self.others, self.has_replaced = sorted(rewriting.others), rewriting.has_replaced
            return {
                "rates": [rate if moves else np.zeros(()) for rate, moves in zip(rates, self.moves, strict=True)],
                "integrals": rates_of_integrals, "events": events, "values": rewriting.values,
                "bounds": [bound.distance for bound in rewriting.bounds],
                "following": [bound.following for bound in rewriting.bounds],
                "sizes": [bound.size for bound in rewriting.bounds],
            }  # fmt: skip

        self._switch_of_bound: list[int] = []
        self.others: list[str] = []
        self.has_replaced = False
        first, shapes = jax.make_jaxpr(functools.partial(rewritten, modes=None), return_shape=True)(*structs)
        self.count = len(shapes["values"])
        self.bounds = len(shapes["bounds"])
        self.initial = self._part(first, shapes, "values")
        if not (of_time and self.changes_motion and self.count <= _MOST):
            return
        modes = [jax.ShapeDtypeStruct((), np.float64)] * self.count
        closed_modes, shapes = jax.make_jaxpr(rewritten, return_shape=True)(*structs, modes)
        part = functools.partial(self._part, closed_modes, shapes)
        self.rates, self.events, self.values = part("rates", "integrals"), part("events", "bounds"), part("values")
        self.following, self.sizes = part("following"), part("sizes")
        self.switch_of_bound = list(self._switch_of_bound)
        self.two_sided = [self.switch_of_bound.count(switch) == 1 for switch in self.switch_of_bound]

    @property
    def changes_motion(self) -> bool:
        """Whether the motion's functions differ from those of the problem."""
        return self.count > 0 or self.has_replaced

    @staticmethod
    def _part(closed: ClosedJaxpr, shapes: dict[str, Any], *names: str) -> Callable[..., list[Scalar]]:
        """A function of parameters, elements with integrals, and modes that gives some parts of what is rewritten."""
        places = jax.tree.unflatten(jax.tree.structure(shapes), range(len(closed.jaxpr.outvars)))
        wanted = [closed.jaxpr.outvars[i] for name in names for i in places[name]]
        function = evaluate(closed, wanted)
        return jax.jit(lambda *parts: function(*(number for part in parts for number in part)))


class SwitchedMotion(WholeMotion):
    """A motion in modes, which are its last numbers; the last events are the bounds.

    Args:
        switches: of the signature.
        signature, parameters: see `WholeMotion`.
    """

    def __init__(self, switches: Switches, signature: Signature, parameters: Sequence[Number]) -> None:
        super().__init__(signature, parameters)
        self.switches, self.known = switches, list(parameters)
        self._own = len(self.problem.resets())

    def start(self) -> list[Scalar]:
        """See `WholeMotion`."""
        elements = super().start()
        return [*elements, *map(lax.stop_gradient, self.switches.initial(self.known, [*elements, *self.integrals0()]))]

    def whole(self, state: Sequence[Scalar]) -> tuple[Scalar, Any]:
        """See `WholeMotion`."""
        return super().whole(state[: len(state) - self.switches.count])

    def rate(self, at: Augmented) -> Augmented:
        """See `Motion`."""
        elements, modes = self._parted(at)
        rates = self.switches.rates(self.known, elements, modes)
        moves, rows = self.switches.moves, len(self.switches.moves)
        own = [rate if moves else np.zeros(()) for rate, moves in zip(rates[:rows], moves, strict=True)]
        return Augmented((*own, *(np.zeros(()) for _ in modes)), tuple(rates[rows:]))

    def events(self, at: Augmented) -> list[Scalar]:
        """See `Motion`."""
        return self.switches.events(self.known, *self._parted(at))

    def after(self, event: int, at: Augmented) -> Augmented:
        """See `Motion`; modes are those before the event."""
        if event >= self._own:
            return self.switched(event - self._own, False, at)
        _, modes = self._parted(at)
        return self._with(super().after(event, at), modes)

    def switched(self, bound: Scalar, jumps: Flag, at: Augmented) -> Augmented:
        """State beyond a bound: in the mode that follows there, or if the function `jumps`, in that of the state."""
        elements, modes = self._parted(at)
        following = self.switches.following(self.known, elements, modes)
        values = self.switches.values(self.known, elements, modes)
        after = list(modes)
        for i, (switch, mode) in enumerate(zip(self.switches.switch_of_bound, following, strict=True)):
            new = lax.stop_gradient(jnp.where(jumps, values[switch], mode))
            after[switch] = jnp.where(bound == i, new, after[switch])
        return self._with(at._replace(state=at.state[: len(self.switches.moves)]), after)

    def sizes_of_bounds(self, at: Augmented) -> list[Scalar]:
        """The sizes of the numbers whose differences the bounds are."""
        return self.switches.sizes(self.known, *self._parted(at))

    def _parted(self, at: Augmented) -> tuple[list[Scalar], list[Scalar]]:
        """Elements of the state with the integrals, and modes."""
        rows = len(self.switches.moves)
        return [*at.state[:rows], *at.integrals], list(at.state[rows:])

    def _with(self, at: Augmented, modes: Sequence[Scalar]) -> Augmented:
        return at._replace(state=(*at.state, *modes))


def switches_of(signature: Signature) -> Switches | None:
    """The switches of a signature; None where it has none, or more than are located."""
    switches = _all_switches(signature)
    if switches is not None and switches.count <= _MOST:
        return switches if switches.changes_motion else None
    if signature.problem.breaks is None or not signature.options.arm_on_return:
        return None
    by_hand = _traced(_plain(signature), by_hand=True)
    return by_hand if 0 < by_hand.count <= _MOST else None


def unlocated(signature: Signature) -> str:
    """What breaks in a signature's functions and is not located, as a subject; "" where nothing is."""
    switches = _all_switches(signature)
    if switches is None:
        return ""
    if signature.problem.breaks is not None and (switches.count > _MOST or switches.others):
        # The problem's own times tell where what depends on time alone breaks.
        too_many, switches = switches.count > _MOST, _traced(_plain(signature), by_hand=False, of_time=False)
        if too_many and 0 < switches.count <= _MOST:
            return f"more than {_MOST} switches, of which {switches.count} are of the state,"
    if switches.count > _MOST:
        return f"{switches.count} switches (`where`, `abs`, `max` …), more than {_MOST},"
    loops = "switches within a loop (`while_loop`, `scan`, `fori_loop`)"
    others = [f"`{name}`" for name in switches.others if name not in LOOPS]
    return " and ".join([loops] * (len(others) < len(switches.others)) + others)


def require_derivatives(signature: Signature) -> None:
    """Refuse derivatives where something breaks that is not located: they jump there.

    Raises:
        ValueError: with what to write.
    """
    what = unlocated(signature)
    if what:
        raise ValueError(
            f"Derivatives need breaks that are located, but the rates have {what} that are not: name the times of "
            "breaks of time alone by `Problem.breaks`, give a loop its derivative by `jax.custom_jvp`, or say "
            "`smooth=True` where the motion has no breaks."
        )


def _all_switches(signature: Signature) -> Switches | None:
    if not signature.options.switches:
        return None
    return _traced(_plain(signature), by_hand=False)


def _plain(signature: Signature) -> Signature:
    return signature.wanting(method="explicit", records=False, saves=False, logs=False)


@functools.lru_cache(maxsize=256)
def _traced(signature: Signature, *, by_hand: bool, of_time: bool = True) -> Switches:
    return Switches(signature, by_hand=by_hand, of_time=of_time)


def motion_of(signature: Signature) -> Callable[[Sequence[Number]], Motion]:
    """The motion of one lane's numbers."""
    switches = switches_of(signature)
    return reduced_motion_of(signature) if switches is None else functools.partial(SwitchedMotion, switches, signature)
