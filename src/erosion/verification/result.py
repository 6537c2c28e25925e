"""The checks of a verification, their bounds and their errors."""

import dataclasses
import math
from collections.abc import Mapping

from erosion.tables import Record, Result, to_plain

BOUNDS: Mapping[str, tuple[float, str]] = {
    "closed form": (1e-9, "V, V′, V″, t_c and the state midway, where an exact solution is known"),
    "engines": (1e-9, "V and t_c of the batch against the trajectory"),
    "scipy": (1e-9, "V and t_c against scipy's DOP853"),
    "heyoka": (1e-9, "V and t_c against heyoka's Taylor series"),
    "identities": (1e-10, "momentum, spin and energy at the end; the tip's velocity"),
    "scaling": (1e-9, "V/V* of a similar impact"),
    "units": (1e-9, "the same impact in the other unit system"),
    "dV/dα": (1e-7, "against differences of V"),
    "d²V/dα²": (1e-6, "against differences of dV/dα"),
    "∂V/∂q": (1e-7, "against differences of V, q every other parameter"),
    "∂²V/∂α∂q": (1e-6, "against differences of dV/dα, q every other parameter"),
}
"""Every check: the greatest relative error that passes, and what it compares."""

HEADINGS = ("check", "models", "worst error", "bound", "of")

_NAMES = ("model", "name", "compares", "error", "bound", "passed", "where")


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

    def __str__(self) -> str:
        verdict = f"{self.error:.1e} is above {self.bound:.0e}" if math.isfinite(self.error) else "failed"
        return f"{self.model}: {self.name}: {verdict} ({self.where})"


@dataclasses.dataclass(frozen=True, repr=False)
class Verification(Result):
    """All checks of all models.

    Args:
        checks: model by model.
        absent: solvers of reference solutions that are not installed.
    """

    checks: tuple[Check, ...]
    absent: tuple[str, ...] = ()

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

    @property
    def headings(self) -> tuple[str, ...]:
        """The columns of the table."""
        return HEADINGS

    def rows(self) -> list[tuple[str, ...]]:
        """For each kind of check the worst error of all models."""
        rows: list[tuple[str, ...]] = []
        for name, (bound, _) in BOUNDS.items():
            checks = [check for check in self.checks if check.name == name]
            if checks:
                worst = max(checks, key=lambda check: check.error)
                mark = "" if worst.passed else " ✗"
                rows.append((name, str(len(checks)), f"{worst.error:.1e}{mark}", f"{bound:.0e}", worst.model))
        return rows

    @property
    def statements(self) -> tuple[str, ...]:
        """A sentence for each failure."""
        return tuple(map(str, self.failures))

    def to_dict(self) -> Record:
        """The verdict and every check."""
        checks = [{name: getattr(check, name) for name in _NAMES} for check in self.checks]
        return to_plain({"passed": self.passed, "absent": self.absent, "checks": checks})

    def __repr__(self) -> str:
        return f"Verification({self.title!r})"
