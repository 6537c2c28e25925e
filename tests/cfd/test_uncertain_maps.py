"""Maps whose parameters vary from impact to impact, or are one number for all impacts that is not known."""

from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy import stats

import erosion
import erosion.cfd.erosion_map
from erosion.cfd.erosion_map import erosion_map
from erosion.cfd.map_result import MapSummary
from erosion.cfd.options import MapOptions
from erosion.laws import JointLaw, JointSamples
from tests.cfd.tables import Table, hump, sand

P = erosion.TABLE_1.to("si")
SURFACE = hump()
TABLE = sand(SURFACE, 1000)


def metal(draws: int = 64) -> JointSamples:
    """σ and ψ that are known to 20 % and 10 %, and depend on each other."""
    rng = np.random.default_rng(5)
    scores = rng.standard_normal((2, draws))
    sigma = float(P.sigma) * np.exp(0.2 * scores[0])
    return JointSamples({"sigma": sigma, "psi": float(P.psi) * np.exp(0.1 * scores[1] - 0.05 * scores[0])})


@pytest.fixture(scope="module")
def plain() -> xr.Dataset:
    return erosion_map("linearized", P, TABLE, SURFACE)


def test_an_error_of_the_metal_is_the_same_in_all_faces_and_in_the_total(plain: xr.Dataset) -> None:
    # V of the linearized cut goes with 1/σψ. 64 draws by Sobol's points take each of 64 rows once.
    rows = metal()
    wear = erosion_map("linearized", P, TABLE, SURFACE, uncertain=rows)
    factor = float(P.sigma * P.psi) / (rows.columns["sigma"] * rows.columns["psi"])
    exact = np.std(factor, ddof=1) / np.mean(factor)
    # E[(wV)²] has the square of the factor.
    sampling = plain["relative_error"] * np.sqrt(np.mean(factor**2)) / factor.mean()
    assert 0.1 < exact < 0.3
    expected = {
        **dict.fromkeys(("parameter_error", "patch_parameter_error", "total_parameter_error"), exact),
        "volume": plain["volume"] * factor.mean(),
        "sampling_error": sampling,
        "relative_error": np.hypot(sampling, exact),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(wear[name], values, rtol=1e-6, err_msg=name)
    assert wear["total_volume_of_draw"].shape == (64,)
    assert float(wear["total_volume_of_draw"].mean()) == pytest.approx(float(wear["total_volume"]))
    # More impacts know the mean better, but not the metal.
    few = erosion_map("linearized", P, sand(SURFACE, 100), SURFACE, uncertain=metal())
    assert float(few["total_sampling_error"] / wear["total_sampling_error"]) == pytest.approx(np.sqrt(10), rel=0.2)
    assert float(few["total_parameter_error"]) == pytest.approx(exact, rel=1e-6)
    for kind in ("by uncertain parameters", "by the sample of impacts"):
        assert f"of V and E: relative standard error {kind}" in " ".join(str(MapSummary(wear)).split())


def test_what_varies_from_impact_to_impact_averages_out() -> None:
    # Equal rows: (ΣwV)² has the relative variance E[V²]/(n E[V]²), and V goes with 1/σ.
    first = sand(SURFACE, 1)
    equal = first.only(np.zeros(20_000, int))
    law: dict[str, Any] = {"sigma": stats.lognorm(0.5, scale=float(P.sigma))}
    varied = erosion_map("linearized", P, equal, SURFACE, **law)
    assert "total_parameter_error" not in varied
    assert float(varied["total_relative_error"]) == pytest.approx(np.exp(0.5**2 / 2) / np.sqrt(20_000), rel=0.02)
    unknown = erosion_map("linearized", P, equal, SURFACE, uncertain=law)
    # 64 draws know the standard deviation of a lognormal law to some 15 %.
    assert float(unknown["total_parameter_error"]) == pytest.approx(np.sqrt(np.exp(0.5**2) - 1), rel=0.2)
    plain = erosion_map("linearized", P, equal, SURFACE)["total_volume"]
    assert float(varied["total_volume"] / plain) == pytest.approx(np.exp(0.5**2 / 2), rel=0.02)


@pytest.mark.parametrize("kind", ["of each impact", "of all"])
def test_a_joint_law_stays_together(plain: xr.Dataset, kind: str) -> None:
    # σψ is one number, so that nothing varies where the rows are kept, and 28 % where they are not.
    psi = float(P.psi) * np.exp(0.2 * np.random.default_rng(0).standard_normal(64))
    rows = JointSamples({"sigma": float(P.sigma * P.psi) / psi, "psi": psi})
    wear = erosion_map(
        "linearized", P, TABLE, SURFACE, **{"samples" if kind == "of each impact" else "uncertain": rows}
    )
    np.testing.assert_allclose(wear["volume"], plain["volume"], rtol=1e-6)
    np.testing.assert_allclose(wear["relative_error"], plain["relative_error"], rtol=1e-6)


def test_it_is_a_map_for_each_draw() -> None:
    # k turns wear from flat to steep faces: their errors differ, and that of the total is not their mean.
    laws: dict[str, Any] = {"k": stats.lognorm(0.3, scale=2.0), "psi": stats.lognorm(0.1, scale=float(P.psi))}
    joint = JointLaw(laws, {("k", "psi"): -0.8})
    wear = erosion_map("rotating", P, TABLE, SURFACE, uncertain=joint, draws=8, seed=3)
    drawn = MapOptions(P, uncertain=joint, draws=8, seed=3).common(erosion.load_model("rotating"))
    assert np.corrcoef(np.log(drawn["k"].ravel()), np.log(drawn["psi"].ravel()))[0, 1] < -0.4
    maps = [
        erosion_map("rotating", P.replace(k=k, psi=psi), TABLE, SURFACE)
        for k, psi in zip(drawn["k"].ravel(), drawn["psi"].ravel(), strict=True)
    ]
    volumes = np.array([part["volume"].values for part in maps])
    np.testing.assert_allclose(wear["volume"], volumes.mean(axis=0), rtol=1e-8)
    errors = volumes.std(axis=0, ddof=1) / volumes.mean(axis=0)
    np.testing.assert_allclose(wear["parameter_error"], errors, rtol=1e-6)
    totals = volumes.sum(axis=1)
    np.testing.assert_allclose(wear["total_volume_of_draw"], totals, rtol=1e-8)
    assert float(wear["total_parameter_error"]) == pytest.approx(totals.std(ddof=1) / totals.mean(), rel=1e-6)
    ends = np.mean([part["ends"].values for part in maps], axis=0)
    np.testing.assert_allclose(wear["ends"], ends, rtol=1e-12)


@pytest.mark.parametrize("block", [7, 100])
def test_the_bits_do_not_depend_on_the_blocks(monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    monkeypatch.setattr("erosion.cfd.erosion_map._PORTION", 16 * 64)
    options: dict[str, Any] = {
        "uncertain": metal(),
        "spin": stats.norm(0.0, 1e4),
        "draws": 16,
        "k": stats.uniform(1.5, 1.0),
    }
    whole = erosion_map("rotating", P, sand(SURFACE, 300), SURFACE, **options)
    assert whole.identical(erosion_map("rotating", P, sand(SURFACE, 300, block=block), SURFACE, **options))


def test_the_share_that_cuts_is_a_factor(plain: xr.Dataset) -> None:
    half = erosion_map("linearized", P, TABLE, SURFACE, cutting_fraction=0.5)
    share = np.linspace(0.3, 0.7, 64)
    unknown = erosion_map("linearized", P, TABLE, SURFACE, uncertain=JointSamples({"cutting_fraction": share}))
    for wear in (half, unknown):
        np.testing.assert_allclose(wear["volume"], 0.5 * plain["volume"], rtol=1e-9)
    np.testing.assert_allclose(half["relative_error"], plain["relative_error"], rtol=1e-12)
    assert float(unknown["total_parameter_error"]) == pytest.approx(np.std(share, ddof=1) / 0.5, rel=1e-6)


def test_a_models_own_parameter_may_be_uncertain() -> None:
    path = __file__.rsplit("/tests/", 1)[0] + "/models/coulomb_tip.py"
    wear = erosion_map(path, P, TABLE, SURFACE, uncertain={"friction": stats.norm(0.2, 0.05)}, draws=16)
    assert 0.001 < float(wear["total_parameter_error"]) < 0.5
    assert "uncertain friction = normal(0.2, 0.05), draws = 16, seed = 0" in wear.attrs["options"]


PAIR = JointSamples({"k": [1.0, 2.0], "psi": [0.05, 0.06]})
LAW = stats.lognorm(0.1, scale=1.0)
BAD: list[tuple[dict[str, Any], str]] = [
    ({"v0": LAW}, "`v0` must be left out: each row of the table has its own"),
    ({"uncertain": {"m": LAW}}, "`m` must be left out: each row of the table has its own"),
    ({"k": LAW, "uncertain": {"k": LAW}}, "must name parameters without another law, but k has one from impact"),
    ({"k": LAW, "samples": PAIR}, "`samples` must give k alone, but k has another law, too"),
    ({"uncertain": {"hardness": LAW}}, "`hardness` is not a parameter; they are k, psi, .*cutting_fraction"),
    ({"hardness": LAW}, "`hardness` is not a parameter; they are k, psi"),
    ({"cutting_fraction": 1.5}, "`cutting_fraction` must be above 0 and at most 1, but is 1.5"),
    ({"cutting_fraction": 0.5, "uncertain": {"cutting_fraction": LAW}}, "must be left out where it is uncertain"),
    ({"uncertain": {"cutting_fraction": LAW}}, "positive and at most 1, but 50.0%"),
    ({"spin": "case", "phidot0": LAW}, "`spin` must be left out where `phidot0` has a law"),
    ({"uncertain": {"k": 2.0}}, "`k` must be a law such as"),
    ({"uncertain": {"k": stats.norm(1.0, 1.0)}}, "`k` must be positive, but 15.9% of"),
    ({"uncertain": PAIR, "draws": 1}, "`draws` must be a whole number of at least 2"),
]


@pytest.mark.parametrize(("options", "sentence"), BAD)
def test_bad_laws_are_refused_before_anything_is_read(options: dict[str, Any], sentence: str) -> None:
    class Unread(Table):
        def blocks(self, rows: int) -> Any:
            raise AssertionError("the table was read")

    with pytest.raises((ValueError, TypeError), match=sentence):
        erosion_map("linearized", P, Unread(**TABLE.columns), SURFACE, **options)
