"""The posterior of the angle of greatest removal, which may be at a jump of V(α)."""

import dataclasses
from typing import Any

import numpy as np

from erosion.calibration.doubts import LEVEL
from erosion.optimum.alpha_max import Optimum
from erosion.parameters.quantities import RESULTS
from erosion.parameters.scales import table_scale
from erosion.tables import Result, Row, to_plain


@dataclasses.dataclass(frozen=True)
class BestAngles(Result):
    """The angle of greatest removal at each draw of a posterior.

    Args:
        optimum: the certified answers, whose fields have the shape (draws,).
    """

    optimum: Optimum

    @property
    def alpha(self) -> np.ndarray:
        """The angles [rad], shape (draws,); NaN where nothing is removed."""
        return np.atleast_1d(np.asarray(self.optimum.alpha))

    @property
    def kinds(self) -> dict[str, float]:
        """What the greatest removal is, as `Optimum.kind` has it: the share of the draws."""
        kinds, counts = np.unique(np.atleast_1d(self.optimum.kind), return_counts=True)
        return {str(kind): float(count / counts.sum()) for kind, count in zip(kinds, counts, strict=True)}

    @property
    def title(self) -> str:
        """How many draws."""
        return f"the angle of greatest removal, {len(self.alpha):,} draws"

    def rows(self) -> list[Row]:
        """Median and interval of angle and volume, and the shares of the kinds."""
        rows = []
        for name, values in (("alpha_max", self.alpha), ("volume_max", np.atleast_1d(self.optimum.volume))):
            quantity = RESULTS[name]
            low, middle, high = np.nanquantile(values, [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2])
            scale = table_scale(quantity.dimension, self.optimum.p.units, float(middle))
            ends = f"{LEVEL:.0%} of the draws: {low / scale.size:.4g} … {high / scale.size:.4g}"
            rows.append(Row(name, quantity.symbol, f"{middle / scale.size:.4g}", scale.unit, f"the median; {ends}"))
        rows += [Row(kind, "", f"{share:.1%}", "", "of the draws") for kind, share in self.kinds.items()]
        return rows

    def to_dict(self) -> dict[str, Any]:
        """The angles [rad], the volumes and their kinds, draw by draw."""
        return to_plain({
            "alpha": self.alpha,
            "volume": np.atleast_1d(self.optimum.volume),
            "kind": np.atleast_1d(self.optimum.kind),
            "kinds": self.kinds,
        })  # fmt: skip
