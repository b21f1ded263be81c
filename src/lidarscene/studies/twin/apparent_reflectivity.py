"""Apparent reflectivity of a surface from the strength of its return.

It is the reflectivity of a matt board square to the beam with the same return: the surface's own reflectivity times its
scattering law at the angle of incidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...maths.arrays import Numbers
from ...physics.electronics.intensity import LARGEST
from ...physics.optics import reflection
from ...recordings.sweep import Second, Sweep
from ...sensor.sensor_model import Sensor
from ..ranging.plane import Target, detection_margin, echoes_of_plane
from .tuning import (
    ASSUMED_KLUX,
    ASSUMED_MEDIAN,
    COMPANY,
    DETECTED,
    DIM,
    FAR_M,
    LEAST_COUNTS,
    LEAST_PHOTONS,
    LEAST_REFLECTIVITY,
    LOSS_SIGMAS,
    SLOPE_DEG,
    STEEPEST,
)

WHITE = 100.0
"""Source: Ouster's and Velodyne's manuals; REFLECTIVITY of a white surface, up to which an Ouster counts linearly, and
intensity of a Velodyne."""

_BINS_PER_OCTAVE = 4
_LEAST_PIXELS = 10

_CURVE_RANGES = 200


def withheld_mask(sweep: Sweep) -> Numbers:
    """Mask of the lost pulses with a reflectivity: the sensor found an echo and withheld its range.

    Ousters do so by the thousand, at edges and near by. The surface there is not known.
    """
    if sweep.reflectivity is None:
        return np.zeros(sweep.shape, bool)
    return np.asarray(sweep.lost & (sweep.reflectivity > 0.0))


def is_explained(sweep: Sweep, sensor: Sensor) -> Numbers:
    r"""Mask of the pulses that returned, or that this sensor's threshold may have lost.

    The others have more SIGNAL than `LOSS_SIGMAS` above the threshold (T110) of their NEAR_IR, by its own spread and by
    the noise of so many photons:

    .. math:: S > U\, e^{2 \sqrt{\mathrm{spread}^2 + 1 / U}} \tag{T208}

    Their echo is nearer than the sensor reports, or was withheld: they say nothing of the surfaces behind.
    """
    histogram = sensor.histogram
    if histogram is None or sweep.signal is None or sweep.near_ir is None or not sweep.includes_lost:
        return np.ones(sweep.shape, bool)
    level = threshold_of(sweep, sensor)
    spread = float(histogram.threshold_spread or 0.0)
    most = level * np.exp(LOSS_SIGMAS * np.sqrt(spread * spread + 1.0 / level))
    return np.asarray(~sweep.lost | ~(sweep.signal > most))


def threshold_of(sweep: Sweep, sensor: Sensor | None) -> Numbers:
    """Threshold (T110) of each pulse's NEAR_IR in photons, 1 at least; inf of a sensor that counts none, or without."""
    if sensor is None or sensor.histogram is None or sweep.near_ir is None:
        return np.full(sweep.shape, np.inf)
    near_ir = np.maximum(np.nan_to_num(sweep.near_ir), 0.0)
    return np.asarray(np.maximum(sensor.histogram.threshold(near_ir), 1.0))


def scattering_law(cos: Numbers) -> Numbers:
    """Light that a surface sends straight back, over that at normal incidence: (T7a) times the cosine."""
    relief = reflection.relief(np.radians(SLOPE_DEG))
    per_sr = reflection.rough_diffuse_per_sr(
        reflectivity=np.pi, relief=relief, cos_in=cos, cos_out=cos, cos_between=np.ones_like(cos)
    )
    return np.asarray(per_sr * cos)


def largest_reflectivity() -> float:
    """Largest reflectivity, at normal incidence, of a surface with facets of `SLOPE_DEG`."""
    return reflection.largest_reflectivity(float(np.radians(SLOPE_DEG)))


CALIBRATED = ("velodyne", "hesai", "pandar")
"""How formats begin whose intensities are reflectivities, of which `WHITE` is a white surface's."""

