"""Check the models against independent solutions on this machine, and against published numbers."""

from erosion.checks.validate import FACTS as FACTS
from erosion.checks.validate import Comparison as Comparison
from erosion.checks.validate import Fact as Fact
from erosion.checks.validate import Validation as Validation
from erosion.checks.validate import against_published as against_published
from erosion.checks.verify import Check as Check
from erosion.checks.verify import Verification as Verification
from erosion.checks.verify import verify as verify
