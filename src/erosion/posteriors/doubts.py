"""Words on what is doubtful in a posterior: draws that do not agree, ridges, priors that decide, a poor model."""

from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from erosion.calibration.doubts import POOR
from erosion.calibration.identifiability import identify
from erosion.posteriors.convergence import EFFECTIVE, RHAT
from erosion.posteriors.priors import at_ends

if TYPE_CHECKING:
    from erosion.posteriors.result import Posterior

_EVIDENCE = 0.5  # standard error of ln Z, from which on a factor of evidence means little
_END, _PILED = 0.01, 0.1  # an end of a prior, and the share of draws there that shows that the prior decides


def sentences(posterior: "Posterior") -> tuple[str, ...]:
    """All of them; none for a good result."""
    return (*not_converged(posterior), *_ridges(posterior), *_at_ends(posterior), *_poor(posterior))


def not_converged(posterior: "Posterior") -> tuple[str, ...]:
    """What is wrong with the draws, with advice."""
    said = []
    bad = {name: rhat for name, rhat in posterior.rhat.items() if not rhat <= RHAT}
    if bad:
        greatest = max(bad, key=lambda name: bad[name])
        said.append(
            f"Not converged: the populations of draws disagree about {', '.join(bad)} (R̂ of {greatest} is "
            f"{bad[greatest]:.3f}, good to {RHAT}). Ask for more draws."
        )
    least = EFFECTIVE * len(posterior.run.log_evidence)
    few = {name: count for name, count in posterior.effective.items() if not count >= least}
    if few:
        fewest = min(few, key=lambda name: few[name])
        said.append(
            f"Not converged: there are too few effective draws of {', '.join(few)} ({few[fewest]:.0f} of {fewest}, "
            f"good from {least}). Ask for more draws."
        )
    if not posterior.log_evidence_error <= _EVIDENCE:
        said.append(
            f"Not converged: the populations disagree about the evidence (ln Z to {posterior.log_evidence_error:.2g}). "
            "Ask for more draws."
        )
    return tuple(said)


def _ridges(posterior: "Posterior") -> list[str]:
    """Parameters that the data cannot tell apart, in the words of a fit."""
    forward, data = posterior.likelihood.forward, posterior.data
    deviation = data.uncertainty if data.uncertainty is not None else np.full(len(data), np.std(data.erosion))
    theta = posterior.best
    predicted, rates = forward.predict(theta, data.conditions)
    jacobian = rates / deviation[:, None]
    if len(data) < len(forward.names) or not np.isfinite(jacobian).all():
        return []
    exponent = np.where(forward.logarithmic | (theta == 0), 1.0, theta)
    groups = identify(forward.names, jacobian, exponent, float(np.linalg.norm(predicted / deviation))).groups
    return [
        f"{group.statement} "
        + ("Its draws are those of the prior." if len(group.names) == 1 else "How far the ridge goes, the priors say.")
        for group in groups
    ]


def _at_ends(posterior: "Posterior") -> list[str]:
    """Draws that crowd at an end of their prior."""
    said = []
    shares = at_ends(_END, posterior.names, posterior.run.points)
    for name, (low, high) in shares.items():
        share, end = max((low, "lowest"), (high, "highest"))
        if share > _PILED:
            said.append(
                f"{share:.0%} of the draws of {name} lie in the {end} hundredth of its prior, "
                f"{posterior.priors.in_words(name, posterior.quantities[name], posterior.p.units)}: prior and data "
                "disagree, or the prior is too narrow."
            )
    return said


def _poor(posterior: "Posterior") -> list[str]:
    """A sentence where no parameters explain the data."""
    if posterior.data.uncertainty is None:
        return []
    chi2, rows = -2 * posterior.run.log_likelihood, len(posterior.data)
    if float(stats.chi2.sf(chi2, rows).mean()) >= POOR:
        return []
    return [
        f"The uncertainties do not explain the misfit: χ² is {np.median(chi2):.4g} for {rows:,} rows. The intervals "
        "hold only if the model were right."
    ]
