"""Undetermined directions are found, and are right."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lidarscene.physics.optics import receiver
from lidarscene.physics.photon_counting import matched_filter
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.fit.near_field import share
from lidarscene.studies.fit.products import (
    KEYS,
    QUANTITIES,
    find_products,
    scatter_c_mm,
    scatter_over_sigma,
    width_of_place,
)

ALL = tuple(QUANTITIES)


def test_photons_of_a_white_wall_are_one_product() -> None:
    """K = P0 tau r_A^2 eta pde shots, its exponents from the lidar equation."""
    products = find_products(load_sensor("os1-128"), ALL)
    powers = dict(zip(products.keys, products.exponents[products.quantities.index("white_m2")], strict=True))
    expected = {
        "laser.peak_power_w": 1,
        "laser.pulse_fwhm_ns": 1,
        "optics.aperture_radius_mm": 2,
        "optics.efficiency_laser": 1,
        "detector.pde": 1,
        "histogram.shots": 1,
        "reflectivity of all targets": 1,
    }
    for key, power in powers.items():
        # The shadow of the dark counts and the few SPADs that fire twice are left: 0.1 %; of the near field, which
        # r_A f / r_PD moves, 1.3 %.
        moves_near_field = any(word in key for word in ("aperture", "focal", "detector.radius"))
        assert power == pytest.approx(expected.get(key, 0), abs=0.02 if moves_near_field else 5e-3)
    assert "detector.pde" in products.product("white_m2")


def test_along_a_null_direction_nothing_changes() -> None:
    """Rationale: a direction is named only if it leaves every measured quantity as it is, to first order."""
    sensor = load_sensor("os2-128")
    products = find_products(sensor, ALL)
    assert len(products.null) == len(products.keys) - np.linalg.matrix_rank(products.exponents)
    parts = {key: (part, field) for key, part, field in KEYS}
    for line in products.null:
        key, _, moves = line.partition(" +1 %: ")
        if key not in parts:
            continue
        changes = {key: 1.0} | {
            name: float(power) for name, power in (term.rsplit(" ", 1)[0].rsplit(" ", 1) for term in moves.split(", "))
        }
        moved = sensor
        for name, percent in changes.items():
            part, field = parts[name]
            component = getattr(moved, part)
            changed = replace(component, **{field: getattr(component, field) * math.exp(0.01 * percent)})
            moved = replace(moved, **{part: changed})
        for quantity in QUANTITIES.values():
            assert quantity(moved) == pytest.approx(quantity(sensor), rel=2e-4)


def test_without_the_scatter_the_pulse_is_not_told_from_the_power() -> None:
    with_it = find_products(load_sensor("os1-128"), ALL)
    without = find_products(load_sensor("os1-128"), [name for name in ALL if name != "scatter_c"])
    assert not any(line.startswith("laser.pulse_fwhm_ns") for line in with_it.null)
    assert "laser.pulse_fwhm_ns +1 %: laser.peak_power_w -1 %" in without.null
    assert "laser.pulse_fwhm_ns" in without.fixed


def test_the_share_is_that_of_the_receiver() -> None:
    """Compared with the sum over the spot, whose error is 5e-5; and (R / R0)^2 of a point, within 1 %."""
    ratio = np.geomspace(0.1, 20.0, 40)
    for spot in (0.2, 0.6, 1.5):
        spot_share = receiver.spot_share(
            profile="gaussian", spot_rad=spot, off_axis_rad=0.0 * ratio, field_rad=1.0, blur_rad=1.0 / ratio
        )
        np.testing.assert_allclose(share(ratio, spot), spot_share / -np.expm1(-2.0 / spot**2), rtol=1e-4)
    np.testing.assert_allclose(share(np.array([0.1, 0.3, 5.0]), 0.1), [0.01, 0.09, 1.0], rtol=0.01)


def test_scatter_of_the_filters_peak() -> None:
    """Measured by drawing photons: 4000 echoes of 400, the filter's peak by its slope's zero; sigma good to 1.1 %, 4 of
    them.
    """
    random = np.random.default_rng(0)
    width, photons = 1.2, 400
    times = random.standard_normal((4000, photons))
    place = np.zeros(4000)
    for _ in range(20):
        weight = np.exp(-0.5 * ((times - place[:, None]) / width) ** 2)
        place = np.sum(weight * times, axis=1) / np.sum(weight, axis=1)
    assert np.std(place) * math.sqrt(photons) == pytest.approx(scatter_over_sigma(width), rel=0.045)


def test_ranges_scatter_hardly_more_than_photons_allow() -> None:
    """Cramer's and Rao's bound of S photons of a Gaussian pulse is c / 2 sigma / sqrt(S), and the filter's loss is a
    few per cent; jitter and bin add to the pulse's sigma in squares.
    """
    for name in ("os0-128", "os1-128", "os2-128"):
        sensor = load_sensor(name)
        assert sensor.histogram is not None
        pulse_s = float(sensor.laser.pulse_fwhm_s) / (2.0 * math.sqrt(2.0 * math.log(2.0)))
        blur_s = math.hypot(sensor.detector.jitter_s, sensor.histogram.bin_s / math.sqrt(12.0))
        bound_mm = 0.5e3 * 299_792_458.0 * math.hypot(pulse_s, blur_s)
        assert bound_mm < scatter_c_mm(sensor) < 1.2 * bound_mm


def test_a_bin_makes_the_filter_wider() -> None:
    """A slope over two bins is that of a template convolved with a box of two bins: variance (2 b)^2 / 12 more."""
    for ratio in (0.2, 0.6):
        box = 2.0 * ratio * ((np.arange(10_000) + 0.5) / 10_000 - 0.5)
        wider = math.sqrt(matched_filter.TEMPLATE**2 + np.mean(box**2))
        assert width_of_place(1.0, ratio) == pytest.approx(wider, rel=1e-6)


def test_the_scale_of_reflectivities_is_no_key_of_the_file() -> None:
    """Where photons of a white wall are not known it is free, and nothing of the file is held for it."""
    products = find_products(load_sensor("os1-128"), ["scatter_c"])
    assert "reflectivity of all targets: alone" in products.null
    assert "reflectivity of all targets" not in products.fixed
    assert "laser.peak_power_w" in products.fixed
