"""A correlation as a model: the engine's volumes, derivatives and best angles are the correlation's."""

from typing import Any

import jax
import numpy as np
import pytest
from scipy import stats

import erosion
from erosion.correlations import FinnieMaterial
from erosion.models import Correlated, correlated, made_for, model_name, own_parameters
from erosion.models.correlated import CorrelatedByFlowStress, per_mass_of
from erosion.models.equations import error_in
from erosion.parameters.materials import known_targets
from erosion.results import from_attribute
from tests.documents import findings

P = erosion.TABLE_1
SI = P.to("si")
SIZE = (6 * float(SI.m) / 2650 / np.pi) ** (1 / 3)


def expected(name, alpha, material=None):
    """E m/ρ [m³] by the correlation's own function."""
    correlation = erosion.CORRELATIONS[name]
    factors = {} if material is None else {"material": material}
    if name == "oka":
        factors["diameter"] = SIZE
    density = correlation.density if material is None else correlation.materials[material].density
    return correlation.erosion(alpha, float(SI.v0), **factors) * float(SI.m) / density


@pytest.mark.parametrize("name", erosion.CORRELATIONS)
def test_volume_and_derivatives_are_the_correlations(name):
    model, alpha = erosion.load_model(name), float(P.alpha)
    assert error_in(model) is None
    assert model_name(model) == name
    hit = erosion.impact(model, SI, derivatives=2)
    slope = jax.grad(lambda a: expected(name, a))
    first, second = jax.jit(jax.value_and_grad(slope))(alpha)
    assert hit.volume == pytest.approx(float(expected(name, alpha)), rel=1e-12, abs=0)
    assert hit.dvolume == pytest.approx(float(first), rel=1e-11, abs=0)
    assert hit.d2volume == pytest.approx(float(second), rel=1e-10, abs=0)
    assert (hit.ended_by, hit.t_c) == ("no-cut", 0)


@pytest.mark.parametrize("name", ["dnv", "ecrc", "oka"])
def test_the_best_angle_is_the_correlations(name):
    best = erosion.alpha_max(name, P)
    assert best.alpha == pytest.approx(erosion.CORRELATIONS[name].alpha_max, abs=1e-10)
    assert best.certified


def test_the_target_follows_the_colon():
    model = erosion.load_model("dnv:aluminium")
    assert model_name(model) == "dnv:aluminium"
    assert model == correlated("dnv", "aluminium")
    volume = erosion.impact(model, SI).volume
    assert volume == pytest.approx(float(expected("dnv", float(P.alpha), "aluminium")), rel=1e-12, abs=0)
    denser = erosion.impact(model.replace(density=np.array([2700.0, 5400.0])), SI).volume
    assert denser == pytest.approx([volume, volume / 2], rel=1e-12, abs=0)


def test_oka_takes_the_size_of_a_sphere_of_the_cases_mass():
    model = erosion.load_model("oka")
    light = erosion.impact(model.replace(particle_density=2650 / 8), SI).volume
    assert light == pytest.approx(erosion.impact(model, SI).volume * 2**0.19, rel=1e-12, abs=0)


def test_it_stands_beside_models_in_comparisons_sweeps_and_streams():
    curves = erosion.compare(["rotating", "dnv"], P, alpha=np.deg2rad([20.0, 40.0]))
    assert curves.volume.sel(model="dnv").values == pytest.approx(
        [float(expected("dnv", np.deg2rad(angle))) for angle in (20.0, 40.0)], rel=1e-11
    )
    speeds = erosion.sweep("ecrc", SI, v0=[50.0, 100.0]).volume.values
    assert speeds[1] / speeds[0] == pytest.approx(2**2.41, rel=1e-11, abs=0)
    jet = erosion.stream("dnv", SI, alpha=stats.uniform(0.3, 0.1), n=1024, seed=1)
    angles = np.linspace(0.3, 0.4, 401)
    mean = np.trapezoid(np.asarray(expected("dnv", angles)), angles) / 0.1
    assert jet.mean_volume.value == pytest.approx(mean, rel=1e-4, abs=0)


def test_a_share_of_impacts_outside_of_the_range_is_a_warning(shell, tmp_path):
    with pytest.warns(erosion.correlations.OutOfRangeWarning, match=r"^40 %.*\bdnv\b.*\b200 m/s") as warned:
        grid = erosion.sweep("dnv", SI, v0=[100.0, 150.0, 200.0, 201.0, 300.0], alpha=[0.2, 0.4])
    said = str(warned[0].message)
    assert [finding.text for finding in from_attribute(grid.attrs["findings"])] == [said]
    # Within it nothing is said, and nothing of other models.
    assert "findings" not in erosion.sweep("dnv", SI, v0=[100.0, 150.0]).attrs
    assert "findings" not in erosion.sweep("linearized", SI, v0=[300.0, 400.0]).attrs
    with pytest.warns(erosion.correlations.OutOfRangeWarning) as warned:
        erosion.compare(["rotating", "dnv", "oka", "ecrc"], SI.replace(v0=SI.v0 * 2.0), alpha=[0.3, 0.6])
    assert [str(warning.message).partition(" ")[0] for warning in warned] == ["dnv", "oka"]
    # Particles that miss are not counted: every second one, whatever its speed.
    laws: dict[str, Any] = {
        "v0": stats.uniform(150.0, 200.0),
        "alpha": stats.uniform(-0.5, 1.0),
    }
    with pytest.warns(erosion.correlations.OutOfRangeWarning, match=r"^75 %.*\bdnv\b"):
        jet = erosion.stream("dnv", SI, **laws, n=256, best_angle=False, sensitivities=False)
    assert len(jet.warnings) == 1
    assert erosion.stream("linearized", SI, **laws, n=256, best_angle=False, sensitivities=False).warnings == ()
    with pytest.warns(erosion.correlations.OutOfRangeWarning, match=r"dnv.*200 m/s"):
        followed = erosion.simulate("dnv", SI.replace(v0=250.0))
    assert len(followed.warnings) == 1
    # A batch of impacts is what other verbs are made of: they warn.
    assert erosion.impact("dnv", SI.replace(v0=250.0)).volume_at_contact > 0
    words = ["sweep", "--model", "dnv", "--v0", "100m/s:300m/s:5", "-o", str(tmp_path / "fast.nc"), "--json"]
    assert [one["text"] for one in findings(shell(words).document)] == [said]


