"""The interference scene: how many points the other lidar makes, at what ranges, and which echoes it hides."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import table_1
from helpers.documentation import says
from scipy.constants import c
from scipy.stats import kstest, norm

from lidarscene import Simulator, load_scene
from lidarscene.detection.outcomes import Outcome, Status

pytestmark = pytest.mark.usefixtures("mi")

SCENE = Path(__file__).parents[2] / "scenes" / "interference.toml"
WINDOW_S, WINDOW_M = 4e-6, 599.58
RATE_HZ, PEAK_W_M2, SPREAD_DB = 2.5e4, 5e-6, 6.0
SIGMAS = norm.isf(1e-4 / 2.0)  # of a test


def tripping_hz():
    """Rate of the pulses that trip, by numpy's own log-normal peaks; the power needed is at five times (18) in the
    dark.
    """
    needed_w = table_1.TNR * table_1.sigma_18(0.0) / (table_1.K_PD * table_1.M)
    peaks = PEAK_W_M2 * 10.0 ** (0.1 * SPREAD_DB * np.random.default_rng(1).normal(size=10**6))
    return RATE_HZ * np.mean(peaks * table_1.A * table_1.ETA_R > needed_w)


@pytest.fixture(scope="module")
def simulator():
    """Function of changes of the scene: a simulator of it, in one world."""
    scene = load_scene(SCENE)
    first = Simulator(scene)
    return lambda **changes: Simulator(replace(scene, **changes), first.sensor, world=first.world)


@pytest.fixture(scope="module")
def frame(simulator):
    return render_all(simulator(), seed=0)


def render_all(simulator, *, seed):
    """Cloud, and outcome and ambient counts of every pulse."""
    outcomes, counts = np.zeros((2, simulator.sensor.scanner.pulses), int)

    def missed(pulse, outcome):
        outcomes[pulse] = outcome

    def ambient(pulse, counted):
        counts[pulse] = counted

    return simulator.render(seed=seed, missed=missed, ambient=ambient), outcomes, counts


def is_sky_point(cloud):
    """Points of the other lidar on beams that met nothing."""
    return (np.asarray(cloud.status) == Status.INTERFERENCE) & ~np.isfinite(cloud.true_range_m)


def test_share_of_the_sky_that_has_a_false_point(frame):
    """1 - exp(-nu q T): a Poisson process with one stop. Tolerance: counting; noise alarms (1e-4 of the beams)
    come first of one in ten thousand.
    """
    cloud, outcomes, _ = frame
    beams = np.sum(outcomes == Outcome.NO_SURFACE)
    expected = 1.0 - math.exp(-tripping_hz() * WINDOW_S)
    assert 0.05 < expected < 0.1
    error = math.sqrt(expected * (1.0 - expected) / beams)
    assert abs(is_sky_point(cloud).sum() / beams - expected) < SIGMAS * error + 1e-4
    says("gallery.md", "an oncoming car sends {} pulses a second", RATE_HZ)
    says("gallery.md", "{} % of the beams into the sky have a false point", 100.0 * expected)


def test_false_points_know_nothing_of_our_clock(frame):
    """Their times are those of the first arrival of a Poisson process within the window. Kolmogorov and Smirnov, one in
    10 000 fails.
    """
    cloud, *_ = frame
    nu = tripping_hz() * WINDOW_S / WINDOW_M

    def before(r):
        return -np.expm1(-nu * r) / -np.expm1(-nu * WINDOW_M)

    assert kstest(cloud.range_m[is_sky_point(cloud)], before).pvalue > 1e-4


def test_false_points_are_elsewhere_in_the_next_frame(frame, simulator):
    """Beams with one in two frames: as many as two independent shares have in common."""
    next_cloud, outcomes, _ = render_all(simulator(), seed=1)
    beams = np.sum(outcomes == Outcome.NO_SURFACE)
    first, second = (
        set(
            zip(
                cloud.azimuth_rad[is_sky_point(cloud)].tolist(),
                cloud.elevation_rad[is_sky_point(cloud)].tolist(),
                strict=True,
            )
        )
        for cloud in (frame[0], next_cloud)
    )
    expected = len(first) * len(second) / beams
    assert abs(len(first & second) - expected) < SIGMAS * math.sqrt(expected)


def test_echoes_that_come_after_a_false_point_are_hidden(frame):
    """Each with 1 - exp(-nu q 2 R / c). Tolerance: counting, and 1e-7 of noise before an echo at 50 m."""
    cloud, outcomes, _ = frame
    echoes = np.asarray(cloud.status) == Status.ECHO
    before = tripping_hz() * 2.0 * cloud.true_range_m[echoes] / c
    expected = np.sum(np.expm1(before))  # of so many that are seen
    hidden = np.sum(outcomes == Outcome.HIDDEN)
    assert expected > 50
    assert abs(hidden - expected) < SIGMAS * math.sqrt(expected)


def test_headlights_in_the_ambient_counts(frame, simulator):
    """Soil sends back E rho / pi; the lens takes pi phi^2 r_A^2 pi of it, at any angle and range. By hand in counts.

    Without lamps only the dark current counts. Tolerance: Poisson, and 1 % of the field of view, tan for the angle.
    """
    _, _, counts = frame
    dark = render_all(simulator(lamps_w_m2=0.0), seed=0)[2]
    lanes = []
    cloud = simulator(interferers=()).render(points=lambda pulse, surfaces: lanes.append((pulse, surfaces)))
    soil = cloud.material == cloud.material_names.index("soil")
    pulses = np.concatenate([pulse for pulse, _ in lanes])[soil]
    field = math.atan(0.1 / 30.0)
    power_w = 0.01 * 0.2424 / math.pi * table_1.A * math.pi * field**2 * table_1.ETA_RS
    expected = power_w * table_1.QE / table_1.HNU * WINDOW_S
    gained = counts[pulses].astype(float).mean() - dark[pulses].astype(float).mean()
    error = math.sqrt((counts[pulses].mean() + dark[pulses].mean()) / len(pulses))
    assert abs(gained - expected) < SIGMAS * error + 0.01 * expected
