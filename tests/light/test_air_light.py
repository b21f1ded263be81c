"""Light of the air as a sensor has it: how far, which beam, which drops, and what an AC-coupled amplifier leaves."""

import dataclasses
import math

import numpy as np
import pytest
from helpers import drops, trains
from scipy.constants import c
from scipy.stats import norm

from lidarscene.light.air_light import air_light, overlap_of
from lidarscene.physics.weather import glory, soft_target
from lidarscene.scene.weather import Weather

RAIN = Weather(rain_mm_h=20.0)
BEAM = (
    "laser.divergence_mrad=3",
    "laser.divergence_elevation_mrad=1",
    "laser.exit_diameter_mm=10",
    "tdc.window_us=0.5",
)


def lit_air(weather, *overrides, name="table1-apd"):
    """A sensor and the air's light as it has it."""
    equipped = trains.sensor(name, *overrides)
    extinction = weather.extinction_at_per_m(equipped.laser.wavelength_m)
    return equipped, air_light(weather, equipped, extinction_per_m=extinction), extinction


def test_the_air_ends_with_the_window():
    """R = c t / 2; clear air has no light."""
    equipped, air, _ = lit_air(trains.FOG, "tdc.window_us=0.5")
    assert air.far_m == pytest.approx(0.5 * c * 0.5e-6)
    assert air_light(Weather(), equipped, extinction_per_m=0.0) is None


def test_even_light_far_from_the_lens_is_the_soft_targets():
    """1.0645 (c FWHM / 2) beta exp(-2 alpha R) / R^2: to how much fog bends over a pulse's length."""
    equipped, air, extinction = lit_air(trains.FOG)
    (medium,) = trains.FOG.media(equipped.laser.wavelength_m)
    range_m = np.array([30.0, 60.0])
    length_m = soft_target.pulse_length_m(fwhm_s=trains.FWHM_S) * math.sqrt(math.pi / (4.0 * math.log(2.0)))
    expected = length_m * medium.backscatter_per_m_sr * np.exp(-2.0 * extinction * range_m) / range_m**2
    share = np.asarray(air.shape.at((range_m - air.near_m) / (air.far_m - air.near_m)))
    np.testing.assert_allclose(share, expected, rtol=0.02)


def test_fog_behind_a_high_pass():
    """The course of a coupled amplifier is that of a coupled-free one behind s - k * s, k = omega exp(-omega t), over
    what of a lone peak passes; by small steps, to 2 % of its top.
    """
    _, plain, _ = lit_air(trains.FOG)
    equipped, coupled, _ = lit_air(trains.FOG, "receiver.ac_coupling_khz=5000")
    grid = np.linspace(plain.near_m, plain.far_m, len(plain.shape.values))
    time = (grid - grid[0]) * 2.0 / c
    decay = math.exp(-2.0 * math.pi * 5e6 * (time[1] - time[0]))
    slow_part, values = 0.0, np.array(plain.shape.values)
    passed = np.zeros_like(values)
    for k in range(1, len(values)):
        slow_part = decay * slow_part + (1.0 - decay) * 0.5 * (values[k] + values[k - 1])
        passed[k] = values[k] - slow_part
    passed /= float(equipped.peak_share)
    assert float(equipped.peak_share) < 0.92
    np.testing.assert_allclose(coupled.shape.values, passed, atol=0.02 * passed.max())
    assert coupled.hump_m == plain.hump_m


def test_drops_are_lit_before_the_surface_only(monkeypatch):
    """None is lit behind the pulse's end. Two kinds of particles have places of their own.

    Behind an edge that takes 0.3 of the light 0.7 are lit, at 6e-7.
    """
    drops.as_bright_as_their_faces(monkeypatch)
    pulse = np.arange(4000, dtype=np.uint32)
    _, air, _ = lit_air(RAIN, *BEAM)
    ((tables, name),) = air.particles
    assert name == "rain"
    assert air.sources == ("rain",) * tables.count
    end_m = np.full(len(pulse), 8.0)
    lanes = {"scale": np.ones(len(pulse)), "end_m": end_m, "seed": 3, "pulse": pulse}
    drop_echoes = air.sub_echoes(**lanes)
    ranges, powers = (np.stack([getattr(echo, key) for echo in drop_echoes]) for key in ("range_m", "peak_power_w"))
    assert (ranges > 8.0).mean() > 0.01
    assert (powers[ranges > 8.0] == 0.0).all()
    assert (powers[ranges < 8.0] > 0.0).mean() > 0.3
    edge = np.full(len(pulse), 4.0), np.full(len(pulse), 0.3)
    parted = np.stack([echo.peak_power_w for echo in air.sub_echoes(**lanes, edge=edge)])
    np.testing.assert_array_equal(parted[ranges < 4.0], powers[ranges < 4.0])
    behind = parted[(ranges > 4.0) & (powers > 0.0)] > 0.0
    assert abs(behind.mean() - 0.7) < 5.0 * np.sqrt(0.3 * 0.7 / len(behind))
    twice = dataclasses.replace(air, particles=((tables, "rain"), (tables, "snow")))
    first, second = np.split(np.stack([echo.range_m for echo in twice.sub_echoes(**lanes)]), 2)
    np.testing.assert_array_equal(first, ranges)
    assert not (first == second).any()


