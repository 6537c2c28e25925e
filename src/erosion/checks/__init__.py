"""Check the models against independent solutions on this machine."""

from erosion.checks.verify import Check as Check, Verification as Verification, verify as verify
