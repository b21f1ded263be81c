"""Controls: sliders for a scene and a sensor, and the scene and sensor under their settings."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_type_hints

from ..errors import InputError, shorten
from ..maths import units
from ..scene.scene import Scene, Sun
from ..sensor.detectors import Detector
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor

DETECTOR = "detector"
"""Key of the choice of a detector; keys "detector.*" are those of the sensor file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Number that the page can change, with a slider and a box to type in.

    Attributes:
        key: key of the sensor file as --set takes it, or sun.*
        low: lower end of the slider
        high: upper end of the slider
        log: True for a logarithmic slider
        least: lower bound of a typed number
        most: upper bound of a typed number
        whole: True for a whole number
    """

    key: str
    label: str
    unit: str
    low: float
    high: float
    value: float
    log: bool = False
    least: float | None = None
    most: float | None = None
    whole: bool = False

    def check(self, value: float) -> None:
        """Raise InputError for a number out of bounds."""
        if self.whole and value != int(value):
            raise InputError(f"{self.key}: must be a whole number, got {value:g}")
        if self.least is not None and value < self.least:
            raise InputError(f"{self.key}: must be >= {self.least:g}, got {value:g}")
        if self.most is not None and value > self.most:
            raise InputError(f"{self.key}: must be <= {self.most:g}, got {value:g}")


Settings = Mapping[str, float | str]
"""Values by key; keys left out keep the value of the files."""


class Equipment:
    """Scene and sensor of the files, and the same under settings.

    The alternative detector is the APD or SiPM of Table 1, with what belongs to it.
    """

    def __init__(self, scene: Scene, sensor: str, overrides: Sequence[str] = ()) -> None:
        """``sensor`` is a catalogue name or a file.

        Raises:
            InputError: if a file, a key or a value cannot be understood
        """
        self.scene, self.name = scene, sensor
        self.sensor = load_sensor(sensor, overrides=overrides)
        own_kind = self.sensor.detector.label
        other_kind = "SiPM" if own_kind == "APD" else "APD"
        self.detectors = {f"{own_kind}, its own": "", f"{other_kind} of Table 1": f"table1-{other_kind.lower()}"}

    def with_settings(self, settings: Settings) -> tuple[Scene, Sensor]:
        """Scene and sensor under settings.

        Raises:
            InputError: for an unknown key or a number out of bounds
        """
        numbers = {key: number_of(key, value) for key, value in settings.items() if key != DETECTOR}
        donor_name = self.donor_name(settings)
        controls = {control.key: control for control in self._controls(donor_name)}
        if unknown := sorted(set(numbers) - set(controls)):
            raise InputError(f"{unknown[0]}: no such control; known here: {', '.join(controls)}")
        assigned = [f"{key}={value!r}" for key, value in numbers.items() if not key.startswith("sun.")]
        sensor = self._sensor(donor_name, assigned)
        angles = {key: numbers.get(f"sun.{key}", value) for key, value in _sun_values(self.scene.sun).items()}
        _check_sun(angles)
        sun = dataclasses.replace(
            self.scene.sun,
            azimuth_rad=math.radians(angles["azimuth_deg"]),
            elevation_rad=math.radians(angles["elevation_deg"]),
            illuminance_klux=angles["illuminance_klux"],
        )
        return dataclasses.replace(self.scene, sun=sun), sensor

    def controls(self, settings: Settings) -> list[Control]:
        """Sliders for the chosen detector, at the values of the files."""
        return self._controls(self.donor_name(settings))

    def donor_name(self, settings: Settings) -> str:
        """Catalogue name of the sensor whose detector is chosen; "" for the sensor's own.

        Raises:
            InputError: for a choice that is none
        """
        choice = settings.get(DETECTOR, next(iter(self.detectors)))
        if not isinstance(choice, str) or choice not in self.detectors:
            raise InputError(f"{DETECTOR}: must be one of {', '.join(self.detectors)}, got {choice}")
        return self.detectors[str(choice)]

    def _sensor(self, donor_name: str, assigned: Sequence[str]) -> Sensor:
        """Sensor with these assignments, and with the donor's detector if one is named."""
        donor = [f"{DETECTOR}={donor_name}"] if donor_name else []
        return self.sensor.replace([*donor, *assigned])

    def _controls(self, donor_name: str) -> list[Control]:
        """Sliders of sun, laser, optics, detector and threshold, for the detector of the donor if one is named."""
        sensor = self._sensor(donor_name, [])
        laser, optics, tdc = sensor.laser, sensor.optics, sensor.tdc
        sun = _sun_values(self.scene.sun)
        sliders = [
            Control(
                key="sun.azimuth_deg", label="sun azimuth", unit="°", low=-180.0, high=360.0, value=sun["azimuth_deg"]
            ),
            Control(
                key="sun.elevation_deg",
                label="sun elevation",
                unit="°",
                low=-10.0,
                high=90.0,
                value=sun["elevation_deg"],
            ),
            Control(
                key="sun.illuminance_klux",
                label="illuminance",
                unit="klux",
                low=0.01,
                high=130.0,
                value=sun["illuminance_klux"],
                log=True,
            ),
            _slider_around("laser.peak_power_w", "laser power", "W", laser.peak_power_w, 20.0),
            _slider_around("optics.aperture_radius_mm", "aperture radius", "mm", 1e3 * optics.aperture_radius_m, 5.0),
            *_detector_sliders(sensor.detector),
        ]
        if tdc.threshold_to_noise is not None:
            sliders.append(
                _slider_around("tdc.threshold_to_noise", "threshold / noise", "", tdc.threshold_to_noise, 3.0)
            )
        elif sensor.histogram is not None:
            slope = float(sensor.histogram.threshold_slope)
            sliders.append(
                Control(
                    key="histogram.threshold_slope",
                    label="threshold / sqrt(background)",
                    unit="",
                    low=0.0,
                    high=max(3.0 * slope, 1.0),
                    value=slope,
                )
            )
        else:
            sliders.append(_slider_around("tdc.threshold_level", "threshold", "", tdc.threshold_level, 10.0))
        return sliders


