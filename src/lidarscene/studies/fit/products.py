"""Products of a sensor file's numbers that a recording determines, and directions that it leaves open.

The photons of a white wall, for one, are a product of power, lens, efficiency and PDE. The products are computed, not
listed: each measured quantity follows from the sensor file by the stages that `render` runs, and its logarithm is
differentiated by that of each number. The null space of these slopes is not determined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...maths.arrays import Lanes, Numbers, xp
from ...physics.constants import SPEED_OF_LIGHT_M_S
from ...physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from ...physics.photon_counting import matched_filter
from ...sensor.sensor_model import Sensor
from ..ranging.plane import Target, echoes_of_plane
from .tuning import FAR_RATIO, LEAST_EXPONENT

REFLECTIVITY = "reflectivity of all targets"
"""Name of the reflectivities' common scale, which is the maker's and multiplies the power."""

LAW_RANGES = 200
"""Ranges at which a law is computed for many pulses: it is smooth."""


def width_of_place(sigma_s: Lanes, bin_s: Lanes) -> Lanes:
    """Width, in sigmas of the echo, of the filter by which the peak's place scatters.

    The place comes from three values of the filter, a bin apart. Their difference is a slope over two bins, as if the
    template were as much wider: w^2 + (2 bin)^2 / 12.
    """
    ratio = bin_s / sigma_s
    square = matched_filter.TEMPLATE**2 + ratio * ratio / 3.0
    return xp(square).sqrt(square)


def scatter_over_sigma(width: Lanes) -> Lanes:
    """Scatter of the peak behind a Gaussian filter so many times as wide as the echo, over sigma / sqrt(S).

    The variance is int h'^2 s / (int h' s')^2, of filter h and echo s, which is (1 + 1/w^2)^3 (1 + 2/w^2)^(-3/2).
    """
    inverse = 1.0 / (width * width)
    single, double = 1.0 + inverse, 1.0 + 2.0 * inverse
    square = single * single * single / double
    ops = xp(square)
    return ops.sqrt(square / ops.sqrt(double))


def white_m2(sensor: Sensor) -> float:
    """Photons of a white wall times the square of its range, far away, weak enough that no SPAD fires twice."""
    return float(white_over_range_m2(sensor, np.array([FAR_RATIO * near_field_m(sensor)]))[0])


def white_over_range_m2(sensor: Sensor, range_m: Numbers) -> Numbers:
    """`white_m2` times the share of the light on the detector at these ranges, (n,)."""
    dim = 1e-3
    light = echoes_of_plane(sensor, Target(reflectivity=dim, illuminance_klux=0.0), range_m)
    photons = sensor.working_point(light.background_power_w).response.signal(light.peak_power_w)
    return np.asarray(photons * np.ones_like(range_m) * range_m**2 / dim)


def at_pulses(law: Callable[[Numbers], Numbers], range_m: Numbers) -> Numbers:
    """Evaluate a smooth law of the range at each pulse's, of any shape; NaN without one."""
    known = np.isfinite(range_m)
    values = np.full(range_m.shape, np.nan)
    if known.any():
        grid_m = np.geomspace(range_m[known].min(), range_m[known].max() + 1e-3, LAW_RANGES)
        values[known] = np.interp(range_m[known], grid_m, law(grid_m))
    return values


def near_field_m(sensor: Sensor) -> float:
    """Range R0 = r_A f / r_PD [m] at which the blur of a lens focused at infinity is as large as the detector."""
    optics = sensor.optics
    return float(optics.aperture_radius_m * optics.focal_length_m / sensor.detector.radius_m)


def scatter_c_mm(sensor: Sensor) -> float:
    """Scatter of the range times the square root of the photons [mm], without background: pulse, jitter and bin."""
    sigma_s = math.hypot(float(sensor.laser.pulse_fwhm_s) / SIGMAS_PER_FWHM, math.sqrt(_rest_s2(sensor)))
    return 0.5e3 * SPEED_OF_LIGHT_M_S * sigma_s * _scatter(sensor, sigma_s)


def pulse_fwhm_s(sensor: Sensor, scatter_mm: float) -> float | None:
    """Pulse width whose `scatter_c_mm` is ``scatter_mm``; None if the sensor's jitter and bin alone scatter more."""
    wanted_s = scatter_mm / (0.5e3 * SPEED_OF_LIGHT_M_S)
    sigma_s = wanted_s / float(scatter_over_sigma(matched_filter.TEMPLATE))
    for _ in range(20):  # the bin's part of the filter's width depends on the echo's, weakly
        sigma_s = wanted_s / _scatter(sensor, sigma_s)
    square = sigma_s**2 - _rest_s2(sensor)
    return SIGMAS_PER_FWHM * math.sqrt(square) if square > 0.0 else None


def _scatter(sensor: Sensor, sigma_s: float) -> float:
    assert sensor.histogram is not None
    return float(scatter_over_sigma(width_of_place(sigma_s, float(sensor.histogram.bin_s))))


def _rest_s2(sensor: Sensor) -> float:
    assert sensor.histogram is not None
    jitter_s, bin_s = float(getattr(sensor.detector, "jitter_s", 0.0)), float(sensor.histogram.bin_s)
    return jitter_s**2 + bin_s**2 / 12.0


