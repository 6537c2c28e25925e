"""Check on this machine that every model agrees with independent solutions."""

from erosion.verification.result import Check as Check
from erosion.verification.result import Verification as Verification
from erosion.verification.verify import verify as verify
