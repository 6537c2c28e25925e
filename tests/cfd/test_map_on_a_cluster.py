"""Maps on a real Dask cluster of two processes: the same bits."""

from collections.abc import Iterator
from pathlib import Path

import pytest

import erosion
from erosion.cfd.erosion_map import erosion_map, prepare_map
from erosion.cfd.options import MapOptions
from erosion.distributions import LogNormal, Normal
from erosion.joint_laws import Rows
from tests.cfd.tables import hump, sand

pytestmark = pytest.mark.slow

distributed = pytest.importorskip("distributed")

P = erosion.TABLE_1.to("si")
SURFACE = hump()
TABLE = sand(SURFACE, 3000)
PLUG_IN = Path(__file__).parents[2] / "models" / "coulomb_tip.py"
LAW = Normal(0.0, 1e4)


@pytest.fixture(autouse=True)
def small_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("erosion.cfd.erosion_map._PORTION", 200)


@pytest.fixture(scope="module")
def client() -> Iterator:
    from erosion.impacts.cluster import local_cluster

    with local_cluster(2) as cluster, distributed.Client(cluster) as client:
        yield client


def test_a_cluster_computes_the_same_bits(client: object) -> None:
    calls: list[tuple[str, int, int]] = []
    there = erosion_map("rotating", P, TABLE, SURFACE, spin=LAW, progress=lambda *call: calls.append(call))
    assert calls == [("map", rows, 3000) for rows in range(200, 3001, 200)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("erosion.impacts.cluster.active_client", lambda: None)
        here = erosion_map("rotating", P, TABLE, SURFACE, spin=LAW)
    assert there.identical(here)


def test_a_cluster_draws_the_same_metal(client: object) -> None:
    metal = Rows({"k": [1.8, 2.0, 2.2], "psi": [0.05, 0.04, 0.03]})
    there = erosion_map("rotating", P, TABLE, SURFACE, uncertain=metal, draws=4, sigma=LogNormal(float(P.sigma), 0.1))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("erosion.impacts.cluster.active_client", lambda: None)
        here = erosion_map(
            "rotating", P, TABLE, SURFACE, uncertain=metal, draws=4, sigma=LogNormal(float(P.sigma), 0.1)
        )
    assert there.identical(here)
    assert float(here["total_parameter_error"]) > 0.1


def test_workers_load_a_plug_in_by_its_path(client: object) -> None:
    options = MapOptions(P)
    there = prepare_map(PLUG_IN, TABLE, SURFACE, options, {"friction": 0.5}).run()
    with pytest.raises(ValueError, match="`model` must be the path of a plug-in where a cluster computes"):
        erosion_map(erosion.load_model(PLUG_IN), P, TABLE, SURFACE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("erosion.impacts.cluster.active_client", lambda: None)
        here = erosion_map(erosion.load_model(PLUG_IN).replace(friction=0.5), P, TABLE, SURFACE)
    assert there.identical(here)
