"""The fog scene: where fog trips the comparator, what it hides while it holds it, and how dim things are behind."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.documentation import says
from scipy.constants import c

from lidarscene import Simulator, load_scene, load_sensor
from lidarscene.detection.outcomes import Status
from lidarscene.physics.electronics import tdc
from lidarscene.physics.optics import receiver
from lidarscene.physics.weather import fog
from lidarscene.scene.weather import Weather

pytestmark = pytest.mark.usefixtures("mi")

SCENE = Path(__file__).parents[2] / "scenes" / "fog.toml"
POWER_W, LENS_M2, EFFICIENCY, FWHM_M = 75.0, math.pi * 0.012**2, 0.72, 0.5 * c * 5e-9

SKY_W = 29.4 * 0.1 * 0.5 * LENS_M2 * (0.1 / 24.0) ** 2 * 0.8
BRIGHTEST_W = 3.0 * SKY_W
"""10 klux of sun and half of it from the sky: radiance over lens and field of view; of a white surface in both."""


@pytest.fixture(scope="module")
def rendered():
    """Function of overrides of the sensor, of a seed, and of air if not the scene's: a frame of the scene."""
    scene = load_scene(SCENE)
    world = Simulator(scene).world

    def frame(*overrides, seed=0, air=scene.air):
        sensor = load_sensor(scene.sensor_name, overrides=overrides)
        return Simulator(replace(scene, air=air), sensor, world=world).render(seed=seed)

    return frame


@pytest.fixture(scope="module")
def clouds(rendered):
    return rendered(), rendered(air=replace(load_scene(SCENE).air, weather=Weather()))


def coefficients():
    """Extinction and backscatter at 905 nm: those of the droplets, as many as 120 m of visibility ask for."""
    droplets = fog.TYPES["moderate_advection"]
    alpha, beta = fog.scattering(droplets, 905e-9)
    more = 3.912 / 120.0 / fog.scattering(droplets, 550e-9)[0]
    return more * alpha, more * beta


@cache
def fog_light():
    """(range, power) of what the pulse meets of the fog, at the time of each range; the sum over its width."""
    alpha, beta = coefficients()
    r = np.linspace(2.5, 60.0, 6000)
    share = receiver.spot_share(
        profile="top_hat",
        spot_rad=np.hypot(2.5e-3 / r, 1e-3),
        off_axis_rad=0.03 / r,
        field_rad=0.1 / 24.0,
        blur_rad=0.012 / r,
    )
    light = POWER_W * EFFICIENCY * LENS_M2 * beta * share * np.exp(-2.0 * alpha * r) / r**2
    range_m = np.linspace(2.0, 50.0, 1021)
    pulse = np.exp(-4.0 * math.log(2.0) * ((range_m[:, None] - r) / FWHM_M) ** 2)
    return range_m, pulse @ light * (r[1] - r[0])


def lit_span_m(*, background_w, above=1.0):
    """Nearest and farthest place where the fog's light is over the threshold, or over so many of it."""
    sensor = load_sensor("biaxial-905")
    point = sensor.working_point(np.array([background_w]))
    range_m, power_w = fog_light()
    crossing_m = range_m[power_w > above * float(point.response.power_w(sensor.threshold(point))[0])]
    return crossing_m.min(), crossing_m.max()


def crossing_range_m(*, background_w, deviate):
    """Where the fog's light first trips the comparator, if its noise there is so many deviations."""
    sensor = load_sensor("biaxial-905")
    point = sensor.working_point(np.array([background_w]))
    level = tdc.crossing_level(
        threshold=sensor.threshold(point),
        noise=point.noise.deviation,
        kappa_1=point.noise.kappa_1,
        kappa_2=point.noise.kappa_2,
        deviate=np.array([deviate]),
    )
    range_m, power_w = fog_light()
    rise = slice(0, np.argmax(power_w) + 1)
    return np.interp(float(point.response.power_w(level)[0]), power_w[rise], range_m[rise])


def test_fog_trips_the_comparator_where_its_light_reaches_the_threshold(rendered):
    """Median of the raw crossings of the beams into the sky, whose background is known: as many come early as late.

    Tolerance: the grid here, 5 cm, and the tables of overlap and fog.
    """
    cloud = rendered("tdc.walk='raw'")
    fogged = np.asarray(cloud.status) == Status.WEATHER
    assert {cloud.class_names[i] for i in np.unique(cloud.class_id[fogged])} == {"fog"}
    sky = fogged & (cloud.elevation_rad > math.radians(8.0))
    assert sky.sum() > 10_000
    rises, _ = lit_span_m(background_w=SKY_W)
    assert np.median(cloud.range_m[sky]) == pytest.approx(rises, abs=0.07)


