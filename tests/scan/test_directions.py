"""Directions of every scanner against vector optics by brute force, and against what is known of small angles."""

import math

import numpy as np
import pytest
from helpers import brute, scanners
from helpers.scanners import DEG

from lidarscene import scan
from lidarscene.maths.vectors import across, angles_of

PULSES = np.array([0, 1, 17, 130, 1201, 2077, 2400, 2999], dtype=np.uint32)


def directions(scanner, pulse):
    return np.stack(np.broadcast_arrays(*scanner.direction(pulse)), axis=1)


def shares(scanner, pulse):
    return np.broadcast_to(scanner.aperture_share(pulse), len(pulse))


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
    at = (first, turns) if last == "elevation" else (turns, first)
    direction, _ = scan.MirrorPair(last=last).beam(*at)
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
    """Out of the plane of incidence by asin(cos(incidence) sin(2 t)), as `Gimbal` says. Reference: exact."""
    t = np.linspace(-0.4, 0.4, 11)
    direction, _ = scanners.gimbal(incidence_rad=0.7).beam(t, np.zeros(11))
    np.testing.assert_allclose(direction[1], math.cos(0.7) * np.sin(2 * t), atol=1e-15)


def test_mirror_raster_turns_its_mirrors_by_its_grid():
    scanner = scanners.mirror()
    row, column = 3, 117
    turned = (1 - 2 * column / 119) * 15 * DEG, (1 - 2 * row / 40) * 6 * DEG
    expected, _ = brute.gimbal(0.6, "below", "elevation", *turned)
    got = directions(scanner, np.array([row * 120 + column], dtype=np.uint32))[0]
    np.testing.assert_allclose(got, expected, atol=3e-7)


def test_sine_lines_come_back_and_are_even_in_time():
    """Rationale: a resonant mirror's angle is A sin, whichever way the line goes; lines follow at half a period."""
    scanner = scanners.mirror(waveform="sine", line_duty=0.8, mirrors=scan.MirrorPair(last="elevation"))
    pulse = np.arange(240, dtype=np.uint32)
    (fast, _), time_s = scanner._mechanism(pulse), scanner.time_s(pulse)
    line_s = 120 / (100e3 * 0.8)
    middle = time_s - 59.5 / 100e3  # the first line's middle is where the sine goes through zero
    np.testing.assert_allclose(fast, -15 * DEG * np.sin(math.pi * middle / line_s), atol=1e-6)


def test_ramp_goes_on_within_a_line():
    scanner = scanners.mirror(slow="ramp")
    _, slow = scanner._mechanism(scanners.frame(scanner))
    whole = scanner.time_s(scanners.frame(scanner)) / (41 * scanner.line_s)
    np.testing.assert_allclose(slow, (1 - 2 * whole) * 6 * DEG, atol=2e-7)


def test_lissajous():
    """Reference: the two sines at the pulse's own time in float64, then the mirror by brute force."""
    scanner = scanners.lissajous()
    got = directions(scanner, PULSES)
    for pulse, direction in zip(PULSES, got, strict=True):
        t = int(pulse) / 200e3
        a = 12 * DEG * math.sin(2 * math.pi * 1310 * t + 0.3)
        e = 8 * DEG * math.sin(2 * math.pi * 1190 * t + 1.2)
        np.testing.assert_allclose(direction, brute.gimbal(0.3, "left", "elevation", a, e)[0], atol=1e-6)


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("rotation_hz", [30.0, -30.0])
def test_polygon(side, rotation_hz):
    scanner = scanners.polygon(side=side, rotation_hz=rotation_hz)
    assert scanner.columns == 750  # 150 kHz, 30 turns of four facets, 60 % of the time
    got, share = directions(scanner, PULSES), shares(scanner, PULSES)
    for n, pulse in enumerate(PULSES.astype(int)):
        number, column = divmod(int(pulse), 750)
        tilt = (-4, -1, 2, 5)[number] * DEG
        turn = 2 * math.pi * rotation_hz * (column - 374.5) / 150e3
        np.testing.assert_allclose(got[n], brute.facet(40 * DEG, side, turn, tilt), atol=1e-6)
        expected = brute.facet_share(40 * DEG, side, turn, 4, 0.03, 0.012)
        assert share[n] == pytest.approx(expected, abs=0.003)


def test_polygon_moves_the_beam_by_twice_its_turn():
    """Reference: facets without tilt keep the beam level, so the azimuth is exactly twice the turn."""
    azimuth, elevation = scanners.polygon(tilt_rad=[0.0] * 6, duty=0.5).angles(np.arange(10, dtype=np.uint32))
    np.testing.assert_allclose(np.diff(azimuth), 2 * 2 * math.pi * 30 / 150e3, rtol=2e-4)
    np.testing.assert_allclose(elevation, 0.0, atol=1e-7)


