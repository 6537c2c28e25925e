"""`against_published`: every fact, and what the package gives for it."""

from erosion.ode.precision import require_float64
from erosion.validation.computed import COMPUTATIONS
from erosion.validation.facts import Fact, published_facts
from erosion.validation.result import Comparison, Validation


def against_published() -> Validation:
    """Compare models and correlations with published numbers, misses included.

    Returns:
        For each fact the published number with its source, and the package's own. It prints as a table.
    """
    require_float64()
    return Validation(tuple(Comparison(fact, computed(fact)) for fact in published_facts()))


def computed(fact: Fact) -> float:
    """What the package gives for a fact [`fact.unit`]."""
    return float(COMPUTATIONS[fact.computes](**fact.given))
