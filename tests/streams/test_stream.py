"""Streams: means with their errors against closed forms, and what is left when one is interrupted.

Streams whose own parameters vary: the same impacts as those of the equivalent case without friction.

Streams of particles whose parameters vary together, and the sensitivities of such inputs.

Points, estimates, and tallies: the numbers of all particles at once, whatever parts they come in.
"""

import dataclasses
import json
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
import xarray as xr
from scipy import stats

import erosion
from erosion import TABLE_1, StoreError, impact
from erosion.laws import JointLaw, JointSamples, RosinRammler, Samples
from erosion.models import ForceLaw, Linearized
from erosion.output.tables import to_json
from erosion.streams.stream import REPLICATES, StreamInterrupted, stream
from erosion.streams.tally import BIN_RATIO, Estimate, Particles, Points, Tally, sobol_indices
from tests.cli.test_set_option import FILE
from tests.models.test_own_parameters import MODEL, with_friction
from tests.reference import AT_20_DEGREES, best_angle, closed_form

SI = TABLE_1.to("si")

P = erosion.TABLE_1.to("si")
FEW: dict[str, Any] = {"best_angle": False, "sensitivities": False}
LAWS: dict[str, Any] = {"v0": stats.lognorm(0.1, scale=111.76), "alpha": stats.uniform(0.2, 0.2)}


def mean_volume_of_laws() -> float:
    """Of `LAWS`, by quadrature of the closed form: V ∝ v₀², of lognormal moment exp(2 s²)."""
    nodes, weights = np.polynomial.legendre.leggauss(30)
    volume = np.asarray(closed_form("linearized").volume(P.replace(alpha=0.3 + 0.1 * nodes)))
    return float(volume @ weights / 2 * np.exp(2 * 0.1**2))


def test_the_mean_and_its_error_are_right():
    result = stream("linearized", P, n=2**16, **FEW, **LAWS)
    assert result.n == 2**16
    exact = mean_volume_of_laws()
    assert result.mean_volume.value == pytest.approx(exact, rel=1e-4, abs=0)
    assert result.mean_volume.low < exact < result.mean_volume.high
    # Scrambled Sobol points: a hundred times nearer than random ones.
    assert result.mean_volume.error < 0.05 * result.deviation / np.sqrt(result.n)
    assert result.total_volume == pytest.approx(result.n * result.mean_volume.value, rel=1e-12, abs=0)
    assert result.erosion.value == pytest.approx(result.mean_volume.value / P.m, rel=1e-12, abs=0)
    assert result.shares["rebound"].value == 1


@pytest.mark.parametrize("points", ["sobol", "random"])
def test_intervals_cover_the_truth(points):
    means = [stream("linearized", P, n=1000, seed=seed, points=points, **FEW, **LAWS) for seed in (*range(40), 1)]
    covered = sum(jet.mean_volume.low < mean_volume_of_laws() < jet.mean_volume.high for jet in means[:40])
    # 95 % intervals: 38 of 40 expected; 33 or fewer have a probability of 0.3 %.
    assert covered >= 34
    # A seed is a stream.
    assert means[1].mean_volume == means[40].mean_volume != means[2].mean_volume
    assert means[0].n == 1008  # a multiple of 16


def test_scaled_particles_remove_in_proportion_to_their_mass():
    result = stream("linearized", P, n=2**16, **FEW, r=RosinRammler(0.04, 3, 0.02))
    single = erosion.impact("linearized", P).volume / P.m
    assert result.erosion.value == pytest.approx(single, rel=1e-9, abs=0)
    # Rotating too, as b goes with r: V/m does not depend on the size.
    particles = Particles(Linearized(), P, JointLaw({"r": stats.uniform(0.01, 0.07)}))
    _, p, _ = particles.impacts(particles.draw(np.array([[0.1], [0.9]])))
    np.testing.assert_allclose(p.rate * p.r, P.rate * P.r, rtol=1e-12)
    np.testing.assert_allclose(p.m / p.r**3, P.m / P.r**3, rtol=1e-12)