@pytest.mark.parametrize("make", [scanners.mid40, scanners.three_wedges])
def test_risley(make):
    scanner = make()
    parts = [(w.angle_rad, w.index, w.tilted) for w in scanner.wedges]
    if make is scanners.mid40:
        hz, start = (-121.5657, 77.7430), (0.0, 0.0)
    else:
        hz, start = (100.3, -70.1, 11.7), (0.1, 0.2, 0.3)
    got, share = directions(scanner, PULSES), shares(scanner, PULSES)
    for n, pulse in enumerate(PULSES.astype(int)):
        phases = [2 * math.pi * f * pulse / 100e3 + p for f, p in zip(hz, start, strict=True)]
        angles, indices, tilted = zip(*parts, strict=True)
        expected, grown = brute.prisms(angles, indices, phases, tilted)
        np.testing.assert_allclose(got[n], expected, atol=1e-6)
        assert share[n] == pytest.approx(grown, abs=3e-6)


def test_thin_wedge_deviates_by_n_minus_one_alpha():
    """Reference: the textbook's thin prism. Tolerance: its next order, alpha^2. The thick side is where it bends to."""
    from lidarscene.scan.risley import Wedge
    from lidarscene.scan.turns import Turns

    turns = Turns.per_pulse(frequency_hz=1.0, rate_hz=1.0)
    for tilted in ("in", "out"):
        wedge = Wedge(angle_rad=1e-3, index=1.51, turns=turns, tilted=tilted)
        (_, y, z), _ = wedge.bend((1.0, 0.0, 0.0), np.array([0.4]))
        np.testing.assert_allclose(
            [y[0], z[0]], 0.51e-3 * np.array([math.cos(0.4), math.sin(0.4)]), rtol=3e-6
        )


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
    for one, other in zip(axial.direction(pulse), on_axis.direction(pulse), strict=True):
        assert one == pytest.approx(other, abs=1e-6)
    assert np.degrees(np.ptp(tilted.angles(np.arange(60_000, dtype=np.uint32))[1])) > 38.3 + 5.5


def test_mid40_field_of_view():
    """Reference: 39.4 degrees from HELIOS++'s prisms (Livox says 38.4), inclined faces inside."""
    scanner = scanners.mid40(frame_hz=1.0)
    x = scanner.direction(scanners.frame(scanner))[0]
    assert 2 * np.degrees(np.arccos(x.min())) == pytest.approx(39.4, abs=0.05)


FLASH_HEIGHT = {
    "rectilinear": np.tan,
    "equidistant": lambda t: t,
    "equisolid": lambda t: 2 * np.sin(t / 2),
    "stereographic": lambda t: 2 * np.tan(t / 2),
    "orthographic": np.sin,
}


@pytest.mark.parametrize("projection", FLASH_HEIGHT)
def test_flash(projection):
    """Reference: the projection's own law, from the angle back to the pixel; solid angle by differences."""
    scanner = scanners.flash(projection=projection, falloff="pupil_and_pixel")
    direction, share = directions(scanner, scanners.frame(scanner)), shares(scanner, scanners.frame(scanner))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=2e-7)
    up, left = np.mgrid[20:-21:-1, 30:-31:-1] * 0.02
    t = np.arctan2(np.hypot(direction[:, 1], direction[:, 2]), direction[:, 0])
    height = FLASH_HEIGHT[projection]
    np.testing.assert_allclose(height(t), np.hypot(left, up).ravel(), atol=1e-6)
    cross = direction[:, 1] * up.ravel() - direction[:, 2] * left.ravel()
    np.testing.assert_allclose(cross, 0.0, atol=1e-7)
    t = np.maximum(t.astype(float), 1e-3)
    step = 1e-5
    slope = (height(t + step) - height(t - step)) / (2 * step)
    np.testing.assert_allclose(share, np.cos(t) * np.sin(t) / (height(t) * slope), rtol=2e-5)


def test_vlp16_by_hand():
    """Pulse 3 of cycle 100: laser 3 at +3 degrees, 100 x 55.296 + 3 x 2.304 us after the start, turning clockwise."""
    scanner = scanners.vlp16()
    pulse = np.array([1603], dtype=np.uint32)
    azimuth, elevation = scanner.angles(pulse)
    t = 100 * 55.296e-6 + 3 * 2.304e-6
    assert scanner.time_s(pulse)[0] == pytest.approx(t, rel=1e-12)
    assert azimuth[0] == pytest.approx(-2 * math.pi * 10 * t, abs=3e-7)
    assert elevation[0] == pytest.approx(3 * DEG, abs=1e-8)
    np.testing.assert_allclose(np.ravel(scanner.offset_m(pulse)), [0, 0, -2.2e-3], atol=1e-9)


def test_exits_turn_with_the_head():
    scanner = scanners.vlp16(start_m=([0.03] * 16, [0.01] * 16, [0.0] * 16), start_azimuth_rad=math.pi / 2)
    x, y, z = (v[0] for v in scanner.offset_m(np.zeros(1, dtype=np.uint32)))
    np.testing.assert_allclose([x, y, z], [-0.01, 0.03, 0.0], atol=1e-8)


def test_vectors_across_a_beam():
    for direction in ([1, 0, 0], [0, 0, 1], [0, 0, -1], [0.6, -0.48, 0.64], [0, 1, 0]):
        u, v = across(tuple(np.array([float(c)]) for c in direction))
        matrix = np.array([direction, np.ravel(u), np.ravel(v)], dtype=float)
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
