"""Angle functions of the literature: peaks and values at 90° as published."""

import dataclasses

import jax
import numpy as np
import pytest

from erosion import TABLE_1
from erosion.correlations import (
    CORRELATIONS,
    arabnejad_cutting,
    dnv_2015,
    dnv_brittle,
    dnv_polynomial,
    ecrc_angle,
    finnie_angle,
    finnie_volume,
    mclaury_angle,
    oka_angle,
)
from erosion.correlations.families import EDWARDS
from erosion.models.rigid import FinnieCut

pytestmark = pytest.mark.slow

RIGHT = np.pi / 2


@pytest.mark.parametrize(
    ("name", "angle", "peak", "at_90"),
    [
        ("dnv", 34.71, 0.99791, 0.6),
        ("dnv-polynomial", 36.43, 1.00186, 0.56851),
        ("ecrc", 50.48, 1.32461, 0.94135),
        ("oka", 33.86, None, 1.0),
        # F = x cos²α sin α + y sin²α + z there: y + z at 90°.
        ("mclaury", 19.86, 2.40177, 0.975),
        ("arabnejad", 19.33, None, 0.0),
        # ½ arctan P and (√(1 + P²) - 1)/P with P = K/3.
        ("finnie-cfd", 16.845, (np.sqrt(13 / 9) - 1) * 1.5, 0.0),
    ],
)
def test_peak_and_value_at_normal_impact(name, angle, peak, at_90):
    found = CORRELATIONS[name]
    # Angles are published to 0.01°; the one of the polynomial, 36.425°, was rounded up.
    assert np.rad2deg(found.alpha_max) == pytest.approx(angle, abs=0.0055)
    assert float(found(RIGHT)) == pytest.approx(at_90, abs=6e-6)
    if peak is not None:
        assert found.peak == pytest.approx(peak, abs=6e-6)
    assert float(found.normalised(found.alpha_max)) == 1.0
    assert abs(float(jax.grad(found.function)(found.alpha_max))) < 1e-12


@pytest.mark.parametrize(("hardness", "angle"), [(1.05, 27.65), (1.8, 33.86), (3.43, 43.02)])
def test_okas_peak_moves_with_hardness(hardness, angle):
    at = dataclasses.replace(CORRELATIONS["oka"], function=lambda alpha: oka_angle(alpha, hardness))
    assert np.rad2deg(at.alpha_max) == pytest.approx(angle, abs=0.0055)
    assert float(at(RIGHT)) == 1.0
    # Two misprints of the polynomial of DNV show at 90°.
    misprinted = (9.370, 42.295, 110.804, 175.804, 170.137, 98.298, 31.211, 4.170)
    assert float(dnv_polynomial(RIGHT, misprinted)) == pytest.approx(1.838, abs=5e-4)


def test_finnie_is_the_model_and_openfoams_formula():
    p = TABLE_1.replace(alpha=np.deg2rad(np.linspace(1, 89, 45)))
    volume = finnie_volume(p.alpha, p.v0, p.m, p.sigma, p.psi, force_ratio=2.0)
    np.testing.assert_allclose(volume, FinnieCut().volume(p), rtol=1e-12)
    assert float(finnie_angle(np.arctan(1 / 3), 2.0)) == pytest.approx(0.3)  # (K/6) cos²α where the branches meet
    assert float(finnie_volume(0.3, 2.0, 3.0, 5.0)) == pytest.approx(3 * 4 / (5 * 2 * 2) * float(finnie_angle(0.3)))


# With the value of y that is in print McLaury's step would be greater, and of the other sign.
@pytest.mark.parametrize(
    ("function", "at", "step", "tolerance"),
    [
        (arabnejad_cutting, np.arctan(0.4), 0.0, 1e-8),
        (mclaury_angle, np.deg2rad(15), -0.00445, 1e-5),
        (lambda alpha: mclaury_angle(alpha, dataclasses.replace(EDWARDS, y=-0.1192)), np.deg2rad(15), 0.0255, 1e-4),
    ],
)
def test_how_far_branches_meet(function, at, step, tolerance):
    assert float(function(at + 1e-9) / function(at - 1e-9)) - 1 == pytest.approx(step, abs=tolerance)


@pytest.mark.parametrize(
    "function",
    [finnie_angle, dnv_2015, dnv_brittle, dnv_polynomial, ecrc_angle, mclaury_angle, oka_angle, arabnejad_cutting],
)
def test_vectorized_and_differentiable(function):
    angles = np.linspace(0.05, 1.5, 30)
    assert np.asarray(function(angles)).shape == (30,)
    slopes = np.asarray(jax.vmap(jax.grad(function))(angles))
    step = 1e-6
    differences = (np.asarray(function(angles + step)) - np.asarray(function(angles - step))) / (2 * step)
    # Central differences of 1e-6: rounding leaves 1e-9 or so.
    np.testing.assert_allclose(slopes, differences, atol=2e-8)


def test_each_names_its_source_and_its_range():
    for name, correlation in CORRELATIONS.items():
        assert correlation.name == name
        assert correlation.source
        assert correlation.valid_for
        assert (correlation.ranges["alpha"].low, correlation.ranges["alpha"].high) == (0.0, RIGHT)
        assert 0.0 < correlation.alpha_max < RIGHT
        assert float(correlation(0.0)) == 0.0
