"""`erosion.verify`: every model through every check, two at a time, with the worst error and its bound."""

import dataclasses
import functools
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from erosion.arguments import Broadcast, Progress, no_progress
from erosion.checks.reference_solutions import (
    EQUATIONS_OF,
    ReferenceSolution,
    has_heyoka,
    heyoka_solutions,
    scipy_solution,
    scipy_solution_of_model,
)
from erosion.impacts import Impact, Trajectory, TurnWarning, impact, pair_derivatives, pushed_forward, simulate
from erosion.interrupts import unawaited_threads
from erosion.models import (
    CentreOfMassTip,
    ConstantRatio,
    CuttingModel,
    FullTorque,
    HorizontalTorque,
    RigidParticle,
    TanAlpha,
    VelocityAligned,
    available_models,
    load_model,
    model_name,
    own_parameters,
    own_quantities,
    quantities,
    sizes,
    values,
    with_values,
)
from erosion.ode.step_control import require_xla
from erosion.parameters import QUANTITIES, TABLE_1, Parameters
from erosion.results import Columns, Declared, Finding, Mark, Result, Value

BOUNDS: Mapping[str, tuple[float, str]] = {
    "closed form": (1e-9, "V, V′, V″, t_c and the state midway, where an exact solution is known"),
    "engines": (1e-9, "V and t_c of the batch against the trajectory"),
    "scipy": (1e-9, "V and t_c against scipy's DOP853"),
    "heyoka": (1e-9, "V and t_c against heyoka's Taylor series"),
    "own quantities": (1e-9, "those of the model's own, against scipy's DOP853"),
    "identities": (1e-10, "momentum, spin and energy at the end; the tip's velocity"),
    "scaling": (1e-9, "V/V* of a similar impact"),
    "dV/dα": (1e-7, "against differences of V"),
    "d²V/dα²": (1e-6, "against differences of dV/dα"),
    "∂V/∂q": (1e-7, "against differences of V, q every other parameter"),
    "∂²V/∂α∂q": (1e-6, "against differences of dV/dα, q every other parameter"),
}
"""Every check: the greatest relative error that passes, and what it compares."""


@dataclasses.dataclass(frozen=True)
class Check:
    """One check of one model.

    Args:
        model: its name, or the path of its file.
        name: a key of `BOUNDS`.
        error: the worst relative error [-]; infinity where a number is missing or the cuts end differently.
        where: the impact with that error, or the error message of a check that failed.
    """

    model: str
    name: str
    error: float
    where: str

    @property
    def bound(self) -> float:
        """The greatest error that passes."""
        return BOUNDS[self.name][0]

    @property
    def compares(self) -> str:
        """The quantities and the solution that they are compared with."""
        return BOUNDS[self.name][1]

    @property
    def passed(self) -> bool:
        """Whether the error is within its bound; False for NaN."""
        return self.error <= self.bound

    @property
    def finding(self) -> Finding:
        """The same for a reader, of a check that did not pass."""
        code = "out_of_bounds" if math.isfinite(self.error) else "check_failed"
        numbers = {"check": self.name, "error": self.error, "bound": self.bound, "where": self.where}
        return Finding(code, self.model, numbers)


