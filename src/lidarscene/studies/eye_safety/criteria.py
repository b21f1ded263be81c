"""Criteria of class 1: emissions of a pulse train into one viewer's eye, compared with their limits.

The standard has several rules for single pulses, groups of pulses and average power; the strictest decides. Each is a
`Held` row: emission through the aperture as simulated, its limit as reference, both in J or W, and their margin.

Symbols: as in the standard, T_i grouping time, T2, C5 reduction for many pulses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ...physics import eye_safety as iec
from ...sensor.sensor_model import Sensor
from ..held import LIMITS, Held
from .exposure import PulseTrain

VIEWERS = {"eye": False, "telescope": True}
"""Conditions 3 and 1 of table 10."""


def margin_of(criterion: Held) -> float:
    """Limit over emission of a criterion; 1 or more passes."""
    return math.inf if criterion.value is None else criterion.value


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewerCheck:
    """Check of one pulse train for one viewer.

    Attributes:
        energy_j: energy of a pulse
        source_rad: angle of the apparent source
        time_base_s: longest viewing time
    """

    sensor: Sensor
    viewer: str
    train: PulseTrain
    energy_j: float
    source_rad: float
    time_base_s: float

    def criteria(self) -> Iterator[Held]:
        """Yield all criteria that apply."""
        yield self._single()
        yield from self._group()
        yield self._average()
        if iec.reaches_retina(self.sensor.laser.wavelength_m):
            yield self._train_of_pulses()
        yield from self._blue()

    def _single(self) -> Held:
        pulse_s = self._pulse_s
        return self._criterion(
            "single pulse", "4.3 f 1", self._energy_through_aperture(pulse_s), self._limit(pulse_s), "J"
        )

    def _average(self) -> Held:
        duration = self.time_base_s
        power = self._energy_through_aperture(duration) * self.train.mean_rate_hz
        return self._criterion(
            "average power", "4.3 f 2", power, self._limit(duration) / duration, "W", f"over {duration:g} s"
        )

    def _group(self) -> Iterator[Held]:
        """Yield the worst group of consecutive pulses, of durations from T_i up to 10 s."""
        least = self._grouping_s if iec.reaches_retina(self.sensor.laser.wavelength_m) else 0.0
        groups = []
        for count in self.train.group_sizes(min(iec.t2_s(source_rad=0.0), self.time_base_s)):
            duration = max(self.train.shortest_span_s(count) + self._pulse_s, least)
            if count > 1:
                detail = f"{count} pulses in {si_text(duration, 's')}"
                emission = count * self._energy_through_aperture(duration)
                groups.append(self._criterion("pulse group", "4.3 f 2", emission, self._limit(duration), "J", detail))
        if groups:
            yield min(groups, key=margin_of)

    def _train_of_pulses(self) -> Held:
        """Rule with C5: pulses within T_i count as one, with their summed energy and the duration T_i."""
        grouping, train = self._grouping_s, self.train
        longest = min(iec.t2_s(source_rad=self.source_rad), self.time_base_s)
        together = max(train.most_within(grouping), 1)
        duration = self._pulse_s if together == 1 else max(grouping, self._pulse_s)
        if together == 1:
            pulses = float(max(train.most_within(longest), 1))
        elif train.period_s <= grouping:
            pulses = longest / grouping
        else:
            pulses = train.groups_per_period(grouping) * max(longest / train.period_s, 1.0)
        factor = iec.c5(
            pulse_s=duration,
            pulses=pulses,
            source_rad=self.source_rad,
            grouping_s=grouping,
            time_base_s=self.time_base_s,
        )
        detail = f"C5 = {factor:.3g} for {pulses:.4g} pulses in {longest:.3g} s"
        detail += f", {together} within {si_text(grouping, 's')} as one" if together > 1 else ""
        emission = together * self._energy_through_aperture(duration)
        return self._criterion("pulse train", "4.3 f 3", emission, factor * self._limit(duration), "J", detail)

    def _blue(self) -> Iterator[Held]:
        duration = min(100.0, self.time_base_s)
        limit = iec.class_1_blue_energy_j(wavelength_m=self.sensor.laser.wavelength_m, duration_s=duration)
        if math.isfinite(limit):
            power = self._energy_through_aperture(duration) * self.train.mean_rate_hz
            yield self._criterion("blue light", "table 3", power, limit / duration, "W", f"over {duration:g} s")

    @property
    def _pulse_s(self) -> float:
        return float(self.sensor.laser.pulse_fwhm_s)

    @property
    def _grouping_s(self) -> float:
        return iec.grouping_time_s(wavelength_m=self.sensor.laser.wavelength_m)

    def _limit(self, duration_s: float) -> float:
        return iec.class_1_energy_j(
            wavelength_m=self.sensor.laser.wavelength_m, duration_s=duration_s, source_rad=self.source_rad
        )

    def _energy_through_aperture(self, duration_s: float) -> float:
        """Energy of one pulse through the aperture that applies to emissions of this duration."""
        aperture, _, beam = geometry(self.sensor, self.viewer, duration_s)
        return self.energy_j * iec.fraction_through_aperture(beam_diameter_m=beam, aperture_m=aperture)

    def _criterion(self, name: str, clause: str, emission: float, limit: float, unit: str, detail: str = "") -> Held:
        return Held(
            subject=self.viewer,
            quantity=name,
            condition=clause,
            reference=limit,
            simulated=emission,
            value=limit / emission if emission > 0.0 else math.inf,
            limits=LIMITS["margin"],
            unit=unit,
            note=detail,
        )


def geometry(sensor: Sensor, viewer: str, duration_s: float) -> tuple[float, float, float]:
    """Diameter of the aperture, its distance, and the 1/e^2 diameter of the beam there (0: unknown)."""
    laser, telescope = sensor.laser, VIEWERS[viewer]
    aperture = iec.aperture_diameter_m(wavelength_m=laser.wavelength_m, duration_s=duration_s, telescope=telescope)
    distance = iec.measuring_distance_m(telescope=telescope)
    if laser.exit_diameter_m is None:
        return aperture, distance, 0.0
    beam = iec.beam_diameter_m(
        exit_diameter_m=laser.exit_diameter_m, divergence_rad=laser.least_divergence_rad, distance_m=distance
    )
    return aperture, distance, beam


def si_text(value: float, unit: str) -> str:
    """Text of a number with an SI prefix, four digits."""
    exponent = min(max(math.floor(math.log10(value) / 3.0 + 1e-12), -5), 0) if value > 0.0 else 0
    return f"{value / 10.0 ** (3 * exponent):.4g} {'fpnum'[exponent] if exponent else ''}{unit}"
