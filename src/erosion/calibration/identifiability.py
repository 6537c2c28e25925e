"""Which parameters the data can tell apart, from the Jacobian at the fit.

Parameters that enter only as a product leave the prediction unchanged along a direction of
their logarithms. The singular vectors of the Jacobian with vanishing singular values show
these directions; the other singular vectors are the combinations that are determined.
"""

import dataclasses
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

# The engine's derivatives hold nine digits, so a direction without influence has 1e-9 or less.
_NOTHING = 1e-7  # of the prediction: influence of a parameter
_NULL = 1e-6  # of the largest singular value
_INVOLVED = 1e-4  # component of a parameter in a direction


class Group(NamedTuple):
    """Parameters that the data leaves open together.

    Args:
        names: of these parameters.
        statement: a sentence on what is determined.
        direction: a change of θ that leaves the prediction as it is, shape (n,).
    """

    names: tuple[str, ...]
    statement: str
    direction: np.ndarray


@dataclasses.dataclass(frozen=True)
class Identifiability:
    """The parameters and combinations that the data determines.

    Args:
        covariance: of θ, for residuals of variance 1; infinite on the diagonal for parameters
            that are not determined, and NaN beside it; shape (n, n).
        modes: directions of θ that are determined, each as long as one standard deviation
            for residuals of variance 1; shape (n, rank).
        undetermined: the names of the parameters that are not determined.
        groups: of undetermined parameters.
    """

    covariance: np.ndarray
    modes: np.ndarray
    undetermined: tuple[str, ...]
    groups: tuple[Group, ...]

    @property
    def statements(self) -> tuple[str, ...]:
        """A sentence for each group of undetermined parameters."""
        return tuple(group.statement for group in self.groups)

    @property
    def rank(self) -> int:
        """How many combinations of the parameters are determined."""
        return self.modes.shape[1]


def identify(names: Sequence[str], jacobian: np.ndarray, exponent: np.ndarray, size: float) -> Identifiability:
    """Find the combinations of parameters that the residuals depend on.

    Args:
        names: of the parameters.
        jacobian: of the weighted residuals with respect to θ, shape (rows, n), rows ≥ n.
        exponent: dθ/d(log q), 1 for θ = log q; shape (n,). Combinations are products of powers.
        size: norm of the weighted prediction, with which influences are compared.
    """
    n = len(names)
    norms = np.linalg.norm(jacobian, axis=0)
    active = norms > _NOTHING * size
    groups = [
        Group((name,), f"{name} has no influence on these data and cannot be determined.", direction)
        for name, counts, direction in zip(names, active, np.eye(n), strict=True)
        if not counts
    ]
    undetermined = ~active
    modes = np.zeros((n, 0))
    if active.any():
        index, scaled = np.flatnonzero(active), jacobian[:, active] / norms[active]
        _, strength, across = np.linalg.svd(scaled, full_matrices=False)
        determined = strength > _NULL * strength[0]
        modes = np.zeros((n, int(determined.sum())))
        modes[index] = across[determined].T / norms[active][:, None] / strength[determined]
        if not determined.all():
            null = across[~determined].T
            involved = np.abs(null).max(axis=1) > _INVOLVED
            undetermined[index[involved]] = True
            thetas = np.zeros((n, null.shape[1]))
            thetas[index] = null / norms[active][:, None]
            groups += _ties(names, index[involved], thetas, exponent)
    covariance = modes @ modes.T
    covariance[undetermined, :] = covariance[:, undetermined] = np.nan
    covariance[undetermined, undetermined] = np.inf
    return Identifiability(
        covariance,
        modes,
        tuple(name for name, flag in zip(names, undetermined, strict=True) if flag),
        tuple(groups),
    )


def _ties(all_names: Sequence[str], involved: np.ndarray, thetas: np.ndarray, exponent: np.ndarray) -> list[Group]:
    """The groups of parameters that null directions of θ, shape (n, directions), tie together."""
    names, null = [all_names[int(i)] for i in involved], thetas[involved] / exponent[involved][:, None]
    sparse = _reduced(null.T)
    determined = _reduced(null_space(null.T).T) if null.shape[1] < len(names) else np.zeros((0, len(names)))
    groups, remaining = [], list(range(len(names)))
    while remaining:
        group = {remaining[0]}
        while True:
            rows = [row for row in (*sparse, *determined) if any(abs(row[i]) > _INVOLVED for i in group)]
            wider = group | {i for row in rows for i in np.flatnonzero(np.abs(row) > _INVOLVED).tolist()}
            if wider == group:
                break
            group = wider
        remaining = [i for i in remaining if i not in group]
        products = [_product(names, row) for row in determined if any(abs(row[i]) > _INVOLVED for i in group)]
        tied = " and ".join((", ".join(names[i] for i in sorted(group)[:-1]), names[max(group)]))
        only = f"only {' and '.join(products)} {'is' if len(products) == 1 else 'are'} determined"
        direction = np.zeros(len(all_names))
        members = sorted(group)
        direction[involved[members]] = _within(null, members) * exponent[involved[members]]
        groups.append(Group(tuple(names[i] for i in members), f"{tied} cannot be told apart: {only}.", direction))
    return groups


def _within(null: np.ndarray, members: list[int]) -> np.ndarray:
    """A null direction of the members alone, which no direction ties to others; shape (members,)."""
    strongest = np.linalg.svd(null[members], full_matrices=False)[0]
    return strongest[:, 0]


def _reduced(rows: np.ndarray) -> np.ndarray:
    """The reduced row echelon form, whose rows are sparse combinations; of the same shape."""
    rows, at = rows.copy(), 0
    for column in range(rows.shape[1]):
        if at == len(rows):
            break
        pivot = at + int(np.argmax(np.abs(rows[at:, column])))
        if abs(rows[pivot, column]) < _INVOLVED * np.abs(rows).max():
            continue
        rows[[at, pivot]] = rows[[pivot, at]]
        rows[at] /= rows[at, column]
        others = np.arange(len(rows)) != at
        rows[others] -= np.outer(rows[others, column], rows[at])
        at += 1
    return rows


def _product(names: Sequence[str], exponents: np.ndarray) -> str:
    """Powers as text: "sigma·psi", "m/(sigma·psi)"."""
    above = [_power(name, e) for name, e in zip(names, exponents, strict=True) if e > _INVOLVED]
    below = [_power(name, -e) for name, e in zip(names, exponents, strict=True) if e < -_INVOLVED]
    text = "·".join(above) or "1"
    if not below:
        return text
    return f"{text}/{below[0]}" if len(below) == 1 else f"{text}/({'·'.join(below)})"


def _power(name: str, exponent: float) -> str:
    simple = Fraction(float(exponent)).limit_denominator(6)
    if abs(exponent - simple) < 1e-3:
        return name if simple == 1 else f"{name}^{simple}" if simple.denominator == 1 else f"{name}^({simple})"
    return f"{name}^{exponent:.3g}"
