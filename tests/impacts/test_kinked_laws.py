"""The best angle of kinked force laws: brute force's, or said to be unresolved."""

import numpy as np
import pytest

import erosion
from erosion.plotting.curves import pieces, plot_optimum
from tests.kinked_laws import Breaking, KinkedTable, Power, Where, model_of

P = erosion.TABLE_1


def _brute_force(model, p) -> tuple[float, float]:
    angles = np.linspace(0.01, 1.57, 2001)
    volumes = erosion.impact(model, p.replace(alpha=angles)).volume
    best = angles[np.argmax(volumes)]
    angles = np.linspace(best - 1e-3, best + 1e-3, 201)
    volumes = erosion.impact(model, p.replace(alpha=angles)).volume
    return angles[np.argmax(volumes)], np.max(volumes)


@pytest.mark.slow
@pytest.mark.parametrize("law", [KinkedTable, Where, Power], ids=lambda law: law.__name__)
@pytest.mark.parametrize("k", [1.0, 2.0])
def test_a_continuous_law_is_certified(law, k):
    model, p = model_of(law), P.replace(k=k)
    best, (alpha, volume) = erosion.alpha_max(model, p), _brute_force(model, p)
    assert best.certified
    assert best.kind in ("interior", "jump")
    assert best.alpha == pytest.approx(alpha, abs=1e-4)
    assert volume * (1 - 1e-9) < best.value < volume * (1 + 1e-5)
    assert "the search resolved all angles" in str(best)


@pytest.mark.slow
@pytest.mark.parametrize("k", [1.0, 2.0])
def test_where_the_force_jumps_the_best_angle_is_unresolved_and_says_so(k):
    model, p = model_of(Breaking), P.replace(k=k)
    best, (alpha, volume) = erosion.alpha_max(model, p), _brute_force(model, p)
    assert (best.kind, best.certified) == ("unresolved", False)
    assert best.alpha == pytest.approx(alpha, abs=1e-4)
    assert best.value >= volume * (1 - 1e-9)
    assert "certified" in str(best)
    assert "a better angle may have been missed" in " ".join(str(best).split())
    # The figure shows V at every angle all the same.
    assert all(np.all(np.isfinite(piece.value)) for piece in pieces(best))
    assert len(plot_optimum(best).axes) == 1


def test_a_level_function_is_a_plateau_still():
    assert erosion.alpha_max("linearized", P, objective="t_c").kind == "plateau"


@pytest.mark.slow
def test_a_batch_says_how_many_are_certified():
    assert "0 of 2" in str(erosion.alpha_max(model_of(Breaking), P.replace(k=[1.0, 2.0])))