@dataclasses.dataclass(frozen=True, repr=False)
class Verification(Result):
    """All checks of all models.

    Args:
        checks: model by model.
        absent: solvers of reference solutions that are not installed.
        pushed: models of a user's whose force pushes a body forward.
    """

    lines = ("checks",)

    checks: tuple[Check, ...]
    absent: tuple[str, ...] = ()
    pushed: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every error is within its bound."""
        return not self.failures

    @property
    def failures(self) -> tuple[Check, ...]:
        """The checks out of bounds."""
        return tuple(check for check in self.checks if not check.passed)

    @property
    def title(self) -> str:
        """How many checks of how many models, and the verdict."""
        models = len({check.model for check in self.checks})
        verdict = f"{len(self.failures)} out of bounds" if self.failures else "all within bounds"
        return f"{len(self.checks)} checks of {models} model{'s' * (models != 1)}: {verdict}"

    def declare(self) -> list[Declared]:
        """The verdict, for each kind of check the worst error of all models, and every check."""
        kinds = [[check for check in self.checks if check.name == name] for name in BOUNDS]
        worst = [max(checks, key=lambda check: check.error) for checks in kinds if checks]
        columns = [
            Value("check", [check.name for check in worst]),
            Value("models", [len(checks) for checks in kinds if checks]),
            Value("error", [check.error for check in worst], "worst error", digits=2,
                  marks=[Mark([not check.passed for check in worst], "out of bounds")]),
            Value("bound", [check.bound for check in worst]),
            Value("model", [check.model for check in worst], "of"),
        ]  # fmt: skip
        names = ("model", "name", "compares", "error", "bound", "passed", "where")
        every = [Value(name, [getattr(check, name) for check in self.checks]) for name in names]
        return [
            Value("passed", self.passed, only="data"),
            Value("absent", [*self.absent], dims=("absent",), only="data"),
            Columns("worst", "", columns),
            Columns("checks", "", every, only="data"),
        ]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """One for each failure, each force of the wrong sign and each absent solver."""
        absent = (Finding("solver_absent", name) for name in self.absent)
        pushed = (Finding("pushed_forward", name) for name in self.pushed)
        return (*(check.finding for check in self.failures), *pushed, *absent)


_RTOL = 1e-12
_STEP = 5e-4  # of differences, over the parameter's size; their error grows as its fourth power
_SIMILAR = {"m": 3.0, "v0": 0.4, "sigma": 1.7, "b": 2.5, "psi": 0.6}
"""Factors between similar impacts; r and the spin follow from them."""

_Errors = list[Any] | np.ndarray | float  # of one case, relative


def cases() -> list[Parameters]:
    """The impacts: shallow, steep and spinning, away from the jumps of registered models."""
    spin = float(TABLE_1.v0 / TABLE_1.r)
    return [
        TABLE_1,
        TABLE_1.replace(alpha=0.08),
        TABLE_1.replace(alpha=0.95, phidot0=0.3 * spin),
        TABLE_1.replace(alpha=1.3, k=2.6),
        TABLE_1.replace(alpha=0.3, phidot0=-0.1 * spin, inertia=0.4, sigma="75e3 lbf/in^2"),
        TABLE_1.replace(alpha=0.5, k=3.0, v0="2200 in/s", m="2e-7 slinch"),
    ]


class Subject:
    """A model that is checked, and the results that several checks share."""

    def __init__(self, name: str, model: CuttingModel, *, registered: bool) -> None:
        self.name, self.model, self.registered = name, model, registered
        self.cases = cases()
        own = own_parameters(model)
        # At the least value of an own parameter there are no central differences.
        at_least = {name for name, parameter in own.items() if parameter.value <= parameter.least}
        self.others = [name for name in quantities(model) if name != "alpha" and name not in at_least]

    def checks(self) -> dict[str, Callable[[], Iterable[_Errors]]]:
        """The checks that apply to the model: name to the errors of its cases."""
        checks: dict[str, Callable[[], Iterable[_Errors]]] = {}
        if self.model.closed_form() is not None:
            checks["closed form"] = self._closed_form
        checks["engines"] = lambda: self._against([ReferenceSolution(c.volume, c.t_c, c.ended_by) for c in self.cuts])
        if self.registered:
            checks["scipy"] = lambda: self._against([scipy_solution(self.name, p) for p in self.cases])
            if has_heyoka():
                checks["heyoka"] = lambda: self._against(heyoka_solutions(self.name, self.cases))
            checks["scaling"] = self._scaling
        else:
            checks["scipy"] = lambda: self._against(self._by_scipy)
        if own_quantities(type(self.model)):
            checks["own quantities"] = self._own
        checks["identities"] = lambda: map(_identities, self.cuts)
        checks["dV/dα"] = lambda: self._slopes("alpha")[0]
        checks["d²V/dα²"] = lambda: self._slopes("alpha")[1]
        # These compile a second program, of twice the size. For the engine's own arithmetic one
        # registered model is enough; the derivatives of a plug-in are always checked.
        if not self.registered or self.name == "rotating":
            checks["∂V/∂q"] = lambda: np.max([self._slopes(q)[0] for q in self.others], axis=0)
            checks["∂²V/∂α∂q"] = lambda: np.max([self._slopes(q)[1] for q in self.others], axis=0)
        return checks

    def worst(self, errors: Iterable[_Errors]) -> tuple[float, str]:
        """The greatest of the cases' errors, and its case in words."""
        greatest = [_greatest(of_case) for of_case in errors]
        i = int(np.argmax(greatest))
        p = self.cases[i]
        return greatest[i], f"α = {np.rad2deg(float(p.alpha)):.4g}°, s = {float(p.spin):.2g}"

    @functools.cached_property
    def hits(self) -> Impact:
        """The cases as one batch, with V′ and V″."""
        return self._impact(self.cases)

    @functools.cached_property
    def cuts(self) -> list[Trajectory]:
        """The cases as trajectories."""
        return [simulate(self.model, p, points=3) for p in self.cases]

    def _impact(self, cases: Sequence[Parameters], model: CuttingModel | None = None) -> Impact:
        columns: dict[str, Any] = {q: np.array([float(getattr(p, q)) for p in cases]) for q in QUANTITIES}
        return impact(model or self.model, dataclasses.replace(cases[0], **columns), derivatives=2, rtol=_RTOL)

    def _closed_form(self) -> Iterator[_Errors]:
        exact, hits = self.model.closed_form(), self.hits
        assert exact is not None
        for i, (p, cut) in enumerate(zip(self.cases, self.cuts, strict=True)):
            size = hits.volume[i]
            midway = jax.tree.map(
                lambda computed, true, path: float(computed - true) / np.max(np.abs(path)),
                cut.at(cut.t_c / 2), exact.state(cut.t_c / 2, p), jax.tree.map(lambda leaf: leaf + 1e-300, cut.states),
            )  # fmt: skip
            yield [
                _alike(hits.ended_by[i], str(exact.ended_by(p))),
                hits.t_c[i] / exact.t_c(p) - 1,
                (hits.volume[i] - exact.volume(p)) / size,
                (hits.dvolume[i] - exact.dvolume(p)) / max(size, abs(hits.dvolume[i])),
                (hits.d2volume[i] - exact.d2volume(p)) / max(size, abs(hits.d2volume[i])),
                *jax.tree.leaves(midway),
            ]

    def _against(self, solutions: Sequence[ReferenceSolution]) -> list[_Errors]:
        """The batch against solutions of the same cases."""
        hits = self.hits
        return [
            [
                _alike(hits.ended_by[i], solution.ended_by),
                _relative(hits.volume[i], solution.volume),
                _relative(hits.t_c[i], solution.t_c),
            ]
            for i, solution in enumerate(solutions)
        ]

    def _scaling(self) -> list[_Errors]:
        similar = self._impact([_similar(p) for p in self.cases])
        return self._compared(similar, similar.p.volume_scale / self.hits.p.volume_scale)

    @functools.cached_property
    def _by_scipy(self) -> list[ReferenceSolution]:
        return [scipy_solution_of_model(self.model, p) for p in self.cases]

    def _own(self) -> np.ndarray:
        """Errors of own quantities, of the greatest of all cases: one that cancels has no size of its own."""
        errors = []
        for name in own_quantities(type(self.model)):
            by_scipy = np.array([solution.own[name] for solution in self._by_scipy])
            size = np.max(np.abs(by_scipy), initial=1e-300)
            errors.append((self.hits.quantities[name] - by_scipy) / size)
        return np.max(np.abs(errors), axis=0)

    def _compared(self, hits: Impact, factor: Broadcast) -> list[_Errors]:
        """Impacts whose volumes are those of the cases times a factor, against the cases."""
        volumes = self.hits.volume * factor
        return [
            [_alike(self.hits.ended_by[i], hits.ended_by[i]), _relative(hits.volume[i], volume)]
            for i, volume in enumerate(volumes)
        ]

    @functools.cached_property
    def _mixed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        volume = pair_derivatives(self.model, self.hits.p, [("alpha", q) for q in self.others], rtol=_RTOL).volume
        return {q: (volume.by_second[:, j], volume.mixed[:, j]) for j, q in enumerate(self.others)}

    def _slopes(self, q: str) -> list[np.ndarray]:
        """Errors of ∂V/∂q and ∂V′/∂q against central differences extrapolated to step 0 (Richardson)."""
        p, hits = self.hits.p, self.hits
        start, unit = values(self.model, p)[q], sizes(self.model, p)[q]

        def moved(share: float) -> Impact:
            model, moved_p = with_values(self.model, p, {q: start + share * _STEP * unit})
            return impact(model, moved_p, derivatives=2, rtol=_RTOL)

        exact = (hits.dvolume, hits.d2volume) if q == "alpha" else self._mixed[q]
        around = {share: moved(share) for share in (1.0, -1.0, 0.5, -0.5)}
        # Beside a kink or a jump there is no derivative to compare with.
        smooth = np.all([neighbours.ended_by == hits.ended_by for neighbours in around.values()], axis=0)
        errors = []
        for name, computed in zip(("volume", "dvolume"), exact, strict=True):
            coarse, fine = (
                (getattr(around[share], name) - getattr(around[-share], name)) / (2 * share * _STEP * unit)
                for share in (1.0, 0.5)
            )
            size = np.maximum(np.maximum(hits.volume, np.abs(hits.dvolume)) / unit, np.abs(computed))
            error = np.abs(computed - (4 * fine - coarse) / 3)
            relative = np.where(error != 0, error / np.where(size > 0, size, 1.0), 0.0)
            # A check without any smooth case has compared nothing, so it must not pass.
            errors.append(np.where(smooth, relative, 0.0) if smooth.any() else np.full_like(relative, np.nan))
        return errors


