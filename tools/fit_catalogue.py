#!/usr/bin/env python3
"""Fit sensors of the catalogue to the ranges that their makers publish, and write the numbers into their files.

`tools/fit_catalogue.py NAME...` first sets the threshold, then the laser's power and what else `published.unknowns`
names, with the interval of each in `[sources]`. Run again, it changes nothing.
"""

import math
import sys
import tempfile
from pathlib import Path

from lidarscene import catalog
from lidarscene.files.toml_edit import put_values
from lidarscene.sensor.readout import PublishedFile
from lidarscene.sensor.sensor_file import load_sensor, published_performance
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.fit.published_fit import POWER, FittedNumber, fit_published
from lidarscene.studies.ranging import statistics
from lidarscene.studies.ranging.plane import Target

FALSE_POINTS = 1e-4
"""Source: Livox (Mid-40, Mid-360, HAP) and Ouster (OS1), 0.01 % at 100 klux: most false points of a pulse."""

ASSUMED = {
    "detector.circuit_noise_na": "an amplifier of 5 pA per root hertz",
    "optics.sun_irradiance_w_m2": "ASTM G173 global at 100 klux through a box of 20 nm; stands for filter and field of "
    "view together",
}
"""Key -> what the value in `published.unknowns` is of."""

DIGITS = 4


def fitted_text(text: str, name: str, folder: Path) -> str:
    """Text of a sensor file with its threshold and its unknowns fitted; ``folder`` takes the files in between."""
    path = folder / f"{name}.toml"
    before = ""
    while text != before:
        before = text
        path.write_text(text, encoding="utf-8")
        sensor, published = load_sensor(str(path)), published_performance(str(path))
        assert published is not None
        if sensor.tdc.threshold_to_noise is not None:
            threshold = least_threshold(sensor, published.illuminance_klux or 0.0)
            text = put_values(text, {("tdc", "threshold_to_noise"): threshold})
        path.write_text(text, encoding="utf-8")
        for number in fit_published(str(path)):
            text = put_values(text, {tuple(number.key.split(".")): number.value}, digits=DIGITS)
            text = put_values(text, {("sources", number.key): source(number, published)})
    return text


def least_threshold(sensor: Sensor, klux: float) -> float:
    """Least threshold over the noise, in tenths, with no more than `FALSE_POINTS` in the light of a 10 % target."""
    target = Target(reflectivity=0.1, illuminance_klux=klux)
    for tenths in range(30, 200):
        changed = sensor.replace({"tdc.threshold_to_noise": 0.1 * tenths})
        if statistics.false_points(changed, target, math.inf).per_pulse <= FALSE_POINTS:
            return round(0.1 * tenths, 1)
    raise SystemExit(f"{sensor.name}: no threshold up to 20 sigma has so few false points")


def source(number: FittedNumber, published: PublishedFile) -> str:
    """What a fitted number rests on, for `[sources]`."""
    if number.key == POWER:
        day = ((published.reflectivity, published.range_m), *published.also)
        notes = [f"{key} assumed" for key in ("reflectivity", "illuminance_klux") if key in published.assumed]
        light = f"{published.illuminance_klux:g} klux" + (f" ({', '.join(notes)})" if notes else "")
        night = f"; {ranges_text(published.dark)} without light" if published.dark else ""
        where = "the peak signal is at the threshold there (P_d of a half), sun at 60 degrees to the target's normal"
        return f"fitted: {ranges_text(day)}, {light}{night}: {where}, air 0.98; {number}"
    value, factor = published.unknowns[number.key]
    word = "fitted, with the power" if number.is_determined else "assumed"
    return f"{word}: {number}; before the ranges {value:g}, or {factor:g} times less or more: {ASSUMED[number.key]}"


def ranges_text(pairs: tuple[tuple[float | None, float | None], ...]) -> str:
    """Pairs of reflectivity and range in words."""
    return ", ".join(f"{range_m:g} m at {100.0 * (share or 0.0):.3g} %" for share, range_m in pairs)


def main() -> None:
    """Fit the sensors that are named."""
    for name in sys.argv[1:]:
        file = catalog.path_of("sensors", name)
        with tempfile.TemporaryDirectory() as folder:
            text = fitted_text(file.read_text(encoding="utf-8"), name, Path(folder))
        file.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