def test_steep_particles_come_from_the_other_side_and_flat_ones_miss():
    laws = JointLaw({"alpha": Samples([-0.1, 0.3, np.pi - 0.3, 3.2])})
    particles = Particles(Linearized(), P.replace(phidot0=100.0), laws)
    values = particles.draw(np.array([[0.1], [0.4], [0.6], [0.9]]))
    _, p, hits = particles.impacts(values)
    np.testing.assert_array_equal(hits, [False, True, True, False])
    np.testing.assert_allclose(p.alpha[1:3], [0.3, 0.3])
    np.testing.assert_allclose(p.phidot0[1:3], [100, -100])
    result = stream("linearized", P, n=1024, **FEW, alpha=stats.uniform(-0.1, 0.2))
    # The lower half misses: 0 is its middle.
    assert result.shares["miss"].value == pytest.approx(0.5, abs=1e-3)
    assert result.quantiles[0.25] == 0
    assert result.erosion.value == pytest.approx(result.mean_volume.value / P.m, rel=1e-12, abs=0)


def test_sensitivities_are_those_of_a_product():
    # V = a·v₀²·m: the indices of a product of independent factors are known.
    laws: dict[str, Any] = {"v0": stats.lognorm(0.1, scale=111.76), "m": stats.lognorm(0.3, scale=float(P.m))}
    result = stream("linearized", P, n=1024, best_angle=False, **laws)
    assert result.sensitivities is not None
    variances = {name: np.exp((power * s) ** 2) - 1 for name, power, s in (("v0", 2, 0.1), ("m", 1, 0.3))}
    whole = np.prod([1 + v for v in variances.values()]) - 1
    for name, (first, total) in result.sensitivities.items():
        other = next(v for key, v in variances.items() if key != name)
        assert abs(first.value - variances[name] / whole) < 5 * first.error + 1e-3
        assert abs(total.value - variances[name] * (1 + other) / whole) < 5 * total.error + 1e-3


def test_an_interrupted_stream_is_readable_and_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("erosion.streams.stream._BLOCK", 2**8)
    whole = stream("linearized", P, n=3 * 2**12, **FEW, **LAWS)
    path = tmp_path / "jet.nc"

    def stop(what: str, done: int, total: int) -> None:
        if done == 2**13:
            raise KeyboardInterrupt

    with pytest.raises(StreamInterrupted, match=r"8,192 of 12,288.*jet\.nc") as caught:
        stream("linearized", P, n=3 * 2**12, store=path, progress=stop, **FEW, **LAWS)
    assert caught.value.partial is not None
    assert caught.value.partial.n == 2**13
    partial = xr.load_dataset(path, engine="h5netcdf")
    assert float(partial.mean_volume) == caught.value.partial.mean_volume.value
    result = stream("linearized", P, n=3 * 2**12, store=path, **FEW, **LAWS)
    for name in ("counted", "mean", "squares", "mass", "ends", "bins"):
        np.testing.assert_array_equal(getattr(result.tally, name), getattr(whole.tally, name))


def test_the_best_angle_of_a_narrow_stream_is_the_particles():
    # The linearized model's α_max depends on k alone: neither speeds nor masses move it.
    result = stream("linearized", P, n=64, sensitivities=False, v0=stats.lognorm(0.3, scale=111.76))
    assert result.nozzle is not None
    exact = best_angle(2.0)
    # The search ends within 1e-5 rad; V is flat there, known to 1e-9: √1e-9 = 3e-5.
    assert result.nozzle.alpha.value == pytest.approx(exact, abs=1e-4)
    assert result.nozzle.single_alpha == pytest.approx(exact, rel=1e-9, abs=0)
    assert not result.nozzle.at_edge
    assert result.nozzle.curve.argmax() == np.abs(result.nozzle.angles - exact).argmin()
    dataset, numbers = result.to_dataset(), result.to_dict()
    assert float(dataset.alpha_max) == numbers["alpha_max"] == result.nozzle.alpha.value
    assert float(dataset.quantiles.sel(quantile=0.05)) == numbers["quantiles"]["0.05"] == result.quantiles[0.05]
    assert dataset.alpha_max_interval.dims == ("alpha_max_interval_0",)
    assert numbers["model"] == "linearized"
    assert numbers["parameters"]["v0"] == pytest.approx(111.76)
    assert numbers["units"]["alpha_max"] == "rad"
    assert json.loads(to_json(numbers)) == numbers


