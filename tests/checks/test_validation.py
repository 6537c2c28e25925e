"""Published numbers: the file of facts, what the package gives, and how it is told."""

import math

import numpy as np
import pytest

import erosion
from erosion.checks import FACTS, Comparison, Fact, Validation
from erosion.checks.reference_solutions import EQUATIONS_OF, has_heyoka, heyoka_solutions, scipy_solution
from erosion.checks.validate import KINDS
from erosion.checks.verify import BOUNDS, Check, Subject, Verification, cases
from erosion.cli import main
from erosion.models.registry import BUILT_IN
from erosion.plotting.sweeps import plot_validation
from tests.documents import result_of
from tests.reference import AS_PRINTED, AT_20_DEGREES


@pytest.fixture(scope="module")
def validation():
    return erosion.against_published()


@pytest.fixture(scope="module")
def ratios(validation):
    return {comparison.fact.name: comparison.ratio for comparison in validation.comparisons}


@pytest.mark.slow
def test_every_fact_has_a_source_and_a_kind():
    assert len({fact.name for fact in FACTS}) == len(FACTS) == 11
    assert all(fact.source and fact.by and fact.note and fact.published > 0 for fact in FACTS)
    kinds = [list(KINDS).index(fact.kind) for fact in FACTS]
    assert kinds == sorted(kinds)  # what says most of nature comes first


@pytest.mark.slow
def test_misses_are_as_large_as_the_page_says(ratios):
    craters = [ratios[f"Crater, 5 mm sphere, {speed} m/s"] for speed in ("9.99", "12", "14", "16", "18")]
    assert 1.6 < min(craters) < max(craters) < 1.9
    assert ratios["Crater, speed exponent"] == pytest.approx(1 / 1.137, rel=1e-6)
    assert ratios["Share at 90°, cut alone"] == 0
    assert ratios["Share at 90°, DNV"] == pytest.approx(1.2524, rel=1e-3)
    assert ratios["Sand on aluminium, 112 m/s"] == pytest.approx(335, rel=1e-3)
    # The depth is as 1/√p: 1.005 GPa (ratio)² would meet the measurement.
    pressures = [1.005 * min(craters) ** 2, 1.005 * max(craters) ** 2]
    assert pressures == pytest.approx([2.63, 3.50], abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("published", "computed", "off"),
    [
        (2.0, 2.0 + 1e-8, "0 %"),
        (2.0, 2.1, "+5 %"),
        (2.0, 1.96, "-2 %"),
        (2.0, 10.0, "×5"),
        (2.0, 0.2, "×0.1"),
        (2.0, 0.0, "-100 %"),
    ],
)
def test_how_far_off_is_told_in_words(published, computed, off):
    comparison = Comparison(
        Fact("f", published, "um", "measured", "somebody", "a model", "", lambda: computed), computed
    )
    assert comparison.off == off
    assert Validation((comparison,)).rows() == [("f", "2", f"{computed:.4g}", "µm", off, "[1]")]


@pytest.mark.slow
def test_it_prints_each_source_once_and_claims_nothing(validation):
    text = str(validation)
    assert text.startswith("11 published numbers")
    assert text.count("measured: X. Cao et al. 2022") == 1
    assert "This table validates no model." in text
    described = validation.to_dict()["facts"]
    assert described[0]["published"] == {"value": 22.961, "unit": "um"}
    assert math.isfinite(described[0]["computed"]["value"])


@pytest.mark.slow
def test_the_figure_has_a_mark_for_every_number(validation):
    ax = plot_validation(validation).axes[0]
    marks = sum(np.size(line.get_xdata()) for line in ax.lines if line.get_label() in KINDS)
    assert marks == len(validation.comparisons)
    assert [tick.get_text() for tick in ax.get_yticklabels()] == [c.fact.name for c in validation.comparisons]


P = erosion.TABLE_1
FIGURES = {name: one[:3] for name, one in AT_20_DEGREES.items()} | {"as-printed": AS_PRINTED}

