"""Labels of figures and pages: the histories of an impact and its kinds of end."""

from erosion.impacts.outcomes import OTHER_ENDS
from erosion.models.base import NO_CUT
from erosion.parameters.quantities import Quantity

HISTORIES = (
    ("x", "x_tip", Quantity("x", "along the surface", "length")),
    ("y", "depth", Quantity("y", "depth", "length")),
    ("vx", "vx_tip", Quantity("ẋ", "forward speed", "speed")),
    ("vy", "vdepth", Quantity("ẏ", "downward speed", "speed")),
)

NOTHING = OTHER_ENDS[NO_CUT]

AT_CONTACT = "of it at contact, beside the cut"

EVENT_LABELS = {"rebound": "rebound, y = 0", "stop": "stop, ẋ = 0"}


def end_label(ended_by: str) -> str:
    """The label of a kind of end: "ends by stop", "nothing is cut"."""
    return NOTHING if ended_by == NO_CUT else f"ends by {ended_by}"
