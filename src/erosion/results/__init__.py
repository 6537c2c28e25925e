"""Results and findings: what the package computes, as data, and the one renderer of both."""

from erosion.results.findings import (
    Finding as Finding,
    found as found,
    from_attribute as from_attribute,
    stated as stated,
    to_attribute as to_attribute,
    unique as unique,
)
from erosion.results.result import Result as Result