def test_spread_of_the_angle_moves_the_best_angle():
    """V(α) falls more slowly than it rises: a wide jet is best aimed steeper than a particle."""
    spread = 0.2
    found = stream("linearized", P, n=64, sensitivities=False, alpha=stats.norm(0.35, spread))
    # By Gauss-Hermite quadrature of the closed form, with misses and reflections.
    nodes, weights = np.polynomial.hermite_e.hermegauss(200)
    angles = np.linspace(0.4, 0.8, 4001)
    each = angles[:, None] + spread * nodes
    folded = np.where(each > np.pi / 2, np.pi - each, each)
    volume = np.where(
        folded > 0, np.asarray(closed_form("linearized").volume(P.replace(alpha=np.abs(folded) + 1e-12))), 0
    )
    best = angles[(volume @ weights).argmax()]
    assert found.nozzle is not None
    assert found.nozzle.alpha.value == pytest.approx(best, abs=3e-3)
    assert found.nozzle.alpha.low - 1e-3 < best < found.nozzle.alpha.high + 1e-3
    assert best > best_angle(2.0) + 0.01


SIGMA: dict[str, Any] = {"sigma": stats.lognorm(0.3, scale=1.379e9)}


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({}, ValueError, "must include a law"),
        ({"v0": 3.0}, TypeError, "`v0` must be a law"),
        ({"v0": stats.norm(3.0, 1.5)}, ValueError, r"`v0` must be positive, but 2\.3% of"),
        ({"samples": {"v0": [-1.0, 4000.0]}}, ValueError, "`v0` must be positive"),
        ({"speed": stats.norm(1, 1)}, TypeError, "`speed` is not a parameter"),
        ({**LAWS, "n": 0}, ValueError, "`n` must be a whole number of at least 1"),
        ({**LAWS, "points": "halton"}, ValueError, "`points` must be"),
        ({**LAWS, "store": "out.csv"}, ValueError, r"must end in \.nc"),
        ({**LAWS, "store": "/nowhere/out.nc"}, OSError, "No such file or directory: '/nowhere/out.nc'"),
        ({**SIGMA, "uncertain": SIGMA}, ValueError, "`uncertain` must name parameters without another law, but sigma"),
        ({**SIGMA, "samples": {"sigma": [1e5, 2e5]}}, ValueError, "`samples` must give sigma alone, but sigma has an"),
    ],
)
def test_bad_arguments_are_one_sentence(arguments, error, message):
    with pytest.raises(error, match=message):
        stream("linearized", P, **arguments)


FRICTION_LAWS: dict[str, Any] = {"friction": stats.uniform(0.1, 0.2), "v0": stats.lognorm(0.1, scale=111.76)}


