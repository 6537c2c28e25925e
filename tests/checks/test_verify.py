"""`verify`: reference solutions, wrong models, and which checks pass."""

import math

import numpy as np
import pytest

import erosion
from erosion.checks.reference_solutions import EQUATIONS_OF, has_heyoka, heyoka_solutions, scipy_solution
from erosion.checks.verify import BOUNDS, Check, Subject, Verification, cases
from erosion.cli import main
from erosion.models.registry import BUILT_IN
from tests.documents import result_of
from tests.reference import AS_PRINTED, AT_20_DEGREES

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


class Mine(erosion.models.RigidParticle):
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


def test_the_equations_are_typed_a_second_time_for_every_registered_model():
    assert set(EQUATIONS_OF) == set(BUILT_IN)


@pytest.mark.parametrize("name", FIGURES)
def test_reference_solutions_know_the_golden_numbers(name):
    volume, t_c, ended_by = FIGURES[name]
    solutions = [scipy_solution(name, P)]
    if has_heyoka():
        solutions += heyoka_solutions(name, [P])
    for solution in solutions:
        # Printed in in³, to 9 digits where a model is of the printed kind, else to 11 and more.
        assert solution.volume / 0.0254**3 == pytest.approx(volume, rel=1e-10)
        assert solution.t_c == pytest.approx(t_c, rel=1e-8)
        assert solution.ended_by == ended_by


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
    assert "1 of 8 checks are out of bounds." in said.err


@pytest.mark.filterwarnings("ignore::erosion.TurnWarning")
def test_a_wrong_force_is_caught_by_the_reference_solutions(wrong):
    subject = Subject("linearized", erosion.load_model(wrong), registered=True)
    checks = subject.checks()
    for name in ("closed form", "scipy", *(["heyoka"] if has_heyoka() else [])):
        assert subject.worst(checks[name]())[0] > 1e4 * BOUNDS[name][0]
    # The scaling law knows nothing of K's size.
    assert subject.worst(checks["scaling"]())[0] < BOUNDS["scaling"][0]


def test_what_fails_is_said_and_does_not_stop_the_others(written):
    file = written("nan.py", WRONG.replace("-1.001", "float('nan')"))
    verification = erosion.verify([file, "linearized"])
    assert {check.model for check in verification.failures} == {str(file)}
    assert verification.failures[-1].error == math.inf
    assert "not finite" in verification.failures[-1].where
    passed = {check.name for check in verification.checks if check.model == "linearized"}
    assert passed >= set(BOUNDS) - {"heyoka", "own quantities", "∂V/∂q", "∂²V/∂α∂q"}
    assert "linearized" in str(verification)
    assert "* out of bounds." in str(verification)


def test_errors_that_are_no_numbers_do_not_pass():
    assert not Check("m", "engines", math.nan, "").passed
    assert not Check("m", "engines", math.inf, "").passed
    assert Check("m", "engines", 1e-12, "").passed
    assert Verification((Check("m", "engines", 0.0, ""),)).passed


def test_cases_are_valid_and_differ():
    for p in cases():
        erosion.validate(p)
    assert len(cases()) == len({float(p.alpha) for p in cases()})
    assert np.ptp([float(p.spin) for p in cases()]) > 0


def test_unknown_models_are_bad_input(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["verify", "rotated"])
    assert ended.value.code == 2
    assert "There is no model 'rotated'" in capsys.readouterr().err