def decided(model: str, target: str) -> Correlated | str:
    """The correlation that is made for the target, or why there is none."""
    try:
        made = made_for(erosion.load_model(model), target)
    except ValueError as error:
        return str(error)
    assert isinstance(made, Correlated)
    return made


@pytest.mark.parametrize("target", known_targets())
@pytest.mark.parametrize("family", erosion.CORRELATIONS)
def test_every_family_has_a_member_for_a_target_or_takes_its_constants_or_refuses_it(family, target):
    metal, made = erosion.target(target), decided(family, target)
    standard = "dnv" if family == "dnv-polynomial" else family
    listed = [name.partition(":")[2] for name in metal.correlations if name.partition(":")[0] == standard]
    if family == "finnie-cfd":
        assert isinstance(made, CorrelatedByFlowStress)
        assert (made.flow_stress, made.density) == (metal.hardness, metal.density)
    elif listed:
        assert isinstance(made, Correlated)
        assert made.label == (f"{family}:{listed[0]}" if listed[0] else family)
        assert decided(made.label, target) == made
    else:
        assert isinstance(made, str)
        assert all(name in made for name in (f"'{family}'", target, *erosion.CORRELATIONS[family].materials))
    # A member that is named beside another metal is a contradiction.
    for material in erosion.CORRELATIONS[family].materials:
        made = decided(f"{family}:{material}", target)
        assert isinstance(made, Correlated) == (material in listed)
        assert material not in listed or made == correlated(family, material)


def test_finnies_form_takes_the_constants_of_the_target():
    metal = erosion.target("titanium Ti-6Al-4V")
    made = made_for(erosion.load_model("finnie-cfd"), metal)
    hit = erosion.impact(made, SI.replace(alpha=0.3))
    own = FinnieMaterial(metal.flow_stress, float(metal.density or 0), 0.1)
    ratio = float(erosion.correlations.finnie(0.3, float(SI.v0), own))
    assert float(hit.volume) == pytest.approx(ratio * float(SI.m) / own.density, rel=1e-9, abs=0)
    assert per_mass_of(made, erosion.PerMass()).erosion_ratio(hit.volume, SI) == pytest.approx(ratio, rel=1e-9, abs=0)


def test_a_named_particle_has_its_density():
    oka = made_for(erosion.load_model("oka"), "aluminium 6061", "garnet 0.3 mm")
    p = SI.with_particle("garnet 0.3 mm")
    volume = erosion.correlations.oka(
        float(p.alpha), float(p.v0), 3e-4, material="aluminium", units="mm3/impact", mass=float(p.m)
    )
    assert float(erosion.impact(oka, p).volume) == pytest.approx(float(volume) * 1e-9, rel=1e-9, abs=0)


@pytest.mark.parametrize(
    ("particle", "shape"), [("garnet", "sharp"), ("quartz sand", "sharp"), ("steel shot", "rounded")]
)
@pytest.mark.parametrize("family", ["ecrc", "mclaury", "arabnejad"])
def test_a_named_particle_has_the_factor_of_its_shape(family, particle, shape):
    formula: Any = getattr(erosion.correlations, family)
    p = SI.with_particle(f"{particle} 0.3 mm").replace(alpha=0.5, v0=160.0)
    for target, material in (
        (None, {}),
        ("mild steel", {"material": "carbon-steel-1018"} if family == "arabnejad" else {}),
    ):
        made = made_for(erosion.load_model(family), target, f"{particle} 0.3 mm")
        ratio = per_mass_of(made, erosion.PerMass()).erosion_ratio(erosion.impact(made, p).volume, p)
        assert ratio == pytest.approx(float(formula(0.5, 160.0, sharpness=shape, **material)), rel=1e-9, abs=0)
    # A factor that is set stays, also the usual one, for other targets too.
    for factor in (0.53, 0.4):
        of_hand = made_for(erosion.load_model(family).replace(sharpness=factor), "mild steel", f"{particle} 0.3 mm")
        assert own_parameters(of_hand)["sharpness"].value == factor


def test_a_table_of_ones_own_names_the_correlations_of_its_targets(written):
    table = written("mine.toml", '[targets.mine]\nvickers = 200\ndensity = 7800\ncorrelations = ["dnv:duplex"]')
    made = decided("dnv", f"{table}: mine")
    assert isinstance(made, Correlated)
    assert made.label == "dnv:duplex"
    table.write_text('[targets.mine]\nvickers = 200\ncorrelations = ["dnv:duplx"]')
    assert "field `correlations` must name correlations, but has 'dnv:duplx'" in str(decided("dnv", f"{table}: mine"))
    assert "needs the density of mine" in str(decided("finnie-cfd", f"{table}: mine"))


def test_the_density_of_another_metal_is_refused():
    with pytest.raises(
        ValueError, match="Argument `density` must be that of the target of dnv, 7800 kg/m³, but is 2700"
    ):
        per_mass_of(erosion.load_model("dnv"), erosion.PerMass(2700.0))
    assert per_mass_of(erosion.load_model("dnv"), erosion.PerMass(7870.0, 0.1)) == erosion.PerMass(7800.0)