@pytest.mark.parametrize("points", ["sobol", "random"])
def test_a_law_of_friction_is_laws_of_flow_stress_and_force_ratio(points):
    result = stream(MODEL, P, n=2**10, seed=3, points=points, **FEW, **FRICTION_LAWS)
    particles = Particles(MODEL, P, JointLaw(FRICTION_LAWS))
    drawn = particles.draw(Points(points, 2, 3, REPLICATES).take(2**10 // REPLICATES))
    assert drawn["friction"].shape == (REPLICATES, 64)
    equivalent = with_friction(drawn["friction"], P.replace(v0=drawn["v0"]))
    volume = erosion.impact("linearized", equivalent).volume
    np.testing.assert_allclose(result.tally.mean, volume.mean(axis=1), rtol=1e-8)  # the engine's tolerance is 1e-9
    assert result.quantiles[0.5] == pytest.approx(np.median(volume), rel=3e-3)


def test_the_mean_and_the_best_angle_are_those_of_the_closed_form():
    result = stream(MODEL, P, n=2**16, **FEW, **FRICTION_LAWS)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    volume = np.asarray(closed_form("linearized").volume(with_friction(0.2 + 0.1 * nodes)))
    # V ∝ v₀², of lognormal moment exp(2 s²).
    exact = float(volume @ weights / 2 * np.exp(2 * 0.1**2))
    assert result.mean_volume.value == pytest.approx(exact, rel=1e-4)
    assert result.mean_volume.low < exact < result.mean_volume.high
    nozzle = stream(MODEL, P, n=64, sensitivities=False, friction=stats.norm(0.2, 1e-6)).nozzle
    assert nozzle is not None
    best = best_angle(2.0 / 1.4)  # ½ arctan k at k/(1 + μk)
    assert (nozzle.alpha.value, nozzle.single_alpha) == (pytest.approx(best, abs=1e-4), pytest.approx(best, abs=1e-9))


class Undeclared(ForceLaw):
    factor: jax.Array = eqx.field(default=1.0)  # pyrefly: ignore

    def __call__(self, state, tip, p):
        horizontal = -p.stiffness * tip.depth * self.factor
        return horizontal, p.k * horizontal

    def typical_ratio(self, p):
        return p.k


BARE = Linearized(force=Undeclared())
DATA = {"angle [deg]": [20.0, 30.0, 40.0], "volume [m^3/impact]": [1e-9] * 3}
ONE_NUMBER = r"`factor` must be one number, .*`erosion\.own_parameter`, or as `float`"
CANNOT_VARY = [
    (lambda: stream(BARE, P, factor=stats.norm(1.0, 0.1)), TypeError, ONE_NUMBER),
    (lambda: erosion.sweep(BARE, P, factor=[1.0, 2.0]), TypeError, ONE_NUMBER),
    (lambda: erosion.calibrate(erosion.FitProblem(BARE, P, DATA, free=["factor"])), TypeError, ONE_NUMBER),
    (
        lambda: stream(MODEL, P, fricton=stats.norm(0.2, 0.1)),
        TypeError,
        r"`fricton` is not a parameter; they are .*, friction\.",
    ),
    (
        lambda: stream(MODEL.replace(friction=np.array([0.1, 0.2])), P, v0=stats.norm(112, 1)),
        ValueError,
        r"`friction` must be a scalar here, but has shape \(2,\)",
    ),
]


@pytest.mark.parametrize(("call", "error", "message"), CANNOT_VARY)
def test_what_cannot_vary_is_one_sentence(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_a_stream_that_removes_nothing_is_no_error(shell):
    words = ["--phidot0", "-2.2e5 rad/s", "--v0", "normal(100 m/s, 1 m/s)", "--units", "si"]
    result = shell(["stream", "--model", "rotating", *words, "--n", "64", "--no-best-angle", "--json"]).result
    assert result["mean_volume"] == result["deviation"] == 0


def test_the_command_line_takes_laws_of_own_parameters(tmp_path, written, monkeypatch, shell):
    monkeypatch.chdir(tmp_path)
    written("harder.py", FILE)
    case = '\n[stream]\nmodel = "harder.py"\nn = 1024\nset.factor = "uniform(2, 3)"\n'
    written("case.toml", erosion.dump_case(P) + case)
    words = ["stream", "case.toml", "--no-best-angle", "-o", "jet.nc", "--json", "--set"]
    printed = shell([*words, "speed=normal(5 m/s, 1 m/s)"])
    # V ∝ 1/σ, and the mean of 1/f is ln 1.5; 1024 points are worth four digits.
    single = AT_20_DEGREES["linearized"].volume * 0.0254**3
    assert printed.result["mean_volume"] == pytest.approx(single * np.log(1.5), rel=1e-4)
    assert printed.document["model"] == {"name": "harder.py", "own_parameters": {}}
    assert set(printed.result["sensitivities"]) == {"factor", "speed"}
    stored = xr.load_dataset("jet.nc")
    assert stored.attrs["laws"] == "factor: uniform(2, 3); speed: normal(5 m/s, 1 m/s)"
    for own, message in (
        ("speed=normal(5 m/s, 2 m/s)", "holds another result (of another laws)"),
        ("factor=2", "must have a law of a parameter, an option such as"),
        ("speed=normal(5 kg, 2 m/s)", "Option `--set speed` must be a speed"),
    ):
        assert message in shell([*words, own], 2).err
    written("factors.csv", "factor\n2\n4\n")
    rows = shell("stream case.toml --n 64 --no-best-angle --set 'factor=samples(factors.csv)' --json").result
    assert rows["mean_volume"] == pytest.approx(single * 3 / 8, rel=1e-8)


def test_rows_give_the_mean_over_the_table():
    rng = np.random.default_rng(0)
    angle = rng.uniform(0.2, 1.0, 64)
    speed = 4400 * (1 + angle)
    result = stream("linearized", P, n=2**12, **FEW, samples={"alpha": angle, "v0": speed})
    exact = impact("linearized", SI.replace(alpha=angle, v0=speed)).volume.mean()
    # 64 rows, and powers of 2 of Sobol points: each row comes equally often.
    assert result.mean_volume.value == pytest.approx(exact, rel=1e-9)
    apart = stream("linearized", P, n=2**12, **FEW, alpha=stats.uniform(0.2, 0.8), v0=stats.uniform(134, 90))
    assert abs(apart.mean_volume.value / exact - 1) > 0.005
    assert result.to_dict()["mean_volume"] == result.mean_volume.value


def test_correlated_speed_and_size_remove_more():
    laws: dict[str, Any] = {"v0": stats.lognorm(0.2, scale=111.76), "r": stats.lognorm(0.2, scale=0.04)}
    together = stream("linearized", P, n=2**13, **FEW, **laws, correlation={("v0", "r"): 0.8})
    apart = stream("linearized", P, n=2**13, **FEW, **laws)
    # V goes with m v0² and m with r³: the logarithms add, and their covariance is 0.8·0.2².
    ratio = together.mean_volume.value / apart.mean_volume.value
    assert ratio == pytest.approx(np.exp(2 * 3 * 0.8 * 0.2**2), rel=0.01)


def test_a_joint_law_is_one_input_of_the_sensitivities():
    laws: dict[str, Any] = {"v0": stats.lognorm(0.05, scale=111.76), "m": stats.lognorm(0.1, scale=float(SI.m))}
    options: dict[str, Any] = {"n": 2**12, "best_angle": False, "correlation": {("v0", "m"): -0.5}, **laws}
    result = stream("linearized", P, sigma=stats.lognorm(0.1, scale=1.379e9), **options)
    assert result.sensitivities is not None
    # log V = log m + 2 log v0 - log σ: variances 0.01 and 0.01 + 4·0.0025 - 4·0.5·0.1·0.05 = 0.01.
    first = {name: estimate.value for name, (estimate, _) in result.sensitivities.items()}
    assert first == {"sigma": pytest.approx(0.5, abs=0.02), "v0, m": pytest.approx(0.5, abs=0.02)}
    assert [row[1] for row in result.tables()[1].rows] == ["σ", "v₀, m"]
    assert stream("linearized", P, **options).sensitivities is None


TIED: dict[str, Any] = {"v0": stats.norm(112.0, 1.0), "r": stats.norm(1e-3, 2.5e-5)}
METAL: dict[str, Any] = {"sigma": stats.lognorm(0.1, scale=1.379e9), "psi": stats.lognorm(0.1, scale=0.05)}
TABLES = [{"alpha": np.linspace(0.2, 0.6, 8), "v0": np.linspace(100.0, 125.0, 8)[::way]} for way in (1, -1)]


@pytest.mark.parametrize(
    ("model", "laws", "changed"),
    [
        (MODEL, FRICTION_LAWS, {**FRICTION_LAWS, "friction": stats.uniform(0.1, 0.3)}),
        ("linearized", *({"samples": table} for table in TABLES)),
        ("linearized", *({**TIED, "correlation": {("v0", "r"): rho}} for rho in (-0.5, -0.4))),
        ("linearized", LAWS | {"uncertain": METAL}, LAWS | METAL),
    ],
    ids=["own parameter", "rows", "correlated", "uncertain"],
)
def test_the_laws_are_part_of_a_stores_identity(tmp_path, model, laws, changed):
    path, whole = tmp_path / "jet.nc", stream(model, P, n=2**10, **FEW, **laws)
    stream(model, P, n=2**9, store=path, **FEW, **laws)
    result = stream(model, P, n=2**10, store=path, **FEW, **laws)
    np.testing.assert_allclose(result.tally.mean, whole.tally.mean, rtol=1e-14)
    # Of what varies, the model's own value means nothing.
    assert "own_parameters" not in xr.load_dataset(path, engine="h5netcdf").attrs
    with pytest.raises(StoreError, match="laws"):
        stream(model, P, n=2**10, store=path, **FEW, **changed)


def test_sobols_indices_are_those_of_ishigami():
    # sin x + 7 sin² y + 0.1 z⁴ sin x on (-π, π)³: Saltelli et al., Sensitivity analysis in practice (2004).
    def ishigami(points: np.ndarray) -> np.ndarray:
        x, y, z = (2 * points.T - 1) * np.pi
        return np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)

    first, total = sobol_indices(ishigami, [1, 1, 1], 2**13, np.random.default_rng(0))
    np.testing.assert_allclose(first, [0.3139, 0.4424, 0.0], atol=0.01)
    np.testing.assert_allclose(total, [0.5576, 0.4424, 0.2437], atol=0.01)
    # The first and the third together cause all that the second does not.
    first, total = sobol_indices(lambda points: ishigami(points[:, [0, 2, 1]]), [2, 1], 2**13, np.random.default_rng(0))
    np.testing.assert_allclose(first, [0.5576, 0.4424], atol=0.01)
    np.testing.assert_allclose(total, [0.5576, 0.4424], atol=0.01)


def test_normal_laws_of_a_joint_law_are_cut_off_at_zero():
    laws: dict[str, Any] = {"v0": stats.norm(112.0, 47.0), "r": stats.norm(1e-3, 2.5e-5)}
    result = stream("linearized", P, n=2**12, **FEW, **laws, correlation={("v0", "r"): 0.5})
    assert set(result.shares) <= {"rebound", "stop"}


def test_what_is_uncertain_does_not_average_out():
    # V of the linearized cut goes with 1/σψ: all means scale alike with it, whatever the particles are.
    rng = np.random.default_rng(3)
    sigma, psi = 2e5 * np.exp(0.2 * rng.standard_normal(500)), 0.05 * np.exp(0.1 * rng.standard_normal(500))
    particles: dict[str, Any] = {"v0": stats.lognorm(0.2, scale=111.76), "r": stats.norm(0.04, 0.002)}
    metal = JointSamples({"sigma": sigma, "psi": psi})
    few, many = (stream("linearized", P, n=n, **FEW, **particles, uncertain=metal) for n in (2**8, 2**15))
    exact = np.std(1 / (sigma * psi)) / np.mean(1 / (sigma * psi))
    for jet in (few, many):
        assert jet.uncertainty is not None
        assert len(jet.uncertainty.volume) == 256
        errors = jet.parameter_errors
        # 256 draws know a standard deviation to 4 %; Sobol's points are better than random ones.
        assert errors["erosion"] / jet.erosion.value == pytest.approx(exact, rel=0.1)
        assert errors["mean_volume"] / jet.mean_volume.value == pytest.approx(exact, rel=0.1)
    assert many.mean_volume.error < few.mean_volume.error / 5
    ratio = many.mean_volume.value / stream("linearized", P, n=2**15, **FEW, **particles).mean_volume.value
    mean = np.mean(1 / (sigma * psi)) * float(SI.sigma * SI.psi)
    assert ratio == pytest.approx(mean, rel=0.005)
    assert many.to_dict()["mean_volume_parameter_error"] == many.parameter_errors["mean_volume"]


def test_uncertain_parameters_are_inputs_of_the_sensitivities():
    metal = JointLaw(
        {"sigma": stats.lognorm(0.1, scale=1.379e9), "psi": stats.lognorm(0.1, scale=0.05)}, {("sigma", "psi"): -0.9}
    )
    options: dict[str, Any] = {"n": 2**12, "best_angle": False, "v0": stats.lognorm(0.05, scale=111.76)}
    jet = stream("linearized", P, **options, uncertain=metal)
    assert jet.sensitivities is not None
    # log V = 2 log v0 - log σψ: variances 4·0.0025 and 0.01 + 0.01 - 2·0.9·0.01 = 0.002.
    assert jet.sensitivities["sigma, psi"][0].value == pytest.approx(1 / 6, abs=0.02)


SCALE = 1e-4
ENDS = ("stop", "no-cut", "failed")


def particles() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Volumes, masses and ends of two replicates: lognormal, some zero, some unknown."""
    generator = np.random.default_rng(5)
    volume = np.exp(generator.normal(-9, 1, (2, 3000)))
    volume[:, :30], volume[:, 30:40] = 0.0, np.nan
    ends = np.where(np.isnan(volume), "failed", np.where(volume == 0, "no-cut", "stop"))
    return volume, generator.uniform(1, 2, (2, 3000)), ends


VOLUME, MASS, ENDED_BY = particles()
KNOWN = VOLUME[np.isfinite(VOLUME)]


def tally_of(part: slice) -> Tally:
    return Tally.of(VOLUME[:, part], MASS[:, part], ENDED_BY[:, part], ENDS, SCALE, {"twice": 2 * VOLUME[:, part]})


def alone(volume: np.ndarray) -> Tally:
    return Tally.of(volume, np.ones(volume.shape), np.full(volume.shape, "stop"), ENDS, 1.0)


@pytest.fixture(scope="module")
def whole() -> Tally:
    return tally_of(slice(None))


def test_a_tally_counts_and_adds(whole: Tally) -> None:
    assert whole.drawn == 3000
    np.testing.assert_array_equal(whole.counted, [2990, 2990])
    np.testing.assert_array_equal(whole.ends, [[2960, 30, 10]] * 2)
    np.testing.assert_allclose(whole.mean, np.nanmean(VOLUME, axis=1), rtol=1e-13)
    np.testing.assert_allclose(whole.squares, 2990 * np.nanvar(VOLUME, axis=1), rtol=1e-12)
    # Of particles whose volume is known.
    np.testing.assert_allclose(whole.mass, MASS[:, :30].sum(axis=1) + MASS[:, 40:].sum(axis=1), rtol=1e-13)
    assert whole.deviation == pytest.approx(KNOWN.std(), rel=1e-12)


@pytest.mark.parametrize("cuts", [(35, 1000), (1, 2), (32, 38)])
def test_parts_add_up_to_the_whole(whole: Tally, cuts: tuple[int, int]) -> None:
    """Also where in one part all volumes are zero or unknown."""
    first, second = cuts
    parts = tally_of(slice(0, first)) + tally_of(slice(first, second)) + tally_of(slice(second, None))
    for name in ("drawn", "counted", "ends", "bins"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    for name in ("mean", "squares", "mass"):
        np.testing.assert_allclose(getattr(parts, name), getattr(whole, name), rtol=1e-12)


def test_squares_keep_their_digits_far_from_zero() -> None:
    """Volumes of 1 that differ by 1e-9: sums of squares alone would lose all of the deviation."""
    one, other = map(alone, np.split(1 + 1e-9 * np.arange(4.0).reshape(1, 4), 2, 1))
    assert (one + other).deviation == pytest.approx(1e-9 * np.sqrt(1.25), rel=1e-6)


def test_quantiles_are_those_of_the_volumes_to_half_a_bin(whole: Tally) -> None:
    shares = [0.05, 0.5, 0.95]
    exact = np.quantile(KNOWN, shares, method="inverted_cdf")
    given = [whole.quantile(share) for share in shares]
    assert np.abs(np.log(given / exact)).max() <= np.log(BIN_RATIO) / 2 * (1 + 1e-9)
    # Those that remove nothing are the lowest.
    assert whole.quantile(0.99 * 30 / 2990) == 0 < whole.quantile(1.01 * 30 / 2990)
    for volume, quantile in ((1e-40, 1e-24), (1e40, 1e6)):  # beyond the histogram they are in its last bins
        assert alone(np.full((1, 5), volume)).quantile(0.5) == pytest.approx(quantile, rel=BIN_RATIO - 1)


def test_a_histogram_shares_out_the_middle(whole: Tally) -> None:
    edges, shares = whole.histogram(bins=20)
    assert 10 <= len(shares) <= 20
    assert len(edges) == len(shares) + 1
    ratios = edges[1:] / edges[:-1]
    np.testing.assert_allclose(ratios, ratios[0])
    # An edge of the histogram is one of the fine bins', so that each particle is on its own side.
    counts, _ = np.histogram(KNOWN, edges)
    np.testing.assert_allclose(shares, counts / KNOWN.size, atol=1e-12)
    assert shares.sum() == pytest.approx(0.998 * 2960 / 2990, abs=2e-3)


def test_a_dataset_holds_all_of_a_tally(whole: Tally) -> None:
    again = Tally.from_dataset(whole.to_dataset(), own=["twice"])
    one, other = (jax.tree.leaves(dataclasses.asdict(tally)) for tally in (whole, again))
    assert len(one) == 10
    assert [np.asarray(part).tobytes() for part in one] == [np.asarray(part).tobytes() for part in other]


@pytest.mark.parametrize("kind", ["sobol", "random"])
def test_points_are_those_of_a_seed_and_go_on_where_they_stopped(kind: str) -> None:
    whole, again, other = (Points(kind, 3, seed, 2).take(64) for seed in (7, 7, 8))
    np.testing.assert_array_equal(whole, again)
    np.testing.assert_array_equal(Points(kind, 3, 7, 2, skip=16).take(16), whole[:, 16:32])
    assert ((whole > 0) & (whole < 1)).all()
    assert not (whole == other).any()
    assert not (whole[0] == whole[1]).any()
    # 2ⁿ points of Sobol: one in each interval of 2⁻ⁿ, along every axis.
    evenly = [(np.sort((axis * 64).astype(int)) == np.arange(64)).all() for sequence in whole for axis in sequence.T]
    assert all(evenly) == any(evenly) == (kind == "sobol")


def test_an_estimate_is_students() -> None:
    mean, moved = (Estimate.of(np.array([1.0, 2.0, 3.0, 4.0]), value) for value in (None, 7.0))
    assert (mean.value, mean.error) == (2.5, pytest.approx(np.sqrt(5 / 3) / 2))
    # t of three degrees of freedom, 97.5 %.
    assert (mean.low, mean.high) == pytest.approx((2.5 - 3.182446 * mean.error, 2.5 + 3.182446 * mean.error), rel=1e-6)
    # A value of its own moves the interval, not the error.
    assert (moved.value, moved.error, moved.high) == (7, mean.error, pytest.approx(7 + mean.high - 2.5))


def test_inputs_of_one_number_have_scipys_indices():
    def function(points: np.ndarray) -> np.ndarray:
        return points[:, 0] + points[:, 1] ** 2 + points[:, 0] * points[:, 2]

    first, total = sobol_indices(function, [1, 1, 1], 2**11, np.random.default_rng(1))
    uniform = [stats.uniform(2.0**-31, 1 - 2.0**-30)] * 3
    known = stats.sobol_indices(func=lambda x: function(x.T), n=2**11, dists=uniform, rng=np.random.default_rng(1))
    np.testing.assert_allclose(first, known.first_order, atol=0.02)
    np.testing.assert_allclose(total, known.total_order, atol=0.02)
