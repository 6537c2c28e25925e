"""The work that every contender does, and the form of its answers."""

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import erosion

NO_CUT, FAILED, REBOUND, STOP = -1, -2, 0, 1
_CODES = {"rebound": REBOUND, "stop": STOP, "no-cut": NO_CUT}

ALPHAS = (0.05, 1.5)  # angles of attack [rad]
SPINS = (-0.5, 0.5)  # s = r φ̇0 / v0 [-]


class Answers(NamedTuple):
    """A contender's results, every array of shape (lanes,).

    Args:
        volume: V [in³].
        end: REBOUND, STOP, NO_CUT or FAILED.
        first, second: dV/dα and d²V/dα², or None.
    """

    volume: np.ndarray
    end: np.ndarray
    first: np.ndarray | None = None
    second: np.ndarray | None = None

    def part(self, n: int) -> "Answers":
        """Those of `Work.first(n)`."""
        index = _spread(n, self.volume.size)
        first, second = (None if column is None else column[index] for column in (self.first, self.second))
        return Answers(self.volume[index], self.end[index], first, second)


def _spread(n: int, size: int) -> np.ndarray:
    """`n` indices, evenly spread over `size`."""
    return np.linspace(0, size - 1, min(n, size)).astype(int)


class Constants(NamedTuple):
    """Table 1 without units: time in 1/ω, length in v0/ω.

    Args:
        k, beta: force ratio and I/(m r²) [-].
        rho: r ω / v0 [-].
        volume: b (v0/ω)², the unit of volume [in³].
    """

    k: float
    beta: float
    rho: float
    volume: float


def constants() -> Constants:
    """Table 1 for the peers, which are given the equations without units.

    Written out, so that a peer's cold start need not import the package (and JAX); a digit
    that differed from `erosion.TABLE_1` would show as an error of every volume.
    """
    k, psi, r, b, m, v0, sigma, beta = 2.0, 0.04, 0.04, 0.04, 2.855e-7, 4400.0, 200e3, 0.5
    rate = float(np.sqrt(k * sigma * b * psi / m))
    return Constants(k, beta, r * rate / v0, b * (v0 / rate) ** 2)


@dataclasses.dataclass(frozen=True)
class Work:
    """Impacts at Table 1 that differ in angle and spin.

    Args:
        alpha: angles of attack [rad].
        s: spins r φ̇0 / v0 [-].
    """

    alpha: np.ndarray
    s: np.ndarray

    def __len__(self) -> int:
        return self.alpha.size

    def first(self, n: int) -> "Work":
        """A sample of `n` impacts, evenly spread (so that ordered work stays ordered)."""
        index = _spread(n, len(self))
        return Work(self.alpha[index], self.s[index])

    def cutting(self) -> np.ndarray:
        """Which impacts cut at all: the tip moves forward at contact, cos α + s > 0."""
        return np.cos(self.alpha) + self.s > 0

    def parameters(self) -> "erosion.Parameters":
        """The same work for `erosion.impact`."""
        import erosion

        p = erosion.TABLE_1
        return p.replace(alpha=self.alpha, phidot0=self.s * float(p.v0) / float(p.r))


def random_work(n: int) -> Work:
    """Angles and spins drawn evenly from the seeded sample all runs share."""
    generator = np.random.default_rng(1958)
    return Work(generator.uniform(*ALPHAS, n), generator.uniform(*SPINS, n))


def one_impact() -> Work:
    """Table 1 as it is: 20°, no spin."""
    return Work(np.array([np.deg2rad(20.0)]), np.zeros(1))


def ordered_work(n: int) -> Work:
    """Ordered angles without spin: neighbours in a block take the same steps."""
    return Work(np.linspace(*ALPHAS, n), np.zeros(n))


def from_impact(result: Any) -> Answers:
    """The engine's result as answers."""
    end = np.full(np.shape(result.volume), FAILED)
    for name, code in _CODES.items():
        end[np.asarray(result.ended_by) == name] = code
    return Answers(np.asarray(result.volume), end, result.dvolume, result.d2volume)


def as_answers(result: Any) -> Answers:
    """Any contender's result as answers."""
    return result if isinstance(result, Answers) else from_impact(result)


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How good a contender's answers are.

    Args:
        wrong: lanes with another end than the reference, no finite answer, or a volume off by
            more than 1e-6.
        errors: for V and, where given, V' and V'', the median, 99th percentile and maximum of
            the relative error of all other lanes.
    """

    wrong: int
    errors: list[tuple[float, float, float]]


def judge(answers: Answers, reference: Answers) -> Verdict:
    """Compare with the reference.

    The error of V is relative to V itself. V' and V'' pass through zero: theirs is relative
    to their own size or to the median size over all lanes, whichever is larger.
    """
    cut = reference.end != NO_CUT
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.abs(answers.volume - reference.volume) / np.where(cut, reference.volume, 1.0)
    right = (answers.end == reference.end) & (off < 1e-6)
    errors = [_quantiles(off[right & cut])]
    pairs = ((answers.first, reference.first), (answers.second, reference.second))
    for column, true in pairs:
        if column is not None and true is not None:
            size = np.abs(true[right & cut])
            errors.append(_quantiles(np.abs(column - true)[right & cut] / np.maximum(size, np.median(size))))
    return Verdict(int(np.count_nonzero(~right)), errors)


def _quantiles(values: np.ndarray) -> tuple[float, float, float]:
    if not values.size:
        return np.nan, np.nan, np.nan
    return float(np.median(values)), float(np.quantile(values, 0.99)), float(values.max())