Quantity = Callable[[Sensor], float]

KEYS: tuple[tuple[str, str, str], ...] = (
    ("laser.peak_power_w", "laser", "peak_power_w"),
    ("laser.pulse_fwhm_ns", "laser", "pulse_fwhm_s"),
    ("optics.aperture_radius_mm", "optics", "aperture_radius_m"),
    ("optics.focal_length_mm", "optics", "focal_length_m"),
    ("optics.efficiency_laser", "optics", "efficiency_laser"),
    ("detector.radius_mm", "detector", "radius_m"),
    ("detector.pde", "detector", "pde"),
    ("histogram.shots", "histogram", "shots"),
    ("histogram.threshold_slope", "histogram", "threshold_slope"),
    ("histogram.threshold_pedestal", "histogram", "threshold_pedestal"),
)
"""Numbers of a sensor file that the measured quantities depend on: key, part of the sensor, field of the part."""

QUANTITIES: Mapping[str, Quantity] = {
    "white_m2": white_m2,
    "near_field_m": near_field_m,
    "scatter_c": scatter_c_mm,
    "threshold_slope": lambda sensor: float(sensor.histogram.threshold_slope),  # type: ignore[union-attr]
    "threshold_pedestal": lambda sensor: float(sensor.histogram.threshold_pedestal * sensor.histogram.shots),  # type: ignore[union-attr]
}
"""Key of the estimate -> function that computes the quantity from a sensor."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Products:
    """Measured quantities as products of powers of a sensor file's numbers.

    Attributes:
        keys: keys of the sensor file, and `REFLECTIVITY`
        quantities: keys of the measured quantities
        exponents: (quantities, keys) d ln quantity / d ln key
    """

    keys: tuple[str, ...]
    quantities: tuple[str, ...]
    exponents: Numbers

    def product(self, quantity: str) -> str:
        """Write a quantity as a product of powers of keys."""
        row = self.exponents[self.quantities.index(quantity)]
        return " x ".join(
            key if abs(power - 1.0) < LEAST_EXPONENT else f"{key}^{power:.2g}"
            for key, power in zip(self.keys, row, strict=True)
            if abs(power) > LEAST_EXPONENT
        )

    @property
    def null(self) -> tuple[str, ...]:
        """Directions that leave all measured quantities unchanged, one line for each key that must be fixed.

        By Gaussian elimination: each free key, and how much the pivots change when it grows by 1 %.
        """
        matrix, pivots = row_echelon(self.exponents)
        directions = []
        for free, key in enumerate(self.keys):
            if free in pivots:
                continue
            moves = [
                (self.keys[pivot], -matrix[row, free])
                for row, pivot in enumerate(pivots)
                if abs(matrix[row, free]) > LEAST_EXPONENT
            ]
            if not moves:
                directions.append(f"{key}: alone")
                continue
            directions.append(f"{key} +1 %: " + ", ".join(f"{name} {power:+.2g} %" for name, power in moves))
        return tuple(directions)

    @property
    def fixed(self) -> tuple[str, ...]:
        """Keys that keep the values of the file that the fit started from."""
        pivots = row_echelon(self.exponents)[1]
        return tuple(key for index, key in enumerate(self.keys) if index not in pivots and key != REFLECTIVITY)


def find_products(sensor: Sensor, quantities: Sequence[str]) -> Products:
    """Compute the exponents of these quantities at this sensor, by central differences of their logarithms."""
    names = tuple(name for name in quantities if name in QUANTITIES and QUANTITIES[name](sensor) > 0.0)
    present = [entry for entry in KEYS if getattr(sensor, entry[1]) is not None]
    exponents = np.zeros((len(names), len(present) + 1))
    step = 1e-4
    for column, (_, part, field) in enumerate(present):
        logs = []
        for sign in (1.0, -1.0):
            component = getattr(sensor, part)
            changed_component = replace(component, **{field: getattr(component, field) * math.exp(sign * step)})
            varied = replace(sensor, **{part: changed_component})
            logs.append([math.log(QUANTITIES[name](varied)) for name in names])
        exponents[:, column] = (np.array(logs[0]) - np.array(logs[1])) / (2.0 * step)
    # A common factor of all reflectivities acts on the white wall as power does.
    if "white_m2" in names:
        exponents[names.index("white_m2"), -1] = 1.0
    return Products(keys=(*(entry[0] for entry in present), REFLECTIVITY), quantities=names, exponents=exponents)


def row_echelon(matrix: Numbers) -> tuple[Numbers, list[int]]:
    """Reduced row echelon form of a matrix without its zero rows, and the columns of its pivots, the first ones first.

    Each column is its row echelon's combination of the pivots' columns.
    """
    pivots: list[int] = []
    for column in range(matrix.shape[1]):
        basis = matrix[:, pivots]
        outside = matrix[:, column] - basis @ np.linalg.lstsq(basis, matrix[:, column], rcond=None)[0]
        if np.abs(outside).max() > LEAST_EXPONENT:
            pivots.append(column)
    return np.asarray(np.linalg.lstsq(matrix[:, pivots], matrix, rcond=None)[0]), pivots