def _detector_sliders(detector: Detector) -> list[Control]:
    """Sliders of the numbers that the detector declares with one."""
    return [
        Control(
            key=f"detector.{quantity.for_field(field)}",
            label=slider.label,
            unit=slider.unit,
            low=slider.low,
            high=slider.high,
            log=slider.log,
            value=float(quantity.in_file(getattr(detector, field))),
        )
        for field, (quantity, slider) in units.sliders(type(detector)).items()
    ]


def _slider_around(key: str, label: str, unit: str, value: Any, factor: float) -> Control:
    """Logarithmic slider from value / factor to value * factor."""
    return Control(key=key, label=label, unit=unit, low=value / factor, high=value * factor, value=value, log=True)


def _sun_values(sun: Sun) -> dict[str, float]:
    """Values of the sun by the keys of scene files."""
    return {
        "azimuth_deg": math.degrees(sun.azimuth_rad),
        "elevation_deg": math.degrees(sun.elevation_rad),
        "illuminance_klux": sun.illuminance_klux,
    }


def _check_sun(values: Mapping[str, float]) -> None:
    """Raise InputError for a value of the sun that a scene file could not have."""
    for field, hint in get_type_hints(Sun, include_extras=True).items():
        quantity = units.note_of(hint, units.Quantity)
        if quantity is None:
            continue
        key = quantity.for_field(field)
        if must := quantity.must_be(values[key]):
            intended = quantity.as_written_in_si(values[key])
            suggestion = "" if intended is None else f": did you mean {intended:g}?"
            raise InputError(f"sun.{key}: must be {must}, got {values[key]:g}{suggestion}")


def number_of(key: str, value: object) -> float:
    """Check a number that came from the page.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    if isinstance(value, bool) or not isinstance(value, float | int) or not abs(value) < 1e300:
        raise InputError(f"{key}: must be a number, got {shorten(repr(value))}")
    return float(value)
