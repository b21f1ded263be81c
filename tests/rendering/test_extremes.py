"""A frame with NaN is one line that names the most extreme input."""

import dataclasses
import math

import pytest
from helpers import chain
from helpers.mistakes import told
from helpers.run_seed import chosen

import lidarscene
from lidarscene.rendering.extremes import not_a_number
from lidarscene.scene.scene import Air, Scene

COARSE = ("scanner.azimuth_step_deg=2", "scanner.elevation_step_deg=2")


def with_part_changed(sensor, part, **values):
    return dataclasses.replace(sensor, **{part: dataclasses.replace(getattr(sensor, part), **values)})


@pytest.mark.parametrize(
    ("part", "field", "value", "extreme_input"),
    [
        ("optics", "focal_length_m", 1e-25, "optics.focal_length_mm = 1e-22"),
        ("detector", "gain", 1e25, "detector.gain = 1e+25"),
        ("optics", "sun_irradiance_w_m2", math.nan, "optics.sun_irradiance_w_m2 = nan"),
    ],
)
def test_a_frame_of_nan_names_the_extreme_input(mi, part, field, value, extreme_input):
    """Files refuse such numbers by their bounds; sensors that are made in Python have none."""
    scene = chain.scene(chain.facing(range_m=20.0))
    sensor = with_part_changed(chain.sensor("table1-apd", *COARSE), part, **{field: value})
    for call in (lidarscene.render, lambda *arguments: lidarscene.Simulator(*arguments).stream(lambda _: None)):
        with told(f"25 pulses | {extreme_input}"):
            call(scene, sensor)


@pytest.mark.parametrize(
    "name", chosen(3, ["table1-apd", "hdl-64e", "livox-avia", "mems-1550", "os1-128", "sony-spad-189x600"])
)
def test_what_is_farthest_from_usual_is_named(name):
    sensor = chain.sensor(name)
    cases = {
        "laser.pulse_fwhm_ns = 1e-12": ("laser", "pulse_fwhm_s", 1e-21),
        "laser.peak_power_w = 1e+12": ("laser", "peak_power_w", 1e12),
        "optics.aperture_radius_mm = nan": ("optics", "aperture_radius_m", math.nan),
    }
    for extreme_input, (part, field, value) in cases.items():
        line = str(not_a_number(Scene(), with_part_changed(sensor, part, **{field: value}), "snr: NaN"))
        assert line.endswith(f"snr: NaN; the most extreme input is {extreme_input}")
    assert "air.extinction_per_m = 1e+30" in str(
        not_a_number(Scene(air=Air(extinction_per_m=1e30)), sensor, "snr: NaN")
    )
