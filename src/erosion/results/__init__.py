"""Results and findings: numbers with the statements that qualify them."""

from erosion.results.findings import (
    Finding as Finding,
    found as found,
    from_attribute as from_attribute,
    stated as stated,
    to_attribute as to_attribute,
    unique as unique,
)
from erosion.results.result import Result as Result
