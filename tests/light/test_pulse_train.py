"""Rays and paths of a pulse together, of which all numbers differ: by hand."""

import numpy as np
import pytest
from helpers import drops, trains

from lidarscene.light.air_light import AirLight, air_light
from lidarscene.light.beams import Beams
from lidarscene.light.echoes import Ambient, Echoes
from lidarscene.light.footprint import Skirt
from lidarscene.light.pulse_train import LitAir, join_echoes
from lidarscene.maths.arrays import LookupTable
from lidarscene.scene.weather import Weather

RAYS, PULSES = 4, 2
LANES = np.arange(RAYS * PULSES, dtype=float)
BEAMS = Beams(
    pulse=np.repeat(np.arange(PULSES, dtype=np.uint32), RAYS),
    origin_m=(0.0, 0.0, 0.0),
    direction=(np.ones(8), np.zeros(8), np.zeros(8)),
    aperture_m2=np.repeat([2e-3, 3e-3], RAYS),
)
MET = np.array([True, True, False, True, False, False, False, True])
RANGES = np.array([20.0, 30.0, 1.0, 90.0, 1.0, 1.0, 1.0, 40.0])


def paths():
    """Straight on, where some rays meet a surface, and off a mirror, where one of the second pulse does."""
    first = Echoes(
        has_surface=MET,
        range_m=RANGES,
        peak_power_w=np.where(MET, 1e-6 * (1.0 + LANES), 0.0),
        background_power_w=1e-8 * (1.0 + LANES),
        white_w_m2=np.repeat([5.0, 6.0], RAYS),
    )
    second = Echoes(
        has_surface=LANES == 5.0,
        range_m=np.where(LANES == 5.0, 55.0, 1.0),
        peak_power_w=np.where(LANES == 5.0, 7e-6, 0.0),
        background_power_w=np.zeros(8),
    )
    return [first, second]


@pytest.mark.parametrize("halo", [False, True])
def test_a_pulse_is_the_weighted_sum_of_its_rays(halo):
    """Two of four rays are a halo's, with 0.3 of the power: 0.35 each of the core's and 0.15 of the others."""
    skirt = Skirt(count=2, share=0.3, slope=0.01) if halo else None
    weight = np.array([0.35, 0.35, 0.15, 0.15] if halo else [0.25] * 4)
    train = join_echoes(paths(), BEAMS, rays=RAYS, skirt=skirt)
    assert train.surfaces == 2 * RAYS
    for part, path in zip(train.parts, paths(), strict=True):
        np.testing.assert_allclose(part.peak_power_w, path.peak_power_w * np.tile(weight, PULSES))
        assert part.count == RAYS
    background = paths()[0].background_power_w.reshape(PULSES, RAYS)
    np.testing.assert_allclose(train.background_power_w, background @ weight)
    np.testing.assert_array_equal(train.has_surface, [True, True])
    np.testing.assert_array_equal(train.white_w_m2, [5.0, 6.0])
    missed = [Echoes(has_surface=MET & False, range_m=LANES + 1.0, peak_power_w=0.0 * LANES, background_power_w=LANES)]
    assert not join_echoes(missed, BEAMS, rays=RAYS).has_surface.any()


@pytest.mark.parametrize(
    ("halo", "edges_m", "ends_m"),
    [
        (False, [[20.0, 30.0, 150.0, 90.0], [150.0, 150.0, 150.0, 40.0]], [150.0, 150.0]),
        (True, [[20.0, 30.0], [150.0, 150.0]], [30.0, 150.0]),
    ],
)
def test_air_ends_where_the_rays_of_the_core_do(halo, edges_m, ends_m):
    """A ray that meets nothing lights the air to its end; a halo's do not count. The scale is P_t eta A tau^2.

    Behind the nearest end the light that stays has the rays' mean of 1 / R, the energy of thin air; a lone ray of four
    that ends takes a fourth with it.
    """
    equipped = trains.sensor("table1-apd", "optics.efficiency_laser=0.5")
    light = AirLight(
        shape=LookupTable(np.array([1.0, 0.0])),
        near_m=0.0,
        far_m=150.0,
        hump_m=(0.0, 1.0),
        extinction_per_m=0.01,
        highest=None,
        particles=(),
        names=("fog",),
        strongest="fog",
    )
    ambient = Ambient(sun_irradiance_w_m2=0.0, sky_irradiance_w_m2=0.0, transmittance=0.8, extinction_per_m=0.01)
    pulse = np.arange(PULSES, dtype=np.uint32)
    air = LitAir(light=light, sensor=equipped, ambient=ambient, seed=1, pulse=pulse)
    skirt = Skirt(count=2, share=0.3, slope=0.01) if halo else None
    volume = join_echoes(paths(), BEAMS, rays=RAYS, skirt=skirt, air=air).volume
    np.testing.assert_array_equal(volume.end_m, ends_m)
    near_m, share = volume.edge
    np.testing.assert_array_equal(near_m, np.min(edges_m, axis=1))
    np.testing.assert_allclose(share / near_m + (1.0 - share) / ends_m, np.mean(1.0 / np.array(edges_m), axis=1))
    assert share[1] == pytest.approx(0.0 if halo else 0.25)
    np.testing.assert_allclose(volume.scale, 45.0 * 0.5 * 0.8**2 * np.array([2e-3, 3e-3]))


def test_a_drop_before_a_slope_is_as_long_as_the_pulse(monkeypatch):
    """A slope of 30 m makes echoes three times as long, but not those of pulses that a brighter drop returns."""
    drops.as_bright_as_their_faces(monkeypatch)
    equipped = trains.sensor("table1-apd", "laser.divergence_mrad=3")
    light = air_light(Weather(rain_mm_h=20.0), equipped, extinction_per_m=0.003)
    ambient = Ambient(sun_irradiance_w_m2=0.0, sky_irradiance_w_m2=0.0, transmittance=1.0, extinction_per_m=0.003)
    pulse = np.arange(200, dtype=np.uint32)
    air = LitAir(light=light, sensor=equipped, ambient=ambient, seed=1, pulse=pulse)
    ones = np.ones(len(pulse))
    slope = Echoes(
        has_surface=ones > 0.0,
        range_m=30.0 * ones,
        peak_power_w=np.geomspace(1e-9, 1e-6, len(pulse)),
        background_power_w=ones,
        broadening=3.0 * ones,
    )
    beams = Beams(pulse=pulse, origin_m=(0.0, 0.0, 0.0), direction=(1.0, 0.0, 0.0), aperture_m2=2e-3)
    train = join_echoes([slope], beams, rays=1, air=air)
    brightest_w = np.max([part.peak_power_w for part in train.parts[1:]], axis=0)
    before = brightest_w > slope.peak_power_w
    assert 20 < before.sum() < 180
    np.testing.assert_array_equal(train.broadening, np.where(before, 1.0, 3.0))
