"""A head that turns while it sums the shots of a point: the light of its rays against shots that are traced apart."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import chain, photons
from helpers.run_seed import chosen
from scipy.stats import norm

from lidarscene.rendering.simulator import Simulator

pytestmark = pytest.mark.usefixtures("mi")

COLUMNS, PARTS = 64, 16
BEAM = ["laser.divergence_mrad=20", "scanner.elevation_deg=[0.0, 2.0]"]
SWEEP_RAD = 20.0 * math.pi * 868 * 1.8e-6
"""Of a column of 64 at 10 Hz, 868 shots every 1.8 us: 98 mrad."""


def standing(sensor):
    """The sensor with a head that stands while it sums."""
    return replace(sensor, histogram=replace(sensor.histogram, sweep_rad=0.0))


def light_of(described, *keys, rays, turns=True):
    """Ranges and powers of all rays of each pulse, (pulses, rays)."""
    sensor = photons.spinning(*BEAM, *keys)
    simulator = Simulator(described, sensor if turns else standing(sensor), rays=rays)
    (part,) = simulator.light().parts
    return simulator.sensor, part.range_m.reshape(-1, rays), part.peak_power_w.reshape(-1, rays)


def moments(range_m, power_w):
    """Power, mean range and its variance, weighted by power, over the last axis."""
    total = power_w.sum(axis=-1)
    mean = (range_m * power_w).sum(axis=-1) / total
    return total, mean, ((range_m - mean[..., None]) ** 2 * power_w).sum(axis=-1) / total


def leaning_wall(theta_deg):
    return chain.scene(chain.facing(range_m=20.0, theta_deg=theta_deg, size_m=60.0), klux=0.0)


def swept_and_apart(described):
    """Ranges and powers of the first column's two pulses, (2, rays): of the swept beam, and of its shots in 16 parts,
    each turned from the one before and standing while it is summed.
    """
    swept, *light = light_of(described, f"scanner.columns_per_turn={COLUMNS}", rays=256)
    assert swept.sweep_rad == pytest.approx(SWEEP_RAD)
    begin_deg = -0.5 * 360.0 / COLUMNS * (1.0 - 1.0 / PARTS)
    apart, *shots = light_of(
        described,
        f"scanner.columns_per_turn={COLUMNS * PARTS}",
        f"scanner.start_azimuth_deg={begin_deg}",
        rays=64,
        turns=False,
    )
    assert PARTS * apart.histogram.shots == pytest.approx(swept.histogram.shots, rel=0.01)
    parts_m, parts_w = (values[: 2 * PARTS].reshape(PARTS, 2, 64).swapaxes(0, 1).reshape(2, -1) for values in shots)
    return [values[:2] for values in light], [parts_m, parts_w / PARTS]


def test_as_shots_that_leave_one_by_one():
    """A wall that leans by 40 degrees, seen by the swept beam and by shots apart: power to 0.2 %, mean range to 3 mm,
    its spread to 1 %. The rest is the wall's bend in angle and the 16 steps of the shots (1/256 of the sweep's
    variance).
    """
    ours, theirs = (moments(*light) for light in swept_and_apart(leaning_wall(40.0)))
    np.testing.assert_allclose(ours[0], theirs[0], rtol=2e-3)
    np.testing.assert_allclose(ours[1], theirs[1], atol=3e-3)
    np.testing.assert_allclose(ours[2], theirs[2], rtol=0.01)


@pytest.mark.parametrize("edge_m", chosen(2, [-0.35, 0.0, 0.2, 0.6]))
def test_edges_within_the_sweep(edge_m):
    """A board at 10 m, whose left edge the beam sweeps past: its share of the shots' light, to the 2 % that 256 rays
    and 64 in each of 16 parts leave; and its share of the light is that of a Gaussian convolved with the sweep.
    """
    board = chain.facing(range_m=10.0, size_m=4.0, at=(0.0, edge_m - 2.0, 0.0))
    described = chain.scene(board, klux=0.0)
    ours, theirs = (light[1].sum(axis=1) for light in swept_and_apart(described))
    whole = swept_and_apart(chain.scene(chain.facing(range_m=10.0, size_m=40.0), klux=0.0))[0][1].sum(axis=1)
    np.testing.assert_allclose(ours / whole, theirs / whole, atol=0.02)
    shots = SWEEP_RAD * ((np.arange(500) + 0.5) / 500.0 - 0.5)
    share = norm.cdf((math.atan(edge_m / 10.0) - shots) / (0.25 * 20e-3)).mean()
    np.testing.assert_allclose(ours / whole, share, atol=0.02)


@pytest.mark.parametrize("theta_deg", [0.0, 40.0, -60.0])
@pytest.mark.parametrize("columns", [512, 1024])
def test_spread_of_ranges_on_a_leaning_wall(theta_deg, columns):
    """(T126): R tan(theta) times the root of the beam's w^2 / 4 R^2 and the sweep's square over 12. Tolerance 2 %: the
    wall is steeper on one side than in the middle, and its echo stronger on the near one; 0.4 mm is R phi^2 / 8 of a
    wall across the beam.
    """
    divergence = 3e-3
    described = leaning_wall(theta_deg)
    keys = f"scanner.columns_per_turn={columns}", f"laser.divergence_mrad={1e3 * divergence}"
    swept, range_m, power_w = light_of(described, *keys, rays=64)
    _, mean_m, variance = moments(range_m[0], power_w[0])
    assert mean_m == pytest.approx(20.0, abs=3e-3)
    angle = math.sqrt((0.25 * divergence) ** 2 + swept.sweep_rad**2 / 12.0)
    assert math.sqrt(variance) == pytest.approx(
        20.0 * abs(math.tan(math.radians(theta_deg))) * angle, rel=0.02, abs=4e-4
    )


def test_one_ray_and_a_head_that_stands_see_no_sweep():
    """The middle of the column alone, or the beam's own width."""
    described, keys = leaning_wall(40.0), ("scanner.columns_per_turn=1024",)
    for turns in (True, False):
        _, range_m, _ = light_of(described, *keys, rays=1, turns=turns)
        assert range_m[0, 0] == pytest.approx(20.0, abs=1e-4)
    _, range_m, power_w = light_of(described, *keys, "laser.divergence_mrad=3", rays=64, turns=False)
    beam_m = 20.0 * math.tan(math.radians(40.0)) * 0.25 * 3e-3
    assert math.sqrt(moments(range_m[0], power_w[0])[2]) == pytest.approx(beam_m, rel=0.02)


def test_background_is_that_of_the_sweep():
    """A sunlit board whose edge is 30 mrad beside the axis: the field of view, a third of a mrad wide, sees it for 19
    of 98 mrad; a head that stands does not see it. 64 rays, edges to 3 %.
    """
    board = chain.facing(range_m=10.0, size_m=20.0, at=(0.0, 10.3, 0.0))
    described = chain.scene(board, chain.box(at=(0.0, -500.0, 0.0)))
    powers_w = []
    keys = *BEAM, f"scanner.columns_per_turn={COLUMNS}", "detector.radius_mm=0.01"
    turning, turned = (photons.spinning(*keys, f"scanner.start_azimuth_deg={start_deg}") for start_deg in (0, 20))
    for sensor in (turning, standing(turning), turned):
        light = Simulator(described, sensor, rays=1, background_rays=64).light()
        powers_w.append(float(light.background_power_w[0]))
    swept, still, full = powers_w
    assert still == 0.0
    assert swept / full == pytest.approx(0.5 - math.atan(0.03) / SWEEP_RAD, abs=0.03)
