"""Published numbers beside what the package gives, misses included."""

from erosion.validation.facts import Fact as Fact
from erosion.validation.facts import published_facts as published_facts
from erosion.validation.result import Comparison as Comparison
from erosion.validation.result import Validation as Validation
from erosion.validation.validate import against_published as against_published