def test_what_is_drawn_and_what_is_even_are_the_whole_rain(monkeypatch):
    """Mean light of drops of each range, over many pulses, with that which is left: the backscatter of all rain, in a
    beam whose cross-section is an ellipse. Nothing is drawn that is weaker than 0.27 of what trips alone.
    """
    drops.as_bright_as_their_faces(monkeypatch)
    equipped, air, extinction = lit_air(RAIN, *BEAM)
    ((tables, _),) = air.particles
    (medium,) = RAIN.media(equipped.laser.wavelength_m)
    point = equipped.working_point(np.zeros(1))
    sent = 45.0 * float(equipped.optics.efficiency_laser) * float(equipped.optics.aperture_m2)
    least = float(np.ravel(point.response.power_w(equipped.threshold(point)))[0]) / sent
    weakest = math.exp(float(tables.log_strength.values[-1]))
    # The count is limited to 32; within it the cut is at that share, as exactly as a table of 1500 strengths says.
    assert tables.count == 32 or weakest == pytest.approx(0.27 * least, rel=1e-2)
    pulse = np.arange(60_000, dtype=np.uint32)
    lanes = {"scale": np.ones(len(pulse)), "end_m": np.full(len(pulse), 1e3), "seed": 3, "pulse": pulse}
    drawn = air.sub_echoes(**lanes)
    low, high = 3.0, 12.0
    light = sum(
        np.where((echo.range_m > low) & (echo.range_m < high), echo.peak_power_w * echo.range_m**2, 0.0)
        for echo in drawn
    )
    range_m = np.linspace(low, high, 2001)
    weight = np.asarray(overlap_of(equipped).share(range_m)) * np.exp(-2.0 * extinction * range_m)
    drawn_beta = medium.backscatter_per_m_sr - tables.weak_backscatter_per_m_sr(range_m)
    expected = np.trapezoid(weight * drawn_beta, range_m)
    assert expected > 0.02 * np.trapezoid(weight * medium.backscatter_per_m_sr, range_m)
    remaining = np.asarray(air.shape.at((range_m[::100] - air.near_m) / (air.far_m - air.near_m)))
    length_m = soft_target.pulse_length_m(fwhm_s=trains.FWHM_S) * math.sqrt(math.pi / (4.0 * math.log(2.0)))
    even = length_m * (weight * tables.weak_backscatter_per_m_sr(range_m) / range_m**2)[::100]
    np.testing.assert_allclose(remaining, even, rtol=0.1)  # it bends over the pulse's length, most of all near the lens
    error = light.std() / math.sqrt(len(pulse))
    assert abs(light.mean() - expected) < 5.0 * error + 0.02 * expected


@pytest.mark.parametrize(
    ("name", "overrides", "above", "slopes", "sweep_rad"),
    [
        ("table1-apd", BEAM, 20.0, (1.5e-3, 0.5e-3), 0.0),
        ("os1-128", (), 1.2, (2.65e-3, 2.65e-3), 2.0 * math.pi * 10.0 * 27 * 1.8e-6),
    ],
)
def test_as_many_drops_as_the_beam_holds(monkeypatch, name, overrides, above, slopes, sweep_rad):
    """Drops of 4 to 10 m that are stronger than a level: their mean number is int n S dR, S = pi w_1 w_2 the beam's
    cross-section by its two divergences and the turn of its head, whose variance is a twelfth of its square, n of the
    drops from the size on whose echo there is as strong. At 1e-6.
    """
    drops.as_bright_as_their_faces(monkeypatch)
    equipped, air, extinction = lit_air(RAIN, *overrides, name=name)
    ((tables, _),) = air.particles
    (medium,) = RAIN.media(equipped.laser.wavelength_m)
    level = above * math.exp(float(tables.log_strength.values[-1]))
    pulse = np.arange(60_000, dtype=np.uint32)
    lanes = {"scale": np.ones(len(pulse)), "end_m": np.full(len(pulse), 1e3), "seed": 5, "pulse": pulse}
    counted = sum(
        int(((echo.range_m > 4.0) & (echo.range_m < 10.0) & (echo.peak_power_w > level)).sum())
        for echo in air.sub_echoes(**lanes)
    )
    range_m, diameter_m = np.linspace(4.0, 10.0, 601), np.linspace(0.0, 15e-3, 6001)
    first, second = (np.hypot(5e-3, slope * range_m) for slope in slopes)
    area = math.pi * np.hypot(first, 2.0 * math.sqrt(1.0 / 12.0) * sweep_rad * range_m) * second
    share = np.asarray(overlap_of(equipped).share(range_m))
    needed = level * area * range_m**2 / (share * np.exp(-2.0 * extinction * range_m))
    sigma = np.asarray(medium.particle_m2_sr(diameter_m=diameter_m))
    at_least = np.interp(needed, sigma, diameter_m)
    per_m3 = medium.sizes.intercept_per_m4 / medium.sizes.slope_per_m * np.exp(-medium.sizes.slope_per_m * at_least)
    expected = len(pulse) * np.trapezoid(per_m3 * area, range_m)
    assert expected > 500.0
    assert abs(counted - expected) < norm.isf(0.5e-6) * math.sqrt(expected) + 0.01 * expected  # the table's steps


def test_drops_are_seen_by_a_lens_that_stands_beside_the_laser(monkeypatch):
    """The lens reaches from its near edge to the far one: 35 and 85 mm of one with 25 mm of radius, 60 mm off."""
    ratios = []

    def gain(*, diameter_m, within_rad, from_rad=0.0, **_):
        ratios.append(float(np.median(from_rad / within_rad)))
        return np.ones_like(diameter_m * within_rad)

    monkeypatch.setattr(glory, "gain", gain)
    lit_air(RAIN, *BEAM, "optics.overlap.transmitter_offset_mm=[60, 0]")
    assert ratios
    np.testing.assert_allclose(ratios, 35.0 / 85.0)
    ratios.clear()
    lit_air(RAIN, *BEAM, "optics.overlap.transmitter_offset_mm=[0, 0]")
    np.testing.assert_array_equal(ratios, 0.0)
