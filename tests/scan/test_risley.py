"""Prisms that turn, against vector optics by brute force, and what they do to the background."""

import math

import numpy as np
import pytest
from helpers import brute, scanners
from helpers.scanners import PULSES, directions, shares

from lidarscene.scan.risley import Risley, TurningMirror, Wedge
from lidarscene.scan.turns import Turns


@pytest.mark.parametrize("make", [scanners.mid40, scanners.three_wedges])
def test_risley(make):
    scanner = make()
    parts = [(w.angle_rad, w.index, w.tilted) for w in scanner.wedges]
    if make is scanners.mid40:
        hz, start = (-121.5657, 77.7430), (0.0, 0.0)
    else:
        hz, start = (100.3, -70.1, 11.7), (0.1, 0.2, 0.3)
    beams, share = directions(scanner, PULSES), shares(scanner, PULSES)
    for n, pulse in enumerate(PULSES.astype(int)):
        phases = [2 * math.pi * f * pulse / 100e3 + p for f, p in zip(hz, start, strict=True)]
        angles, indices, tilted = zip(*parts, strict=True)
        expected, grown = brute.prisms(angles, indices, phases, tilted)
        np.testing.assert_allclose(beams[n], expected, atol=1e-6)
        assert share[n] == pytest.approx(grown, abs=3e-6)


def test_thin_wedge_deviates_by_n_minus_one_alpha():
    """Reference: the textbook's thin prism. Tolerance: its next order, alpha^2. The thick side is where it bends to."""
    turns = Turns.per_pulse(frequency_hz=1.0, rate_hz=1.0)
    for tilted in ("in", "out"):
        wedge = Wedge(angle_rad=1e-3, index=1.51, turns=turns, tilted=tilted)
        (_, y, z), _ = wedge.bend((1.0, 0.0, 0.0), np.array([0.4]))
        np.testing.assert_allclose([y[0], z[0]], 0.51e-3 * np.array([math.cos(0.4), math.sin(0.4)]), rtol=3e-6)


def test_six_beams_take_turns():
    """Each laser is a scanner of its own whose beam comes in at its angle; wedges of glass like air do not bend it."""
    clear = scanners.mid40(
        tilted=["in", "in"], index=[1.0 + 1e-9] * 2, beam_elevation_rad=[-0.05, 0.0, 0.03], frame_hz=1e3
    )
    pulse = np.arange(99, dtype=np.uint32)
    azimuth, elevation = clear.angles(pulse)
    assert np.abs(azimuth).max() < 1e-6
    assert elevation == pytest.approx(np.tile([-0.05, 0.0, 0.03], 33), abs=1e-6)
    assert clear.channel(pulse).tolist() == [0, 1, 2] * 33
    axial, tilted = scanners.mid40(tilted=["in", "in"]), scanners.six_beams()
    on_axis = scanners.mid40(tilted=["in", "in"], beam_elevation_rad=[0.0])
    for component, on_axis_component in zip(axial.direction(pulse), on_axis.direction(pulse), strict=True):
        assert component == pytest.approx(on_axis_component, abs=1e-6)
    assert np.degrees(np.ptp(tilted.angles(np.arange(60_000, dtype=np.uint32))[1])) > 38.3 + 5.5


def test_mid40_field_of_view():
    """Reference: 39.4 degrees from HELIOS++'s prisms (Livox says 38.4), inclined faces inside."""
    scanner = scanners.mid40(frame_hz=1.0)
    x = scanner.direction(scanners.frame(scanner))[0]
    assert 2 * np.degrees(np.arccos(x.min())) == pytest.approx(39.4, abs=0.05)


def test_prisms_keep_aperture_times_solid_angle():
    """Rationale: why (8) has no share for prisms. Reference: three neighbouring rays through the wedges give the
    solid angle's growth, by differences of 1e-4; times the growth of the cross-section it is 1.
    """
    prisms = scanners.ALL["mid40"]()
    rng = np.random.default_rng(4)
    phases = [rng.uniform(0.0, 2.0 * math.pi, 300) for _ in prisms.wedges]

    def bend_through(direction):
        share = 1.0
        for wedge, phase in zip(prisms.wedges, phases, strict=True):
            direction, widened = wedge.bend(direction, phase)
            share = share * widened
        return np.stack(np.broadcast_arrays(*direction)), share

    step = 1e-4
    middle, share = bend_through((1.0, 0.0, 0.0))
    slopes = []
    for axis in (1, 2):
        aside = np.zeros(3)
        aside[axis] = math.sin(step)
        forward, backward = (bend_through((math.cos(step), *(sign * aside[1:])))[0] for sign in (1.0, -1.0))
        slopes.append((forward - backward) / (2.0 * step))
    growth = np.abs(np.sum(middle * np.cross(slopes[0], slopes[1], axis=0), axis=0))
    assert np.ptp(share) > 0.05
    np.testing.assert_allclose(growth * share, 1.0, atol=1e-6)


def test_a_mirror_throws_a_cone_around_its_own_direction():
    """A wedge that deviates by d draws sin e = sin e0 cos d - cos e0 sin d cos psi, e0 = 2 tilt - 90 degrees, psi from
    the side to which the mirror's normal leans. References: Snell's law in one plane for d, and the spherical law
    of cosines.
    """
    tilt, alpha, index = math.radians(55.0), math.radians(30.0), 1.5
    rate = {"rate_hz": 1e4}
    prism = Wedge.create(angle_rad=alpha, index=index, rotation_hz=41.0, phase_rad=0.3, tilted="out", **rate)
    turning = TurningMirror.create(tilt_rad=tilt, rotation_hz=57.0, phase_rad=0.1, **rate)
    scanner = Risley.create(wedges=[prism], mirror=turning, frame_hz=10.0, **rate)
    pulse = np.arange(1000, dtype=np.uint32)
    deviation = math.asin(index * math.sin(alpha)) - alpha
    middle = 2.0 * tilt - 0.5 * math.pi
    psi = 2.0 * math.pi * (41.0 - 57.0) * pulse / 1e4 + 0.3 - 0.1
    expected = math.sin(middle) * math.cos(deviation) - math.cos(middle) * math.sin(deviation) * np.cos(psi)
    np.testing.assert_allclose(np.sin(scanner.angles(pulse)[1]), expected, atol=2e-6)