def test_nothing_is_seen_while_fog_holds_the_comparator(rendered, clouds):
    """An echo then makes no crossing: what is near is merged into the fog's own edge, which is a point of the fog,
    the next is seen where the light has fallen to the threshold.

    Noise of four sigma, four fifths of the threshold, may let go earlier (3e-5 of the beams, few of which have
    something just there). In clear air the car at 15 m is the one with the most points.
    """
    foggy, clear = clouds
    ranges = foggy.range_m[np.asarray(foggy.status) == Status.ECHO]
    earliest = lit_span_m(background_w=BRIGHTEST_W, above=1.8)[1]
    latest = lit_span_m(background_w=0.0)[1]
    assert 15.0 < earliest < latest < 30.0
    assert ranges.min() > earliest
    assert np.any(ranges < latest)
    assert points_of(clear, "cars.0") > 500
    assert points_of(foggy, "cars.0") == 0
    assert points_of(foggy, "cars.1") > 50
    says(
        "gallery.md",
        "the signal above the threshold up to {} to {} m, depending on the background",
        lit_span_m(background_w=BRIGHTEST_W)[1],
        latest,
    )
    fog = np.asarray(foggy.status) == Status.WEATHER
    assert fog.mean() > 0.9
    assert foggy.range_m[fog].min() > 3.5
    assert np.quantile(foggy.range_m[fog], 0.9995) < 5.5


def test_a_receiver_that_waits_for_the_last_pulse_sees_through_fog(rendered):
    """It looks for peaks: near bodies that rise out of the fog's light have points again."""
    cloud = rendered("tdc.stops=1", "tdc.keep='last'")
    assert points_of(cloud, "cars.0") > 900
    fogged = np.asarray(cloud.status) == Status.WEATHER
    assert 0.5 < fogged.mean() < 0.6


def test_no_two_beams_cross_fog_at_one_place(rendered):
    """Noise moves every crossing. Single precision has some 80,000 places in the 0.3 m in which 70,000 beams cross, so
    a few of them share one; a search that stops where it began puts all of them there.
    """
    cloud = rendered("laser.peak_power_w=1000", "laser.pulse_fwhm_ns=3", "tdc.walk='raw'")
    crossed = cloud.range_m[np.asarray(cloud.status) == Status.WEATHER]
    places, beams = np.unique(crossed, return_counts=True)
    assert len(crossed) > 50_000
    assert beams.max() < 15
    assert len(places) > 0.8 * len(crossed)


def points_of(cloud, name):
    echoes = np.asarray(cloud.status) == Status.ECHO
    return int(np.sum(echoes & (cloud.body == cloud.body_names.index(name))))


def test_a_point_is_of_what_tripped_the_comparator(clouds):
    """Fog trips it on every beam, also where the waveform rises on to the peak of the road at 9 m: 2642 such points
    were once the road's. The true range of a point of fog is where its light reached the threshold.

    Tolerances. Fog, lowest and highest of the crossings: noise of six deviations, which one of 13,000 frames exceeds on
    either side, and a background from none to the brightest. Surfaces: 1.5 pulse widths, 3.5 sigma_p. On
    top of fog that is just below the threshold an edge trips it from its foot on, where it has 0.2 % of its peak.
    """
    foggy, _ = clouds
    status = np.asarray(foggy.status)
    fogged, echoes = status == Status.WEATHER, status == Status.ECHO
    assert len(np.unique(foggy.time_s[fogged])) == fogged.sum() == load_sensor("biaxial-905").scanner.pulses
    assert foggy.true_range_m[fogged].min() > crossing_range_m(background_w=0.0, deviate=6.0)
    assert foggy.true_range_m[fogged].max() < crossing_range_m(background_w=BRIGHTEST_W, deviate=-6.0)
    assert np.abs(foggy.range_m - foggy.true_range_m)[echoes].max() < 1.5 * FWHM_M


def test_things_behind_are_dimmer_by_the_extinction(clouds):
    """Every echo that fog leaves at an SNR of 30 or more: exp(-2 alpha R) of what clear air gives.

    Tolerance: four standard errors (6e-5) and 2 %: the fog's own light there is up to a sigma of the noise.
    """
    foggy, clear = clouds
    alpha, _ = coefficients()
    thinned = np.exp(-2.0 * alpha * clear.true_range_m)
    bright = clear.snr * thinned > 30.0
    behind = (np.asarray(foggy.status) == Status.ECHO) & (foggy.range_m > 20.0)
    _, before, after = np.intersect1d(clear.time_s[bright], foggy.time_s[behind], return_indices=True)
    ratios = foggy.intensity[behind][after] / (clear.intensity * thinned)[bright][before]
    assert len(ratios) > 1000
    assert abs(np.mean(ratios) - 1.0) < 4.0 * np.std(ratios) / math.sqrt(len(ratios)) + 0.02
