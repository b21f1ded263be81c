"""Panes and mirrors straight across a beam: its own light comes back, as much as a beam in space says."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import chain
from helpers.panes import INDEX, MATERIALS, MIDDLE, both_sides, pane

from lidarscene.maths.trajectory import Course
from lidarscene.physics.optics import radiometry
from lidarscene.rendering.simulator import Simulator

pytestmark = pytest.mark.usefixtures("mi")

RANGE_M = 10.0
DIVERGENCE_RAD, EXIT_M = 3e-3, 10e-3
WIDE = (f"laser.divergence_mrad={DIVERGENCE_RAD * 1e3}", f"laser.exit_diameter_mm={EXIT_M * 1e3}")
R = both_sides(1.0, INDEX)


def trace_with_glints(*bodies, overrides=WIDE, **tracing):
    described = chain.scene(*bodies, materials=MATERIALS)
    sensor = chain.sensor("table1-apd", *chain.NARROW, *overrides)
    return sensor, chain.run_stages(described, sensor, glints=True, **tracing)


def share_in_space(sensor, tilt_rad, range_m=RANGE_M):
    """The share by the beam's density over the image of the aperture, in three dimensions and double precision.

    Points of the aperture (in the plane x = 0) are mirrored at the plane through (R, 0, 0) whose normal is tilted;
    where they are then, the beam along x has the width w(x), and its density is that of the light that would have
    come to them. 400 x 400 midpoints over the disc: 1e-4.
    """
    radius = float(sensor.optics.aperture_radius_m)
    line = (np.arange(400) + 0.5) / 400 * 2.0 - 1.0
    y, z = (radius * axis.ravel() for axis in np.meshgrid(line, line))
    on_disc = y**2 + z**2 < radius**2
    points = np.stack([0.0 * y, y, z], axis=1)[on_disc]
    normal = np.array([-math.cos(tilt_rad), math.sin(tilt_rad), 0.0])
    offset = (points - [range_m, 0.0, 0.0]) @ normal
    x, y, z = (points - 2.0 * offset[:, None] * normal).T
    w = np.sqrt((EXIT_M / 2.0) ** 2 + (DIVERGENCE_RAD / 2.0 * x) ** 2)
    density = 2.0 / (math.pi * w**2) * np.exp(-2.0 * (y**2 + z**2) / w**2)
    return float(density.sum() * (2.0 * radius / 400) ** 2)


def expected_w(sensor, tilt_rad, one_way=R):
    share = share_in_space(sensor, tilt_rad)
    return share * one_way * sensor.laser.peak_power_w * sensor.optics.efficiency_laser * 0.98**2


# The spot is 2.4 apertures wide: cubature 1e-5, tilts in single precision 1e-4 of the spot, the edge of the test's
# grid 1e-4; on the flank at 0.1 degrees the density falls by 2 * 2 d / w per w.
CLOSE = {"rel": 2e-3}


@pytest.mark.parametrize("tilt_deg", [0.0, 0.02, 0.06, 0.1])
def test_a_pane_throws_the_beam_back(tilt_deg):
    """R times what lands on the aperture, at the pane's range, as an echo of the pane; the first way goes through."""
    sensor, lanes = trace_with_glints(pane(RANGE_M, tilt_deg), chain.facing(range_m=50.0))
    first, second = lanes.ways
    assert lanes.light_of_ways[1].peak_power_w[MIDDLE] == pytest.approx(
        expected_w(sensor, math.radians(tilt_deg)), **CLOSE
    )
    assert second.has_surface[MIDDLE]
    assert second.range_m[MIDDLE] == pytest.approx(RANGE_M, rel=1e-6)
    assert not second.mirrored[MIDDLE]
    assert second.interactions[MIDDLE] == 0
    assert lanes.light_of_ways[1].background_power_w[MIDDLE] == 0.0
    assert first.range_m[MIDDLE] == pytest.approx(50.0, rel=1e-6)
    assert first.throughput[MIDDLE] == pytest.approx(1.0 - R, rel=1e-4)