def _similar(p: Parameters) -> Parameters:
    """An impact with the same k, α, β, rω/v₀ and s, so that V/V* is the same."""
    similar = dataclasses.replace(p, **{q: getattr(p, q) * factor for q, factor in _SIMILAR.items()})
    similar = dataclasses.replace(similar, r=p.r * (similar.v0 / p.v0) * (p.rate / similar.rate))
    return similar.replace(phidot0=p.spin * similar.v0 / similar.r)


def _identities(cut: Trajectory) -> _Errors:
    """Errors of identities between the begin and the end of a cut, or at one moment, that need no solver."""
    model, p = cut.model, cut.p
    # The tip's velocity against the rate of its position, midway.
    state = jax.tree.map(lambda leaf: jnp.asarray(leaf[len(leaf) // 2]), cut.states)
    rate = jax.tree.map(jnp.asarray, model.derivative(state, p))
    tip, flow = jax.jvp(lambda state: model.tip(state, p), (state,), (rate,))
    errors = [(flow.x - tip.vx) / p.v0, (flow.depth - tip.vdepth) / p.v0]
    if not isinstance(model, RigidParticle) or len(cut.t) < 2:
        return errors
    ratio, cut_away = _constant_ratio(model, p), cut.volume - cut.removed[0]
    if isinstance(model.torque, HorizontalTorque):
        # φ̇ - φ̇₀ = (ẋ - ẋ(0))/(β r).
        change = (cut.vx[-1] - cut.vx[0]) / (p.inertia * p.r)
        errors.append((cut.omega[-1] - cut.omega[0] - change) / np.abs(change))
    if ratio is None:
        return errors
    # ẏ - ẏ(0) = K (ẋ - ẋ(0)).
    errors.append((cut.vy[-1] - cut.vy[0] - ratio * (cut.vx[-1] - cut.vx[0])) / p.v0)
    if isinstance(model.kinematics, CentreOfMassTip):
        # V = (m/2σψ)(ẋ(0)² - ẋ(t_c)²).
        errors.append(p.m / (2 * p.sigma * p.psi) * (cut.vx[0] ** 2 - cut.vx[-1] ** 2) / cut_away - 1)
    if isinstance(model.torque, FullTorque):
        # V = (KE(0) - KE(t_c))/(σψ) - (K b/2) depth(t_c)².
        energy = p.m / 2 * (cut.vx**2 + cut.vy**2) + p.moment_of_inertia / 2 * cut.omega**2
        lost = (energy[0] - energy[-1]) / (p.sigma * p.psi) - ratio * p.b / 2 * cut.depth[-1] ** 2
        errors.append(lost / cut_away - 1)
    return errors


def _constant_ratio(model: RigidParticle, p: Parameters) -> Broadcast | None:
    """K, where the force is -c · depth (1, K) with the same K during the whole cut; else None."""
    if type(model.force) is ConstantRatio:
        return p.k
    # d(ẏ/ẋ)/dt = 0: a force along the velocity never turns the velocity.
    return np.tan(p.alpha) if type(model.force) in (TanAlpha, VelocityAligned) else None


def _relative(computed: float, reference: float) -> float:
    return 0.0 if computed == reference else computed / reference - 1


def _alike(ended_by: str, reference: str) -> float:
    return 0.0 if ended_by == reference else np.inf


def _greatest(errors: _Errors) -> float:
    """The greatest magnitude; infinity where a number is NaN."""
    magnitudes = np.abs(np.asarray(jax.tree.map(float, errors) if isinstance(errors, list) else errors, float))
    return float(np.max(np.where(np.isnan(magnitudes), np.inf, magnitudes), initial=0.0))


_THREADS = 2  # more would wait for Python's lock, which compiling seldom releases


def verify(
    models: Sequence[CuttingModel | str | Path] | CuttingModel | str | Path | None = None,
    *,
    progress: Progress = no_progress,
) -> Verification:
    """Check models on this machine against closed forms, identities, and independent solutions.

    Registered models are also compared with their equations typed a second time, solved by scipy
    and, where it is installed, by heyoka; other models with their own equations, solved by scipy.

    Args:
        models: a model or several, names or paths; every registered model without it.
        progress: called with the name of a model that is done, how many models are done, and how many there are.

    Returns:
        For each model and check the worst relative error and its bound; `passed` if all are within.

    Raises:
        ModelError: for a name that is unknown or a file that cannot be used.
    """
    require_xla()
    checks: list[Check] = []
    if models is None:
        available = available_models()
        models = [name for name, info in available.items() if info.error is None]
        checks += [Check(name, "engines", float("inf"), info.error) for name, info in available.items() if info.error]
    elif isinstance(models, (CuttingModel, str, Path)):
        models = [models]
    loaded = [load_model(model) for model in models]
    names = [model_name(model) if isinstance(model, CuttingModel) else str(model) for model in models]
    subjects = [
        Subject(name, model, registered=name in EQUATIONS_OF) for name, model in zip(names, loaded, strict=True)
    ]
    done = 0

    def examined(subject: Subject) -> list[Check]:
        nonlocal done
        checks, name = list[Check](), "closed form"
        try:
            for name, errors in subject.checks().items():
                checks.append(Check(subject.name, name, *subject.worst(errors())))
        # A plug-in's own code may raise anything. A model that fails in one check would fail in the others too.
        except Exception as error:  # noqa: BLE001
            said = " ".join(str(error).split()) or type(error).__name__
            checks.append(Check(subject.name, name, float("inf"), said))
        done += 1
        progress(subject.name, done, len(subjects))
        return checks

    # Filters are the process's, not the thread's.
    with warnings.catch_warnings(), unawaited_threads(_THREADS) as pool:
        warnings.simplefilter("ignore", TurnWarning)  # only numbers count here
        for of_model in pool.map(examined, subjects):
            checks += of_model
    pushed = [name for name, model in zip(names, loaded, strict=True) if pushed_forward(model, TABLE_1)]
    return Verification(tuple(checks), () if has_heyoka() else ("heyoka",), tuple(pushed))