# The exact solution of `linearized`, of a force whose upper component is a thousandth larger.
WRONG = '''"""A closed form that is not the model's own."""

import erosion


class Wrong(erosion.models.ForceLaw):
    def __call__(self, state, tip, p):
        return -p.stiffness * tip.depth, -1.001 * p.k * p.stiffness * tip.depth

    def typical_ratio(self, p):
        return p.k


class Mine(erosion.models.RigidErodent):
    force: erosion.models.ForceLaw = Wrong()
    torque: erosion.models.Torque = erosion.models.NoTorque()
    kinematics: erosion.models.TipKinematics = erosion.models.CentreOfMassTip()

    def closed_form(self):
        return erosion.models.Linearized().closed_form()
'''


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    file = tmp_path_factory.mktemp("models") / "mine.py"
    file.write_text(WRONG)
    return file


@pytest.mark.slow
def test_the_equations_are_typed_a_second_time_for_every_registered_model():
    assert set(EQUATIONS_OF) == set(BUILT_IN)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_reference_solutions_know_the_golden_numbers(name):
    volume, t_c, ended_by = FIGURES[name]
    solutions = [scipy_solution(name, P)]
    if has_heyoka():
        solutions += heyoka_solutions(name, [P])
    for solution in solutions:
        # Printed to 9 digits where a model is of the printed kind, else to 11 and more.
        assert solution.volume == pytest.approx(volume, rel=1e-10)
        assert solution.t_c == pytest.approx(t_c, rel=1e-8)
        assert solution.ended_by == ended_by


@pytest.mark.slow
def test_a_wrong_closed_form_is_caught(wrong, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["verify", str(wrong), "--json"])
    assert ended.value.code == 1
    said = capsys.readouterr()
    content = result_of(said.out)
    assert not content["passed"]
    failed = {check["name"] for check in content["checks"] if not check["passed"]}
    assert failed == {"closed form"}
    assert {check["name"] for check in content["checks"]} == set(BOUNDS) - {"heyoka", "scaling", "own quantities"}
    assert "1 of 9 checks are out of bounds." in said.err


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::erosion.TurnWarning")
def test_a_wrong_force_is_caught_by_the_reference_solutions(wrong):
    subject = Subject("linearized", erosion.load_model(wrong), registered=True)
    checks = subject.checks()
    for name in ("closed form", "scipy", *(["heyoka"] if has_heyoka() else [])):
        assert subject.worst(checks[name]())[0] > 1e4 * BOUNDS[name][0]
    # The scaling law knows nothing of K's size.
    assert subject.worst(checks["scaling"]())[0] < BOUNDS["scaling"][0]


@pytest.mark.slow
def test_what_fails_is_said_and_does_not_stop_the_others(written):
    file = written("nan.py", WRONG.replace("-1.001", "float('nan')"))
    verification = erosion.verify([file, "linearized"])
    assert {check.model for check in verification.failures} == {str(file)}
    assert verification.failures[-1].error == math.inf
    assert "not finite" in verification.failures[-1].where
    passed = {check.name for check in verification.checks if check.model == "linearized"}
    assert passed >= set(BOUNDS) - {"heyoka", "own quantities", "∂V/∂q", "∂²V/∂α∂q"}
    assert "linearized" in str(verification)
    assert "✗" in str(verification)


@pytest.mark.slow
def test_errors_that_are_no_numbers_do_not_pass():
    assert not Check("m", "engines", math.nan, "").passed
    assert not Check("m", "engines", math.inf, "").passed
    assert Check("m", "engines", 1e-12, "").passed
    assert Verification((Check("m", "engines", 0.0, ""),)).passed


@pytest.mark.slow
def test_cases_are_valid_and_differ():
    for p in cases():
        erosion.validate(p)
    assert len(cases()) == len({float(p.alpha) for p in cases()})
    assert np.ptp([float(p.spin) for p in cases()]) > 0


@pytest.mark.slow
def test_unknown_models_are_bad_input(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["verify", "rotated"])
    assert ended.value.code == 2
    assert "There is no model 'rotated'" in capsys.readouterr().err
