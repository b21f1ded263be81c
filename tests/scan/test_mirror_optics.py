"""Mirrors on gimbals and in pairs against vector optics by brute force, and against what is known of small angles."""

import math

import numpy as np
import pytest
from helpers import brute, scanners
from helpers.scanners import DEG

from lidarscene import scan
from lidarscene.maths.vectors import angles_of


@pytest.mark.parametrize("incidence", [0.0, 0.3, 45 * DEG, 1.0])
@pytest.mark.parametrize("side", list(brute.SIDES))
@pytest.mark.parametrize("outer", ["azimuth", "elevation"])
def test_gimbal(incidence, side, outer):
    """Rationale: a mirror is its normal, and its axes turn with it. Reference: rotation matrices, float64."""
    mirror = scan.Gimbal(incidence_rad=incidence, side=side, outer=outer)
    for a, e in ((0.0, 0.0), (0.2, 0.0), (0.0, -0.1), (0.15, 0.1), (-0.2, 0.12), (-0.1, -0.15)):
        direction, share = mirror.beam(np.array([a]), np.array([e]))
        expected, projected = brute.gimbal(incidence, side, outer, a, e)
        np.testing.assert_allclose(np.ravel(direction), expected, atol=1e-14)
        assert share[0] == pytest.approx(projected, rel=1e-13)


@pytest.mark.parametrize("last", ["azimuth", "elevation"])
def test_pair_of_mirrors(last):
    mirrors = scan.MirrorPair(last=last)
    for a, e in ((0.0, 0.0), (0.2, 0.0), (0.0, -0.1), (0.15, 0.1), (-0.2, 0.12)):
        direction, share = mirrors.beam(np.array([a]), np.array([e]))
        expected, projected = brute.pair(last, a, e)
        np.testing.assert_allclose(np.ravel(direction), expected, atol=1e-14)
        assert share[0] == pytest.approx(projected, rel=1e-13)


@pytest.mark.parametrize("last", ["azimuth", "elevation"])
def test_lines_of_a_pair_are_cones_about_the_last_axis(last):
    """Rationale: the last mirror turns what it gets about its own axis, so the angle to that axis stays."""
    turns = np.linspace(-0.2, 0.2, 9)
    first = np.full(9, 0.1)
    angles = (first, turns) if last == "elevation" else (turns, first)
    direction, _ = scan.MirrorPair(last=last).beam(*angles)
    np.testing.assert_allclose(direction[1 if last == "elevation" else 2], math.sin(0.2), atol=1e-15)


def test_small_mirror_turns_double():
    """Rationale: near the axis a mirror doubles angles; the turn in the mirror's plane counts cos(incidence) of it.
    Reference: first order. Tolerance: the second order, 1e-4 of the angle.
    """
    turn = 1e-4
    for incidence in (0.0, 0.5):
        mirror = scanners.gimbal(incidence_rad=incidence)
        azimuth, elevation = angles_of(mirror.beam(np.array([turn, 0.0]), np.array([0.0, turn]))[0])
        assert azimuth[0] == pytest.approx(2 * turn * math.cos(incidence), rel=1e-4)
        assert elevation[1] == pytest.approx(2 * turn, rel=1e-4)


def test_the_turn_in_the_mirror_moves_the_beam_by_the_formula():
    """The beam moves out of the plane of incidence by asin(cos(incidence) sin(2 t)), as `Gimbal` says. Reference:
    exact.
    """
    t = np.linspace(-0.4, 0.4, 11)
    direction, _ = scanners.gimbal(incidence_rad=0.7).beam(t, np.zeros(11))
    np.testing.assert_allclose(direction[1], math.cos(0.7) * np.sin(2 * t), atol=1e-15)
