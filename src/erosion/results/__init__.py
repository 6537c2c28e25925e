"""Results and findings: numbers declared once, with the statements that qualify them."""

from erosion.results.declaration import (
    PLAIN as PLAIN,
    Columns as Columns,
    Declare as Declare,
    Declared as Declared,
    Mark as Mark,
    Scale as Scale,
    System as System,
    Value as Value,
    ValueGroup as ValueGroup,
)
from erosion.results.findings import (
    Finding as Finding,
    found as found,
    from_attribute as from_attribute,
    stated as stated,
    to_attribute as to_attribute,
    unique as unique,
)
from erosion.results.render import in_unit as in_unit
from erosion.results.result import Result as Result
