"""The paper's case: Table 1's two sensors and its target, and numbers of them that many claims need.

Sensors come from the catalogue, so a claim is checked with the same files that `render` uses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from ...physics.electronics import apd, sipm
from ...sensor.detectors import Apd, Sipm
from ...sensor.sensor_file import load_sensor
from ...sensor.sensor_model import Sensor
from ..ranging import plane
from ..ranging.plane import Target

TABLE_1 = Target()
FLOOR = "detector.cell_floor=1"
"""A comparator cannot see less than one cell; the paper has no such floor."""


@cache
def apd_lidar(*changes: str) -> Sensor:
    """Table 1 with its APD; (19) is correct as printed."""
    return load_sensor("table1-apd", overrides=changes)


@cache
def sipm_printed(*changes: str) -> Sensor:
    """Table 1 with its SiPM, (23)-(27) as printed and without a floor: what Fig. 6 was drawn from."""
    return load_sensor("table1-sipm", overrides=changes)


@cache
def sipm_steady(*changes: str) -> Sensor:
    """Table 1 with its SiPM, busy cells in steady state instead of (23) and (25), and a floor of one cell."""
    return load_sensor("table1-sipm", overrides=["detector.statistics='steady_state'", FLOOR, *changes])


@cache
def sipm_in_time(*changes: str) -> Sensor:
    """Table 1 with its SiPM as derived: `sipm_steady`, and the whole pulse instead of (24)'s half."""
    return load_sensor("table1-sipm", overrides=["detector.statistics='time_domain'", FLOOR, *changes])


def range_m(sensor: Sensor, **target: Any) -> float:
    """Maximum range on Table 1's target, with changes to sensor or target."""
    return float(plane.maximum_range_m(sensor, Target(**target))[0])


def snr_at(sensor: Sensor, distance_m: float, **target: Any) -> float:
    """SNR on Table 1's target."""
    return float(plane.snr(sensor, Target(**target), distance_m)[0])


def ranges_m(sensors: Sequence[Sensor], **target: Any) -> list[float]:
    """Maximum range of each."""
    return [range_m(one, **target) for one in sensors]


@dataclass(frozen=True, slots=True, kw_only=True)
class ApdNoise:
    """Variances of (20) at gain one under Table 1's sun, a K P_rs, b and c, and the signal current at gain one."""

    optical_a2: float
    bulk_dark_a2: float
    unmultiplied_a2: float
    signal_a: float

    @property
    def multiplied_a2(self) -> float:
        """Variance of everything that the avalanche multiplies, a K P_rs + b."""
        return self.optical_a2 + self.bulk_dark_a2

    def snr(self, gain: Any, *, index: float = 0.3) -> Any:
        """SNR at this gain, (20)."""
        return apd.snr_of_gain(
            signal_at_unit_gain_a=self.signal_a,
            optical_variance_a2=self.optical_a2,
            bulk_dark_variance_a2=self.bulk_dark_a2,
            unmultiplied_variance_a2=self.unmultiplied_a2,
            gain=gain,
            excess_noise_index=index,
        )


def apd_noise(*, illuminance_klux: float = 100.0, distance_m: float = 100.0) -> ApdNoise:
    """The terms of (20) at Table 1."""
    sensor = apd_lidar()
    detector = sensor.detector
    assert isinstance(detector, Apd)
    light = plane.echoes_of_plane(sensor, Target(illuminance_klux=illuminance_klux), distance_m)
    responsivity = apd.responsivity_a_w(
        quantum_efficiency=detector.quantum_efficiency, photon_energy_j=sensor.laser.photon_energy_j
    )
    unit = {"gain": 1.0, "excess_noise": 1.0, "bandwidth_hz": sensor.tdc.bandwidth_hz}
    optical = apd.light_shot_variance_a2(
        responsivity_a_w=responsivity, power_w=float(np.ravel(light.background_power_w)[0]), **unit
    )
    bulk = apd.dark_shot_variance_a2(
        surface_dark_current_a=0.0, bulk_dark_current_a=detector.bulk_dark_current_a, **unit
    )
    rest = apd.dark_shot_variance_a2(
        surface_dark_current_a=detector.surface_dark_current_a, bulk_dark_current_a=0.0, **unit
    ) + apd.thermal_variance_a2(
        temperature_k=detector.temperature_k,
        load_resistance_ohm=detector.load_resistance_ohm,
        bandwidth_hz=sensor.tdc.bandwidth_hz,
    )
    return ApdNoise(
        optical_a2=float(optical),
        bulk_dark_a2=float(bulk),
        unmultiplied_a2=float(rest),
        signal_a=float(responsivity) * float(np.ravel(light.peak_power_w)[0]),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SipmCounts:
    """Table 1's SiPM in counts of one dead time: photons, busy cells and their variance as printed, dark counts."""

    cells: float
    pde: float
    background_photons: float
    signal_photons: float
    busy: float
    variance: float
    dark: float


def sipm_counts(*, illuminance_klux: float = 100.0, distance_m: float = 100.0) -> SipmCounts:
    """(22)-(26) at Table 1."""
    sensor = sipm_printed()
    detector = sensor.detector
    assert isinstance(detector, Sipm)
    light = plane.echoes_of_plane(sensor, Target(illuminance_klux=illuminance_klux), distance_m)
    photon = sensor.laser.photon_energy_j
    background = sipm.background_photons(
        power_w=float(np.ravel(light.background_power_w)[0]), dead_time_s=detector.dead_time_s, photon_energy_j=photon
    )
    signal = sipm.signal_photons(
        peak_power_w=float(np.ravel(light.peak_power_w)[0]),
        pulse_fwhm_s=sensor.laser.pulse_fwhm_s,
        photon_energy_j=photon,
    )
    busy = detector.cells * float(
        sipm.fired_share_published(photons=background, pde=detector.pde, cells=detector.cells)
    )
    return SipmCounts(
        cells=float(detector.cells),
        pde=float(detector.pde),
        background_photons=float(background),
        signal_photons=float(signal),
        busy=float(busy),
        variance=float(sipm.fired_variance_published(fired=busy, cells=detector.cells)),
        dark=float(
            sipm.dark_counts(
                cells=detector.cells, dark_count_rate_hz=detector.dark_count_rate_hz, dead_time_s=detector.dead_time_s
            )
        ),
    )
