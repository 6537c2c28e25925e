"""The views: computed answers as options of ECharts, as data of the cut, and as HTML."""

from collections.abc import Callable, Collection, Mapping
from typing import Any

from erosion.explorer.computed import Computed
from erosion.explorer.views.curves import end_times, volumes
from erosion.explorer.views.cut import cut, histories
from erosion.explorer.views.numbers import numbers
from erosion.explorer.views.spins import sensitivities, spins

VIEWS: Mapping[str, Callable[[Computed, Collection[str]], Any]] = {
    view.__name__: view for view in (cut, volumes, histories, numbers, end_times, spins, sensitivities)
}
"""A view's function by its name: from computed answers and the names of all models to the data of its element."""