UNCALIBRATED = ("PandarQT",)
"""Products of these formats whose intensities are not: of a recorded PandarQT's points a quarter read 255."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReflectivityGauge:
    """Conversion of a recording's strengths to apparent reflectivities.

    Attributes:
        field: field of the sweep that holds the strengths: signal, reflectivity or intensity
        range_m: ranges of ``per_count``
        per_count: reflectivity per count over the range; one entry where strengths are calibrated already
        least: strength of returns whose recorded one is rounded to 0: half of the least above
        assumed: True if the scale is a guess
        sensor: sensor that counts photons, whose own of a white target signals are taken over, or that sent the
            intensities; None: signals are converted by the table, below it by its own slope, beyond by the square of
            the range
        over_recorded: median of the reflectivities over the recorded ones; 1 if they are these, or none is recorded
        white_value: guessed reading of a white surface, of whole numbers that the sensor may have sent itself; None:
            they are of another kind, or their scale is known
    """

    field: str
    range_m: Numbers
    per_count: Numbers
    least: float = 0.0
    assumed: bool = False
    sensor: Sensor | None = None
    over_recorded: float = 1.0
    white_value: float | None = None

    @property
    def by_sensor(self) -> bool:
        """True if the scale is that of the sensor's own photons."""
        return self.field == "signal" and self.sensor is not None

    @classmethod
    def from_sweep(cls, sweep: Sweep, sensor: Sensor | None = None) -> ReflectivityGauge | None:
        """Calibrate from a sweep; None if it has no strengths.

        Signals are finer than reflectivities, which come in steps of 1 % and are not linear above white. A sensor's own
        photons of a white target convert them, whatever the unit's firmware counts as a photon, so that the sensor
        sees the recorded signals again. Without a sensor the ratio of reflectivity to signal over the range does, the
        maker's own calibration, near field included.

        Args:
            sensor: sensor whose photons calibrate signals; one that counts none is as None
        """
        counter = None if sensor is None or sensor.histogram is None else sensor
        table = None
        if sweep.reflectivity is not None and sweep.signal is not None:
            table = _reflectivity_per_photon(sweep)
        if sweep.signal is not None and counter is not None:
            range_m, per_count = (np.full(1, FAR_M), np.ones(1)) if table is None else table
            white = white_signal(counter, range_m)
            over = 1.0 if table is None else float(np.median(1.0 / (white * per_count)))
            return cls(field="signal", range_m=range_m, per_count=1.0 / white, sensor=counter, over_recorded=over)
        if table is not None:
            return cls(field="signal", range_m=table[0], per_count=table[1])
        if sweep.reflectivity is not None:
            return cls(field="reflectivity", range_m=np.ones(1), per_count=np.full(1, 1.0 / WHITE), sensor=counter)
        if sweep.intensity is None:
            return None
        strength = sweep.intensity[sweep.has_return & np.isfinite(sweep.intensity)]
        if not len(strength) or not np.median(strength) > 0.0:
            return None
        least = 0.5 * float(strength[strength > 0.0].min())
        recorded_as, product = sweep.metadata.get("format", ""), sweep.metadata.get("sensor", "")
        if recorded_as.startswith(CALIBRATED) and product not in UNCALIBRATED:
            return cls(
                field="intensity", range_m=np.ones(1), per_count=np.full(1, 1.0 / WHITE), least=least, sensor=sensor
            )
        white_value: float | None = None
        reading = float(np.median(strength)) / ASSUMED_MEDIAN
        scale = None if sensor is None else sensor.intensity
        is_linear = scale is not None and scale.kind == "reflectivity" and scale.exponent is None
        if is_linear and np.array_equal(strength, np.rint(strength)) and strength.max() <= LARGEST:
            reading = float(np.clip(reading, 1.0, LARGEST - 1.0))
            white_value = reading
        return cls(
            field="intensity",
            range_m=np.ones(1),
            per_count=np.full(1, 1.0 / reading),
            least=least,
            assumed=True,
            white_value=white_value,
            sensor=sensor,
        )

    def apparent(self, returns: Sweep | Second, range_m: Numbers) -> Numbers:
        """Apparent reflectivity of a sweep's strengths at these ranges; `LEAST_REFLECTIVITY` for NaN."""
        strength = np.maximum(np.asarray(getattr(returns, self.field), np.float64), self.least)
        if self.by_sensor:
            # The photons of bright returns, of which SPADs that have fired count too few, in those of dim ones.
            assert self.sensor is not None
            power_w = self.sensor.working_point(np.zeros(1)).response.power_w
            strength = np.asarray(power_w(strength) / power_w(np.ones(1)))
        factor = self._per_count_at(np.maximum(range_m, 1e-3))
        apparent = np.asarray(np.maximum(np.nan_to_num(strength * factor, posinf=0.0), LEAST_REFLECTIVITY))
        if self.field != "intensity" or self.sensor is None:
            return apparent
        # What reads 0 and returned was bright enough for that.
        is_zero = (getattr(returns, self.field) <= 0.0) & np.isfinite(range_m)
        if is_zero.any():
            apparent[is_zero] = np.maximum(apparent[is_zero], _detected_reflectivity(self.sensor, range_m[is_zero]))
        return apparent

    def _per_count_at(self, range_m: Numbers) -> Numbers:
        if self.by_sensor:
            assert self.sensor is not None
            return 1.0 / white_signal(self.sensor, np.nan_to_num(range_m, nan=FAR_M))
        log_range, table, value = np.log(range_m), np.log(self.range_m), np.log(self.per_count)
        log_factor = np.interp(log_range, table, value)
        if len(table) > 1:
            # Below the table: the slope of its first two bins. Beyond it signals fall as 1 / range^2, so the factor
            # grows as range^2.
            slope = np.clip((value[1] - value[0]) / (table[1] - table[0]), -STEEPEST, STEEPEST)
            log_factor += slope * np.minimum(log_range - table[0], 0.0) + 2.0 * np.maximum(log_range - table[-1], 0.0)
        return np.asarray(np.exp(log_factor))


