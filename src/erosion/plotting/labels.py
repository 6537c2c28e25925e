"""What figures and pages show of an impact, and what they call it."""

from erosion.parameters.quantities import Quantity

HISTORIES = (
    ("x", "x_tip", Quantity("x", "along the surface", "length")),
    ("y", "depth", Quantity("y", "depth", "length")),
    ("vx", "vx_tip", Quantity("ẋ", "forward speed", "speed")),
    ("vy", "vdepth", Quantity("ẏ", "downward speed", "speed")),
)

EVENT_LABELS = {"rebound": "rebound, y = 0", "stop": "stop, ẋ = 0"}
