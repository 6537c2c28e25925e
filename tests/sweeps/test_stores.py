import numpy as np

import erosion
from erosion.sweeps.grid import make_grid
from erosion.sweeps.stores import MemoryStore


def test_a_block_counts_only_when_all_of_it_is_there():
    grid = make_grid("linearized", erosion.TABLE_1, {"alpha": np.linspace(0.1, 1.4, 4)})
    store = MemoryStore(grid, (4,))
    half = (slice(0, 2),)
    store.write(half, grid[half].solve())
    assert store.missing() == [(slice(0, 4),)]
    store.write((slice(2, 4),), grid[(slice(2, 4),)].solve())
    assert store.missing() == []
