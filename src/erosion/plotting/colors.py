"""The colours of figures and pages."""

from collections.abc import Mapping, Sequence
from typing import Any

from erosion.models.base import NO_CUT

# Okabe and Ito (2008), "Color universal design": readers with any colour vision can distinguish them.
PALETTE: Mapping[str, str] = {
    "blue": "#0072b2", "vermillion": "#d55e00", "green": "#009e73",
    "purple": "#cc79a7", "sky": "#56b4e9", "orange": "#e69f00",
}  # fmt: skip
STYLES: Sequence[tuple[str, Any]] = tuple(
    (color, line) for line in ("-", (0, (5, 2)), (0, (1.5, 1.5))) for color in PALETTE.values()
)
"""Colour and line style of the first, second, … curve of a figure."""

MARKS = "os^Dv<>phX*P"
"""The mark of the first, second, … group of measurements."""

INK = "#24292f"
FAINT = "#d0d7de"
DIM = "#7d858e"

REMOVED_AT_CONTACT: Mapping[str, Any] = {"color": PALETTE["purple"], "alpha": 0.4, "linewidth": 0}
"""The style of areas that stand for what is removed at contact."""

ENDS: Mapping[str, str] = {"rebound": PALETTE["blue"], "stop": PALETTE["vermillion"], NO_CUT: DIM}
"""The colour of each kind of end, the same in every figure."""
