"""The metals of the scenario."""

import types
from collections.abc import Mapping

MATERIALS: Mapping[str, float] = types.MappingProxyType(
    {"mild steel": 37e3, "brass": 27e3, "copper": 10e3, "stainless steel": 75e3, "titanium": 136e3}
)
"""Flow stress of the metals of Laverty, Table 2 [lbf/in²]; `p.with_material("copper")` converts it to those of `p`."""