def board(apparent: Numbers, cos_incidence: Numbers | float = 1.0) -> Target:
    """Boards that return as much as pixels of these apparent reflectivities, and lean as they do."""
    return Target(
        reflectivity=apparent / cos_incidence,
        cos_incidence=cos_incidence,
        illuminance_klux=ASSUMED_KLUX,
        transmittance=1.0,
    )


def _detected_reflectivity(sensor: Sensor, range_m: Numbers) -> Numbers:
    """Reflectivity whose echo is `DETECTED` thresholds high at these ranges in a twin's clear air."""
    target = Target(reflectivity=DIM, illuminance_klux=ASSUMED_KLUX, transmittance=1.0)
    return np.asarray(DETECTED * DIM / detection_margin(sensor, target, np.maximum(range_m, 1e-3)))


def white_signal(sensor: Sensor, range_m: Numbers) -> Numbers:
    """Photons of a white target at these ranges in a twin's clear air, as one so dim gives that no SPAD fires twice."""
    grid_m = np.geomspace(range_m.min(), 1.01 * range_m.max(), _CURVE_RANGES)
    light = echoes_of_plane(sensor, Target(reflectivity=DIM, illuminance_klux=0.0, transmittance=1.0), grid_m)
    photons = np.asarray(sensor.working_point(light.background_power_w).response.signal(light.peak_power_w))
    log_photons = np.log(np.maximum(photons / DIM, LEAST_PHOTONS))
    return np.asarray(np.exp(np.interp(np.log(range_m), np.log(grid_m), log_photons)))


def _has_company(sweep: Sweep) -> Numbers:
    """Mask of the returns with a neighbour in their row within `COMPANY` of their range; all in a list of points."""
    if len(sweep.shape) < 2:
        return sweep.has_return
    with np.errstate(invalid="ignore"):
        close = np.abs(np.diff(sweep.range_m, axis=1)) < COMPANY * sweep.range_m[:, :-1]
    none = np.zeros((sweep.shape[0], 1), bool)
    return np.asarray(np.hstack([close, none]) | np.hstack([none, close]))


def _reflectivity_per_photon(sweep: Sweep) -> tuple[Numbers, Numbers] | None:
    """Reflectivity per photon over the range, from pixels well above the steps of the reflectivity and below white.

    False points do not count, since their REFLECTIVITY is not that of their SIGNAL: an OS0-128 of revision 7 gives them
    SIGNAL + 0.5 sqrt(NEAR_IR). They have no neighbour at their range.
    """
    assert sweep.reflectivity is not None
    assert sweep.signal is not None
    usable = _has_company(sweep) & (sweep.reflectivity >= LEAST_COUNTS) & (sweep.reflectivity < WHITE)
    usable &= sweep.signal > 0.0
    if usable.sum() < _LEAST_PIXELS:
        return None
    log_range = np.log2(sweep.range_m[usable])
    ratio = sweep.reflectivity[usable].astype(np.float64) / WHITE / sweep.signal[usable]
    bins = np.floor(log_range * _BINS_PER_OCTAVE).astype(int)
    range_m, per_count = [], []
    for number in np.unique(bins):
        mask = bins == number
        if mask.sum() >= _LEAST_PIXELS:
            range_m.append(2.0 ** float(np.median(log_range[mask])))
            per_count.append(float(np.median(ratio[mask])))
    return (np.array(range_m), np.array(per_count)) if range_m else None
