"""Maps on a real Dask cluster of two processes: the same bits."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from scipy import stats

import erosion
from erosion.cfd.erosion_map import erosion_map, prepare_map
from erosion.cfd.options import MapOptions
from erosion.laws import JointSamples
from tests.cfd.tables import hump, sand

distributed = pytest.importorskip("distributed")

P = erosion.TABLE_1.to("si")
SURFACE = hump()
TABLE = sand(SURFACE, 3000)
PLUG_IN = Path(__file__).parents[2] / "models" / "coulomb_tip.py"


@pytest.fixture(autouse=True)
def small_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("erosion.cfd.erosion_map._PORTION", 200)


@pytest.fixture(scope="module")
def client() -> Iterator:
    from erosion.impacts.cluster import local_cluster

    with local_cluster(2) as cluster, distributed.Client(cluster) as client:
        yield client


def here(model: Any, **options: Any) -> xr.Dataset:
    """The map in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("erosion.impacts.cluster.active_client", lambda: None)
        return erosion_map(model, P, TABLE, SURFACE, **options)


UNKNOWN: dict[str, Any] = {"uncertain": JointSamples({"k": [1.8, 2.0, 2.2], "psi": [0.05, 0.04, 0.03]}), "draws": 4,
                           "sigma": stats.lognorm(0.1, scale=float(P.sigma))}  # fmt: skip


@pytest.mark.parametrize("options", [{"spin": stats.norm(0.0, 1e4)}, UNKNOWN], ids=["spins", "metal"])
def test_a_cluster_computes_the_same_bits(client: object, options: dict[str, Any]) -> None:
    calls: list[tuple[str, int, int]] = []
    there = erosion_map("rotating", P, TABLE, SURFACE, progress=lambda *call: calls.append(call), **options)
    step = 200 // options.get("draws", 1)
    assert calls == [("map", rows, 3000) for rows in range(step, 3001, step)]
    assert there.identical(here("rotating", **options))


def test_workers_load_a_plug_in_by_its_path(client: object) -> None:
    there = prepare_map(PLUG_IN, TABLE, SURFACE, MapOptions(P), {"friction": 0.5}).run()
    with pytest.raises(ValueError, match="`model` must be the path of a plug-in where a cluster computes"):
        erosion_map(erosion.load_model(PLUG_IN), P, TABLE, SURFACE)
    assert there.identical(here(erosion.load_model(PLUG_IN).replace(friction=0.5)))