@pytest.mark.parametrize("tilt_deg", [0.0, 0.06])
def test_a_mirror_throws_the_beam_back(tilt_deg):
    sensor, lanes = trace_with_glints(pane(RANGE_M, tilt_deg, material="mirror"))
    echo, hits = lanes.light, lanes.hits
    assert echo.peak_power_w[MIDDLE] == pytest.approx(expected_w(sensor, math.radians(tilt_deg), one_way=0.9), **CLOSE)
    assert (hits.range_m[MIDDLE], hits.interactions[MIDDLE]) == (pytest.approx(RANGE_M, rel=1e-6), 0)


def test_a_mirror_behind_a_pane():
    """The pane takes T there and T back; it leans by 30 degrees and has no glint of its own."""
    sensor, lanes = trace_with_glints(pane(4.0, 30.0, size_m=20.0, name="front"), pane(RANGE_M, 0.0, material="mirror"))
    t = 1.0 - both_sides(math.cos(math.radians(30.0)))
    assert lanes.light_of_ways[0].peak_power_w[MIDDLE] == pytest.approx(
        expected_w(sensor, 0.0, one_way=0.9 * t * t), **CLOSE
    )
    assert lanes.hits.interactions[MIDDLE] == 1


def test_a_pane_that_leans_too_far_mirrors_as_before():
    """The beam passes, at 0.5 degrees, 17 cm beside the sensor: the board behind that is what the pane shows."""
    behind = chain.facing(range_m=-5.0, size_m=4.0)
    _, lanes = trace_with_glints(pane(RANGE_M, 0.5), behind)
    second = lanes.ways[1]
    assert second.has_surface[MIDDLE]
    assert second.mirrored[MIDDLE]
    assert second.range_m[MIDDLE] == pytest.approx(2 * RANGE_M + 5.0, rel=1e-3)


def test_with_a_moving_pane():
    """The same echo in its own frame, turned."""
    body = pane(RANGE_M, 0.06)
    moving = dataclasses.replace(body, motion=Course(start=body.pose))
    powers = [trace_with_glints(pane_body)[1].light_of_ways[1].peak_power_w[MIDDLE] for pane_body in (body, moving)]
    assert powers[1] == pytest.approx(powers[0], rel=1e-3)


@pytest.mark.parametrize("rays", [1, 19])
def test_any_number_of_rays_gives_the_same_glint(rays):
    """The share is that of the whole beam, asked by each ray: no rays are lost beside the aperture.

    Tolerance: rays reach the tilted pane up to 3e-4 of the range before and behind its middle.
    """
    sensor = chain.sensor("table1-apd", *chain.NARROW, *WIDE)
    simulator = Simulator(chain.scene(pane(RANGE_M, 0.06), materials=MATERIALS), sensor, rays=rays)
    waveforms = simulator.waveforms([MIDDLE])
    assert waveforms.power_w[0].max() == pytest.approx(expected_w(sensor, math.radians(0.06)), rel=3e-3)


def test_its_point_is_the_panes():
    """Nine beams leave some 0.01 degrees apart; the one straight across and its neighbours get it, saturating."""
    sensor = chain.sensor("table1-apd", *chain.NARROW, *WIDE, "tdc.stops=2")
    described = chain.scene(pane(RANGE_M), chain.facing(range_m=50.0), materials=MATERIALS)
    cloud = Simulator(described, sensor).render(seed=1)
    glints = cloud.select(cloud.true_range_m < 20.0)
    assert len(glints) == 9
    assert {cloud.body_names[body] for body in glints.body} == {"pane"}
    np.testing.assert_array_equal(glints.ghost, 0)
    np.testing.assert_array_equal(glints.interactions, 0)
    np.testing.assert_allclose(glints.incidence_angle_rad, 0.0, atol=1e-3)
    board = cloud.select(cloud.true_range_m > 20.0)
    assert len(board) == 9
    assert np.all(radiometry.time_of_flight_s(range_m=board.range_m) > 3e-7)
