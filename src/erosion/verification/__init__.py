"""Does it compute what it says, here and now? Every model against independent solutions."""

from erosion.verification.result import Check as Check
from erosion.verification.result import Verification as Verification
from erosion.verification.verify import verify as verify
