"""Check the models against independent solutions on this machine, and against published numbers."""

from erosion.checks.validate import (
    FACTS as FACTS,
    Comparison as Comparison,
    Fact as Fact,
    Validation as Validation,
    against_published as against_published,
)
from erosion.checks.verify import Check as Check, Verification as Verification, verify as verify
