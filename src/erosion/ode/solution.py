"""The result of lanes: `erosion.ode.Solution`."""

import abc
import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import PyTree

from erosion.arguments import PerImpact
from erosion.ode.back_in_time import chosen
from erosion.ode.ensemble import Lanes, Part, among, path_of
from erosion.ode.event_log import Passed
from erosion.ode.gradient import Ended, going_forwards, gradient_of
from erosion.ode.kinks import may_have_kinks
from erosion.ode.problem import Problem, Words
from erosion.ode.switches import switches_of, unlocated
from erosion.ode.tape import Recorded
from erosion.output.tables import format_number
from erosion.results import Declared, Finding, Result, Value, render, stated

if TYPE_CHECKING:
    import xarray as xr

INEXACT = 100.0  # tolerances: results that err by more are told


class Integration(abc.ABC):
    """A second integration of a solution's lanes, with the same derivatives, on demand."""

    @abc.abstractmethod
    def at(self, times: Any) -> "Solution":
        """The solution with states at times."""

    @abc.abstractmethod
    def events(self, count: PerImpact) -> Passed:
        """The events on the way of lanes with resets, of which each has so many."""


class Times(NamedTuple):
    """States of lanes at times.

    Args:
        ts: shape (n,).
        ys: a pytree like the state, of arrays (…, n); NaN after a lane's end.
        integrals: by name, of that shape.
        derivatives: at fixed times, by names of one or two numbers; see `along`.
    """

    ts: PerImpact
    ys: PyTree
    integrals: Mapping[str, np.ndarray]
    derivatives: "Mapping[tuple[str, ...], Times]" = {}

    def along(self, *names: str) -> "Times":
        """Derivatives of states and integrals, as `Solution.along`."""
        return among(self.derivatives, names)

    def __repr__(self) -> str:
        ys, integrals = jax.tree.map(lambda part: Words(format_number(part, 6)), (self.ys, dict(self.integrals)))
        return f"Times(ts={format_number(self.ts, 6)}, ys={ys}{f', integrals={integrals}' if integrals else ''})"


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class Solution(Result):
    """The ends of lanes; every array has the shape to which the arguments broadcast.

    Args:
        problem: what was integrated.
        names: what `outcome` is an index of: the events, then "start", "failed", "unfinished", "t1".
        wrt: the numbers of the derivatives.
        outcome: how each lane ended, see `ended_by`.
        t: when; NaN where it failed.
        y: the state there, a pytree like y0; for "unfinished" what was reached.
        integrals: by name, from t0 to there.
        count: the number of events, that at the end included.
        trials: the number of steps tried.
        at_once: by name whether an event happens at the end, as others may at the same time.
        stiff: whether the method for stiff motions integrated the lane; None where JAX traces.
        slides: whether the lane is unfinished as its rates point to a switch from both sides; None without switches.
        derivatives: by names of one or two numbers; see `along`.
        digest: of what the problem computed.
        times: the states at `ts`, or None.
        tolerance: of each lane's results, which may be less than `rtol`; None where there are derivatives.
        inexact: whether a lane's results err by a hundred times `rtol` or more, by an estimate, as those of a chaotic
            motion do in the end.
        recorded: the steps of lanes, for `gradient`; None where they were not recorded.
        has_gradient: whether a gradient follows, as `ode.solve` was told.
        integration: for states at other times, and for events.
    """

    problem: Problem
    names: tuple[str, ...]
    wrt: tuple[str, ...]
    outcome: PerImpact
    t: PerImpact
    y: PyTree
    integrals: Mapping[str, PerImpact]
    count: PerImpact
    trials: PerImpact
    at_once: Mapping[str, PerImpact]
    derivatives: Mapping[tuple[str, ...], Part] = dataclasses.field(repr=False)
    lanes: Lanes = dataclasses.field(repr=False)
    rtol: float
    digest: str = dataclasses.field(repr=False)
    stiff: PerImpact | None = None
    slides: PerImpact | None = dataclasses.field(default=None, repr=False)
    times: Times | None = None
    tolerance: np.ndarray | None = dataclasses.field(default=None, repr=False)
    inexact: PerImpact = False
    recorded: Recorded | None = dataclasses.field(default=None, repr=False)
    has_gradient: bool = dataclasses.field(default=False, repr=False)
    integration: Integration | None = dataclasses.field(default=None, repr=False)
    _reached: PerImpact | None = dataclasses.field(default=None, repr=False)
    """How far the integration came; None where JAX traces."""
    forwards: "Solution | None" = dataclasses.field(default=None, repr=False)
    """Of a motion back in time, that of the reflected problem."""
    earlier: "tuple[Solution, np.ndarray] | None" = dataclasses.field(default=None, repr=False)
    """Where times are before the start, the motion back to them, and which they are."""

    @functools.cached_property
    def ended_by(self) -> PerImpact:
        """The end of each lane in words, an event, "start", "t1", "unfinished" or "failed".

        Raises:
            ValueError: where JAX traces the solution.
        """
        self._require_numbers("ended_by")
        return np.array(self.names)[np.asarray(self.outcome)]

    def _require_numbers(self, name: str) -> None:
        if any(isinstance(each, Tracer) for each in (self.outcome, self.t, *self.lanes.parameters)):
            raise ValueError(
                f"`{name}` needs numbers, or holds words, and there are none where JAX traces; `outcome` is the index "
                "in `names` of what ended a lane; for a gradient use `jax.grad`."
            )

    def _require_problem(self, name: str) -> None:
        if self.lanes.signature.renewed().equations.digest != self.digest:
            raise ValueError(
                f"`{name}` needs the problem as it was solved, but its functions compute something else since; "
                "solve it again."
            )

    def along(self, *names: str) -> Part:
        """Derivatives of t, y and integrals: by one number the first, by two the second.

        Raises:
            ValueError: where they were not asked for by `wrt` and `derivatives`.
        """
        return among(self.derivatives, names)

    def gradient(
        self, *, t: Any = 0.0, y: PyTree = None, integrals: Mapping[str, Any] | None = None, ys: PyTree = None
    ) -> PyTree:
        """The derivatives of a number by all arguments at once, such as those of a loss by the weights of a network.

        The number depends on times, states and integrals of all lanes. Its cost does not grow with the number of
        arguments: each lane is gone back through (the discrete adjoint), after it was integrated once more where
        `ode.solve` was not told by `gradient=True`. Lanes of motions that may have kinks, and those that rest, go
        forwards instead, once for each argument.

        Args:
            t: by what the number changes with each lane's time; an array of the lanes' shape, or one number.
            y: the same by the state, a pytree like it; None for zero.
            integrals: the same by integrals, by name; what is left out is zero.
            ys: the same by the states at `ts`, a pytree like `ys`; after a lane's end it does not count.

        Returns:
            A pytree like the arguments, of arrays of their shapes: an argument that lanes share has the sum over these.
            Lanes without a result are NaN, and are left out of sums. A shared array of whole numbers has no
            derivatives: its part has JAX's type for that, `float0`, with which nothing can be computed. Give weights
            as floats.

        Raises:
            ValueError: for what does not fit, where the problem computes something else since, and where JAX traces
                the solution (`jax.grad` does this there).

        Example:
            >>> import numpy as np
            >>> from erosion import ode
            >>> fall = ode.Problem(
            ...     y0=lambda args: {"y": args["height"], "v": 0.0},
            ...     vector_field=lambda t, y, args: {"y": y["v"], "v": -args["g"]},
            ...     events={"ground": ode.Event(lambda t, y, args: y["y"], direction=-1)},
            ... )
            >>> end = ode.solve(fall, {"height": np.array([5.0, 20.0]), "g": 9.81}, t1=100.0)
            >>> found = end.gradient(t=2 * end.t)  # of Σ t², which is Σ 2 height/g
            >>> found["height"], float(found["g"])
            (array([0.2038..., 0.2038...]), -0.5195...)
        """
        self._require_numbers("gradient")
        self._require_problem("gradient")
        if self.forwards is not None:
            return self.forwards.gradient(t=-1.0 * np.asarray(t), y=y, integrals=integrals, ys=ys)
        if self.earlier is not None and ys is not None:
            back, flags = self.earlier
            full = jax.tree.map(lambda bar, part: np.broadcast_to(bar, np.shape(part)), ys, self.ys)
            none = jax.tree.map(np.zeros_like, full)
            parts = [
                back.gradient(ys=chosen(flags, full, none)),
                dataclasses.replace(self, earlier=None).gradient(
                    t=t, y=y, integrals=integrals, ys=chosen(flags, none, full)
                ),
            ]
            return jax.tree.map(lambda one, other: one if one.dtype == jax.dtypes.float0 else one + other, *parts)
        ended = None
        if self.tolerance is not None:
            of_lanes = (self.outcome, self.t, self.trials, self.tolerance, self.stiff)
            outcome, end, trials, tolerance, stiff = (np.reshape(np.asarray(each), -1) for each in of_lanes)
            ended = Ended(outcome, end, trials, tolerance, stiff, self.rtol, self.recorded)
        return gradient_of(self.lanes, self.rtol, ended, self.ts, t, y, integrals or {}, ys)

    def __call__(self, t: Any) -> Times:
        """The states at times, as exact as those at `ts`, and their derivatives by the numbers in `wrt`.

        The lanes are integrated once more, so a few calls with many times cost least.

        Args:
            t: shape (n,).

        Returns:
            What `times` would be, had `ode.solve` had these `ts`, to the bit.

        Raises:
            ValueError: where the problem computes something else since.

        Example:
            >>> import numpy as np
            >>> from erosion import ode
            >>> decay = ode.Problem({"x": 1.0}, lambda t, y, args: {"x": -args["k"] * y["x"]})
            >>> end = ode.solve(decay, {"k": 2.0}, t1=9.0, wrt="k")
            >>> at = end([0.5, 1.0])
            >>> at.ys["x"], at.along("k").ys["x"]  # exp(-2 t), -t exp(-2 t)
            (array([0.3678..., 0.1353...]), array([-0.1839..., -0.1353...]))
        """
        self._require_problem("solution(t)")
        assert self.integration is not None
        times = self.integration.at(t).times
        assert times is not None
        return times

    @property
    def ts(self) -> PerImpact:
        """The times of `ys`."""
        return None if self.times is None else self.times.ts

    @property
    def ys(self) -> PyTree:
        """The states at `ts`, arrays (…, n); NaN after a lane's end."""
        return None if self.times is None else self.times.ys

    def with_times(self, times: Times) -> "Solution":
        """The solution with states at times."""
        return dataclasses.replace(self, times=times)

    def mirrored(self) -> "Solution":
        """The solution of the problem in -t."""

        def of_times(times: Times, names: tuple[str, ...] = ()) -> Times:
            y, integrals = self._mirrored(Part(0.0, times.ys, times.integrals), names)[1:]
            derivatives = {path: of_times(each, path) for path, each in times.derivatives.items()}
            return Times(-1.0 * times.ts, y, integrals, derivatives)

        original = self.lanes.original
        assert original is not None
        return dataclasses.replace(
            self,
            problem=original,
            t=-1.0 * self.t,
            _reached=None if self._reached is None else -1.0 * self._reached,
            derivatives={path: self._mirrored(part, path) for path, part in self.derivatives.items()},
            times=self.times and of_times(self.times),
            forwards=self,
        )

    def _mirrored(self, part: Part, names: tuple[str, ...] = ()) -> Part:
        """A part of the problem of -t, where numbers of the clock have the other sign."""
        sign = (-1.0) ** sum(self.lanes.is_of_clock(name) for name in names)
        y, integrals = jax.tree.map(lambda number: sign * number, (part.y, part.integrals))
        return Part(-sign * part.t, y, integrals)

    def with_earlier(self, before: "Solution", flags: np.ndarray) -> "Solution":
        """With states at times before the start, which the flags, shape (…, times), are, from a motion back."""

        def of(times: Times, others: Times) -> Times:
            y, integrals = chosen(flags, tuple(others[1:3]), tuple(times[1:3]))
            derivatives = {path: of(part, others.derivatives[path]) for path, part in times.derivatives.items()}
            return Times(times.ts, y, integrals, derivatives)

        assert self.times is not None
        assert before.times is not None
        either = jnp.logical_or if isinstance(self.inexact, jax.Array) else np.logical_or
        inexact = either(self.inexact, before.inexact)
        times = of(self.times, before.times)
        return dataclasses.replace(self, times=times, inexact=inexact, earlier=(before, flags))

    @functools.cached_property
    def events(self) -> Passed:
        """Each event on the way, that at the end included; lanes are integrated once more when it is first read.

        `name`, `t`, `y` (before the event's reset), `integrals` and `at_once` have one axis more, for the events, and
        so have the derivatives by the numbers in `wrt`, `events.along(…)`. Where JAX traces the solution the axis has
        the length `max_events`, or 1 without resets; `event` is the index in `names`, and derivatives go forwards.

        Raises:
            ValueError: where the problem computes something else since, or JAX traces the solution and `max_events` is
                no number.
        """
        self._require_problem("events")
        if self.forwards is not None:
            passed, turned = self.forwards.events, self.forwards._mirrored
            derivatives = {path: turned(part, path) for path, part in passed.derivatives.items()}
            return passed._replace(t=-1.0 * passed.t, derivatives=derivatives)
        if not any(self.problem.resets()):
            return self._end_alone
        assert self.integration is not None
        return self.integration.events(self.count)

    @property
    def _end_alone(self) -> Passed:
        """The events of lanes that end with the first."""
        is_traced, axis = any(isinstance(part, Tracer) for part in (self.t, self.count)), np.ndim(self.t)
        library: Any = jnp if is_traced else np
        there = library.expand_dims(library.asarray(self.count) > 0, -1)
        most = 1 if is_traced else int(np.max(self.count, initial=0))

        def of(found: Any, nothing: Any) -> Any:
            wide = library.expand_dims(found, axis)
            flags = there.reshape(*there.shape, *[1] * (wide.ndim - there.ndim))
            return library.where(flags, wide, nothing).take(np.arange(most), axis)

        def of_part(part: Part) -> Part:
            return jax.tree.map(lambda number: of(number, np.nan), part)

        part = of_part(Part(self.t, self.y, self.integrals))
        at_once = {name: of(flags, False) for name, flags in self.at_once.items()}
        derivatives = {names: of_part(each) for names, each in self.derivatives.items()}
        return Passed(self.lanes.signature.event_names, of(self.outcome, -1), *part, at_once, derivatives)

    @property
    def title(self) -> str:
        """How many lanes."""
        count = np.size(self.t)
        return f"{count:,} lane{'s' * (count != 1)}"

    @property
    def warnings(self) -> Sequence[str]:
        """Why lanes have no result, no derivatives or less exact ones than asked for, and what to do."""
        sentences = [*self._unfinished(), *self._failed, *self._arrays_of_lanes(), *self._unlocated()]
        inexact = np.count_nonzero(self.inexact)
        if inexact:
            sentences.append(
                f"{inexact:,} of {self.title} err by more than {100 * self.rtol:g}, by an estimate: "
                "their errors grow as those of a chaotic motion do."
            )
        has_result = ~self.lanes.signature.has_no_result(np.asarray(self.outcome))
        if self.has_gradient:
            sentences += self._going_forwards(has_result)
        for path, part in self.derivatives.items():
            by = " and ".join(map(_label, dict.fromkeys(path)))
            none = has_result & part.lacks(has_result.shape)
            stiff = np.count_nonzero(none & np.asarray(self.stiff)) if len(path) == 2 else 0
            if stiff:
                sentences.append(
                    f"The second derivatives by {by} are NaN in {stiff:,} of {self.title} that are stiff: the method "
                    "for stiff motions has none; take differences of first ones."
                )
            lost = np.count_nonzero(none) - stiff
            if lost:
                at_once = "events happen at once, or one at `t1`, whose order matters, " if self.problem.events else ""
                signature = self.lanes.signature
                root = "the argument of a root or a power vanishes, " if may_have_kinks(signature) else ""
                at_end = "" if switches_of(signature) is None else "a break is exactly at the start or the end, "
                sentences.append(
                    f"{'Second' if len(path) == 2 else 'First'} derivatives by {by} are NaN in {lost:,} of "
                    f"{self.title}: they do not exist there, {root}{at_end}"
                    f"{at_once}or cancellation leaves too few of their digits."
                )
        if self.earlier is not None:
            sentences += [f"Before t0: {sentence}" for sentence in self.earlier[0].warnings]
        return sentences

    def _going_forwards(self, has_result: np.ndarray) -> Iterator[str]:
        signature, timed = self.lanes.signature, self.times is not None
        what = unlocated(signature)
        if what:
            yield f"There is no gradient, as the rates have {what} that are not located."
            return
        count = np.count_nonzero(going_forwards(signature, np.asarray(self.stiff), timed=timed) & has_result)
        if count:
            elements = signature.offsets[self.lanes.signature.arguments]
            yield (
                f"The gradient of {count:,} of {self.title} takes one integration for each of {elements:,} numbers, "
                "as motions with kinks, stiff ones with `ts`, and those with `start='fire'` or loops in their rates do."
            )

    def _arrays_of_lanes(self) -> Iterator[str]:
        """Arrays of the state's length that made lanes, although each lane could compute with all of them."""
        signature, structs = self.lanes.signature, list(self.lanes.signature.equations.parameters)
        lengths = {leaf.shape[-1] for leaf in jax.tree.leaves(signature.state) if leaf.shape}
        for i, (name, given) in enumerate(zip(self.lanes.names, self.lanes.given[: len(structs)], strict=False)):
            if structs[i].shape or not given or given[-1] not in lengths or given[-1] == 1:
                continue
            shared = [*structs[:i], jax.ShapeDtypeStruct(given[-1:], structs[i].dtype), *structs[i + 1 :]]
            args = signature.args([np.zeros(struct.shape, struct.dtype) for struct in shared])
            if signature.problem.equations(args, shared).error is None:
                yield (
                    f"The array `{_label(name)}` of shape {given} makes lanes, and is as long as an array of the "
                    f"state: where each lane needs all of it, say `shared={name!r}`."
                )

    def _unlocated(self) -> Iterator[str]:
        """Switches that are too many to be located, or within a loop."""
        signature = self.lanes.signature
        what = unlocated(signature)
        if what and not np.all(np.isfinite(signature.clock(self.lanes.parameters).max_step)):
            yield (
                f"The rates have {what} that are not located: what is shorter than a step may be missed. Name the "
                "times of breaks of time alone by `Problem.breaks`, give `max_step`, or say `smooth=True` where they "
                "do not matter."
            )

    def _in_lanes(self, flags: np.ndarray, said: str) -> str:
        """In how many lanes something is so: "2 of 5 lanes are unfinished"."""
        count = np.count_nonzero(flags)
        return f"{count:,} of {self.title} {'is' if count == 1 else 'are'} {said}"

    def _unfinished(self) -> Iterator[str]:
        """Why lanes are unfinished, a sentence for each reason."""
        signature, clock = self.lanes.signature, self.lanes.signature.clock(self.lanes.parameters)
        unfinished = np.asarray(self.ended_by) == "unfinished"
        if not np.any(unfinished):
            return
        # Along several directions the trials of all are counted.
        if self.slides is not None and np.any(slides := unfinished & np.asarray(self.slides)):
            yield (
                f"{self._in_lanes(slides, 'unfinished')}: the rates point to the switch from both sides, or vanish on "
                f"it, {_times(self.t, slides)}. Let them change smoothly, as by `jnp.tanh(x / width)` for the sign of "
                "x, or let an `ode.Event` with a `reset` begin a rest there."
            )
            unfinished = unfinished & ~slides
        passes = sum(len(path) == max(map(len, self.derivatives)) for path in self.derivatives) or 1
        many = unfinished & (np.asarray(self.trials) > signature.options.max_steps * passes)
        endless = np.isinf(np.broadcast_to(clock.t1, self.lanes.size)).reshape(self.lanes.shape)
        late = unfinished & ~many & endless & (np.asarray(self.count) == 0)
        gathered = unfinished & ~many & ~late
        if np.any(many):
            said = f"unfinished after {signature.options.max_steps:,} trials of steps {_times(self.t, many)}"
            hint = ""
            if signature.options.method == "explicit":
                hint = ' If the motion is stiff, leave `method` at "auto".'
            elif signature.options.method == "auto" and may_have_kinks(signature):
                hint = (
                    " If the motion is stiff, say `smooth=True`: the rates may have kinks (`sqrt`, `abs`, `where` …), "
                    "and the method for stiff motions takes none. If it comes to rest at its event, as h' = -√h does, "
                    "let the event be a little before: `h - 1e-12`."
                )
            yield (
                f"{self._in_lanes(many, said)}: raise `max_steps`, or `rtol`; where a state is almost zero for "
                f"long, give `state_scale`.{hint}"
            )
        if np.any(late):
            yield f"{self._in_lanes(late, 'unfinished')}: no event came within 10⁴ time scales; give `t1`."
        for those, why, or_else in (
            (
                gathered & ~endless,
                "where events accumulate, cause each other without end, or leave a body at rest on its event",
                "",
            ),
            (
                gathered & endless,
                "where events accumulate, cause each other without end, leave a body at rest on its event, or within "
                "10⁴ time scales none follows",
                ", or `t1`",
            ),
        ):
            if np.any(those):
                said = self._in_lanes(those, f"unfinished {_times(self.t, those)}")
                most = np.min(np.asarray(self.count)[those])
                yield f"{said}, {why}: give `max_events`, at most {most:,}{or_else}."

    @functools.cached_property
    def _failed(self) -> Sequence[str]:
        """Why lanes failed, a sentence for each reason."""
        lanes, sentences = self.lanes, []
        left = np.ravel(np.asarray(self.ended_by) == "failed")
        if not np.any(left):
            return ()
        columns = zip(lanes.names, lanes.parameters, lanes.signature.shapes, strict=True)
        for place, (name, number, shape) in enumerate(columns):
            number = np.asarray(number, float)
            bad = np.isnan(number) if place >= lanes.signature.arguments else ~np.isfinite(number)
            own = left & np.broadcast_to(np.any(bad) if shape else bad, lanes.size)
            if np.any(own):
                what = "NaN" if np.all(np.isnan(number[bad])) else "NaN or infinite"
                sentences.append(
                    f"{_failing(own, self.title)}: `{_label(name)}` is {what} there; give finite numbers, such as 1e9 "
                    "for a bound that is never met."
                )
                left &= ~own
        if not np.any(left) or lanes.signature.renewed().equations.digest != self.digest:
            return sentences
        for name, own in _undefined_at_start(lanes, np.flatnonzero(left)).items():
            own = left & own
            if np.any(own):
                sentences.append(
                    f"{_failing(own, self.title)} at the start: `{name}` is NaN or infinite there; guard roots, "
                    "powers, logarithms and divisors."
                )
                left &= ~own
        if np.any(left):
            where = "on the way" if self._reached is None else _times(self._reached, left.reshape(np.shape(self.t)), 4)
            sentences.append(
                f"{_failing(left, self.title)} {where}: no step from there succeeds. The motion grows without bound "
                "there, a rate or event function is NaN beyond (guard roots, powers and logarithms by `jnp.maximum`), "
                "a rate jumps back and forth, or rounding hides the event (give `state_scale`)."
            )
        return sentences

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The warnings, which have no codes of their own."""
        return tuple(map(stated, self.warnings))

    @functools.cached_property
    def lines(self) -> Sequence[str]:
        """The axes of lanes."""
        return tuple(f"lane_{i}" for i in range(np.ndim(self.t)))

    def declare(self) -> list[Declared]:
        """How lanes end; times, states and integrals, their derivatives, and the same at `ts`; named "dt_dangle".

        Axes are `lane_0`, `lane_1`, …, and `time`. In CSV and files the numbers of each lane stand beside.
        """
        lanes = self.lines
        made: list[Declared] = [Value("ended_by", self.ended_by, dims=lanes)]
        taken = dict.fromkeys(("ended_by", "count", "inexact", "rtol", "events", "event", "time", *lanes))
        own: dict[str, tuple[str, tuple[str, ...]]] = {}
        for path, values in self._parts(self).items():
            name = _free(path.replace(".", "_"), taken)
            own[path] = name, tuple(f"{name}_{i}" for i in range(np.ndim(values) - len(lanes)))
            taken |= dict.fromkeys((name, *own[path][1]))

        def put(parts: Mapping[str, Any], by: Sequence[str] = (), at: tuple[str, ...] = ()) -> None:
            before = "d2" if len(by) == 2 else "d" * len(by)
            after = "".join(f"_d{each.replace('.', '_')}" for each in by) + "_at" * len(at)
            for path, values in parts.items():
                name, axes = own[path]
                if before or after:
                    name = _free(f"{before}{name}{after}", taken)
                    taken[name] = None
                made.append(Value(name, values, digits=10, dims=(*lanes, *at, *axes), only="data" if at else ""))

        put(self._parts(self))
        for path, part in sorted(self.derivatives.items(), key=lambda item: len(item[0])):
            put(self._parts(part), [*map(_label, path)])
        if self.times is not None:
            made.append(Value("time", self.times.ts, dims=("time",), only="data"))
            for path, part in {(): self.times, **self.times.derivatives}.items():
                put({**self.named(part), **self._named_integrals(part)}, [*map(_label, path)], ("time",))
        made += [Value(name, getattr(self, name), dims=lanes, only="data") for name in ("count", "inexact")]
        made.append(Value("rtol", self.rtol, only="data"))
        made.append(Value("events", [*self.problem.events], dims=("event",), only="data"))
        return [*made, *self._numbers_of_lanes(lanes, taken)]

    def _numbers_of_lanes(self, axes: Sequence[str], taken: dict[str, None]) -> Iterator[Value]:
        """Arguments and times that differ from lane to lane, for CSV and files."""
        columns = zip(self.lanes.names, self.lanes.parameters, self.lanes.signature.shapes, strict=True)
        for place, (name, number, shape) in enumerate(columns):
            if np.ndim(number) > len(shape):
                is_time = place >= self.lanes.signature.arguments and name in ("t0", "t1")
                sign = -1.0 if self.forwards is not None and is_time else 1.0
                name = _free(_label(name).replace(".", "_"), taken)
                taken[name] = None
                yield Value(name, sign * np.reshape(number, self.lanes.shape), dims=axes, only="file")

    def to_csv(self) -> str:
        """A line for each lane, with the arguments and times that are its own."""
        of_lanes = (value for value in self.declare() if isinstance(value, Value))
        declared = [value.but(only="data") if value.only == "file" else value for value in of_lanes]
        return render.csv(declared, self.shown_in, self.lines)

    def to_dataset(self) -> "xr.Dataset":
        """Return an xarray dataset; numbers that differ from lane to lane are coordinates."""
        numbers = (value.name for value in self.declare() if value.only == "file")
        return super().to_dataset().set_coords(numbers)

    def _parts(self, part: "Part | Solution") -> dict[str, Any]:
        """Time, states and integrals by name."""
        return {"t": part.t, **self.named(part), **self._named_integrals(part)}

    def named(self, part: "Part | Solution | Times") -> dict[str, Any]:
        """The parts of a state by their paths: "y.vx"."""
        y = part.ys if isinstance(part, Times) else part.y
        parts: dict[str, Any] = {}
        for keys, leaf in jax.tree_util.tree_flatten_with_path(y)[0]:
            name = ".".join(("y", *path_of(keys)))
            # Names that are joined may be equal, as of {"a.b": …, "a": {"b": …}}.
            parts[name if name not in parts else f"y{jax.tree_util.keystr(keys)}"] = leaf
        return parts

    def _named_integrals(self, part: "Part | Solution | Times") -> dict[str, Any]:
        return {f"integrals.{name}": values for name, values in part.integrals.items()}

    def __repr__(self) -> str:
        return f"Solution({format_number(self.ended_by)}, t={format_number(self.t, 6)}, wrt={self.wrt!r})"


def _times(t: Any, flags: np.ndarray, digits: int = 6) -> str:
    """Where some lanes are: "at t = 1.5", "at t = 1.5 … 3"; of those whose time is a number."""
    of_them = np.asarray(t)[flags]
    of_them = of_them[~np.isnan(of_them)]
    if not of_them.size:
        return "on the way"
    least, greatest = (f"{value:.{digits}g}" for value in (of_them.min(), of_them.max()))
    return f"at t = {least}" + f" … {greatest}" * (least != greatest)


def _failing(flags: np.ndarray, title: str) -> str:
    return f"{np.count_nonzero(flags):,} of {title} failed"


def _undefined_at_start(lanes: Lanes, which: np.ndarray) -> dict[str, np.ndarray]:
    """By the name of each function of the problem in which lanes it is NaN or infinite at the start, shape (lanes,).

    Args:
        lanes: the lanes.
        which: those that are looked at.
    """
    signature, problem = lanes.signature, lanes.signature.problem
    order: dict[str, None] = {}  # JAX sorts the names

    def look(parameters: list[Any]) -> dict[str, Any]:
        args, t = signature.args(parameters), signature.clock(parameters).t0
        y = jax.tree.map(lambda part: jnp.asarray(part, float), problem.start(args))
        parts: dict[str, Any] = {"y0": y}
        integrals = problem.integrals_at_start(args)
        if problem.integrals0 is not None:
            parts["integrals0"] = integrals
        if problem.time_scale is not None:
            parts["time_scale"] = problem.time_scale(args)
        parts["vector_field"] = problem.vector_field(t, y, args)
        parts |= {f"integrals[{name!r}]": rate(t, y, args) for name, rate in problem.integrals.items()}
        names, values = problem.event_names(args), problem.event_values(t, y, args, integrals)
        parts |= {f"events[{name!r}]": value for name, value in zip(names, values, strict=True)}
        times = {name: event.times_of(args) for name, event in problem.events.items() if event.times is not None}
        parts |= {
            f"events[{name!r}].times": jax.tree.map(lambda t: jnp.isnan(t) * t, row) for name, row in times.items()
        }
        order.update(dict.fromkeys(parts))
        return {name: [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(part)] for name, part in parts.items()}

    parameters = [
        jnp.broadcast_to(jnp.asarray(number, struct.dtype), (which.size, *struct.shape))
        for number, struct in zip(signature.of_lanes(lanes.parameters, which), signature.structs(), strict=True)
    ]
    defined = jax.vmap(look)(parameters)
    undefined = {name: np.zeros(lanes.size, bool) for name in order}
    for name, flags in undefined.items():
        flags[which] = ~np.all(defined[name], axis=0)
    return undefined


def _label(name: str) -> str:
    """A number's name in print; arguments that are a number alone have none."""
    return name or "args"


def _free(name: str, taken: Mapping[str, Any]) -> str:
    """The name, with underscores after it where it is taken: "a.b" and "a_b" are both "a_b" in a dataset."""
    while name in taken:
        name += "_"
    return name
