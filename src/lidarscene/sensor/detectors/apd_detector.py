"""Avalanche photodiode and its amplifier as data, and their working point under a background."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import model_validator

from ...files.table_model import Table
from ...maths.arrays import Lanes, Numbers, xp
from ...maths.units import FileKey, Quantity, Slider
from ...physics.constants import ELEMENTARY_CHARGE_C
from ...physics.electronics import apd, counting, mcintyre, range_limit, saturation
from .detector import Detector, Reception, Wave
from .working_point import Noise, Response, WorkingPoint

INGAAS_GAIN = 40.0
"""Source: Campbell, J. Lightwave Technol. 25, 2007; diodes of InGaAs, which see beyond silicon, reach a gain of 10 to
40 before noise drowns it. Silicon has 50 to 200."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Apd(Detector):
    """Linear-mode avalanche photodiode and its amplifier, (12)-(19). SI units; currents before gain.

    Attributes:
        tail: noise tail of false alarms: "gaussian" (9), or "mcintyre" (`electronics.mcintyre`), of the same variance
            but higher; detection is Gaussian with either
        saturation_a: saturation current at the amplifier's input (`physics.electronics.saturation`)
    """

    label: ClassVar[str] = "APD"
    unit: ClassVar[str] = "A"

    gain: Annotated[Lanes, Quantity(ge=1, le=1e5, about="M"), Slider("gain", "", 1.0, 1000.0, log=True)]
    radius_m: Annotated[Lanes, Quantity("mm", ge=1e-3, le=100, about="of the photosensitive area")]
    quantum_efficiency: Annotated[Lanes, Quantity(gt=0, le=1, about="eta_d")]
    surface_dark_current_a: Annotated[Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6, about="not multiplied")]
    bulk_dark_current_a: Annotated[Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6, about="multiplied")]
    excess_noise_index: Annotated[Lanes | None, Quantity(ge=0, le=10, about="x of F = M^x; this or the next")] = None
    ionisation_ratio: Annotated[Lanes | None, Quantity(ge=0, le=1, about="k of McIntyre's F")] = None
    load_resistance_ohm: Annotated[Lanes, Quantity(ge=0.01, le=1e12, about="R_l of the thermal noise")]
    temperature_k: Annotated[Lanes, Quantity(ge=1, le=1e4, about="of the thermal noise")] = 300.0
    circuit_noise_a: Annotated[
        Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6, about="sigma_c, standard deviation at the amplifier's input")
    ] = 0.0
    tail: Annotated[
        Literal["gaussian", "mcintyre"],
        FileKey(about='of false alarms: `"gaussian"` (9), or `"mcintyre"`; see docs/theory_receivers.md 1'),
    ] = "gaussian"
    saturation_a: Annotated[
        Lanes | None,
        Quantity(
            "ua",
            ge=0.01,
            le=1e6,
            about="current at which the amplifier clips, after multiplication; it never does if left out",
        ),
    ] = None
    recovery_s: Annotated[
        Lanes | None,
        Quantity(
            "ns",
            ge=0.01,
            le=1e5,
            about="with `saturation_ua`: time constant with which a clipped pulse drains; at once if left out",
        ),
    ] = None

    @property
    def saturates(self) -> bool:
        """True if the amplifier clips strong echoes."""
        return self.saturation_a is not None

    @property
    def excess_noise(self) -> Lanes:
        """F of (14): McIntyre's if an ionisation ratio is given, else M^x."""
        if self.ionisation_ratio is not None:
            return apd.excess_noise_mcintyre(gain=self.gain, ionisation_ratio=self.ionisation_ratio)
        assert self.excess_noise_index is not None
        return apd.excess_noise_power_law(gain=self.gain, index=self.excess_noise_index)

    def unmultiplied_variance_a2(self, bandwidth_hz: Lanes) -> Lanes:
        """Unmultiplied part of (18), in A^2: noise of surface dark current, load and circuit."""
        surface = apd.dark_shot_variance_a2(
            surface_dark_current_a=self.surface_dark_current_a,
            bulk_dark_current_a=0.0,
            gain=1.0,
            excess_noise=1.0,
            bandwidth_hz=bandwidth_hz,
        )
        thermal = apd.thermal_variance_a2(
            temperature_k=self.temperature_k, load_resistance_ohm=self.load_resistance_ohm, bandwidth_hz=bandwidth_hz
        )
        return surface + thermal + self.circuit_noise_a * self.circuit_noise_a

    @property
    def silicon(self) -> str | None:
        """A gain that no diode of InGaAs has."""
        if float(self.gain) <= INGAAS_GAIN:
            return None
        return f"a diode with a gain of {float(self.gain):g} is of silicon"

    def background_counts(self, background_power_w: Lanes, reception: Reception) -> tuple[Lanes, Lanes]:
        """Primary electrons per second, light and dark, and the factor that narrows their noise (1)."""
        light = counting.detected_photons_hz(
            power_w=background_power_w, efficiency=self.quantum_efficiency, photon_energy_j=reception.photon_energy_j
        )
        return light + self.bulk_dark_current_a / ELEMENTARY_CHARGE_C, 1.0

    def working_point(
        self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None
    ) -> WorkingPoint:
        """Noise (18) and response (12) under this background; the pulse width plays no part."""
        excess, bandwidth_hz = self.excess_noise, reception.bandwidth_hz
        responsivity = apd.responsivity_a_w(
            quantum_efficiency=self.quantum_efficiency, photon_energy_j=reception.photon_energy_j
        )
        avalanche = {"gain": self.gain, "excess_noise": excess, "bandwidth_hz": bandwidth_hz}
        primary = responsivity * background_power_w + self.bulk_dark_current_a
        multiplied = self.gain * primary * apd.shot_variance_per_ampere_a(**avalanche)
        unmultiplied = self.unmultiplied_variance_a2(bandwidth_hz)
        variance = multiplied + unmultiplied

        currents = mcintyre.Currents(primary_a=primary, unmultiplied_a2=unmultiplied, **avalanche)

        def mcintyre_tail(threshold: Lanes) -> Lanes:
            return mcintyre.false_alarm_probability(currents, threshold_a=threshold)

        def mcintyre_crossings_hz(threshold: Lanes, crossing_hz: Lanes, least_hz: Lanes | None) -> Lanes:
            # The tail is of the electrons in a resolution time of the noise, whatever filter follows.
            ratio = crossing_hz / bandwidth_hz
            least = None if least_hz is None else least_hz / ratio
            return mcintyre.crossing_rate_hz(currents, threshold_a=threshold, least_hz=least) * ratio

        ampere_per_watt = responsivity * self.gain
        return WorkingPoint(
            noise=Noise(
                deviation=xp(variance).sqrt(variance),
                kappa_1=apd.shot_variance_per_ampere_a(**avalanche),
                kappa_2=0.0,
                tail=mcintyre_tail if self.tail == "mcintyre" else None,
                crossings_hz=mcintyre_crossings_hz if self.tail == "mcintyre" else None,
            ),
            response=Response(
                signal=lambda power_w: ampere_per_watt * power_w,
                power_w=lambda signal: signal / ampere_per_watt,
                saturation=self.saturation_a,
                recovery_s=self.recovery_s,
                knee=self.saturation_a,
            ),
        )

    def closed_form_range_m(
        self, target: range_limit.Plane, transceiver: range_limit.Transceiver, reception: Reception
    ) -> Lanes:
        """(29)."""
        return range_limit.maximum_range_apd_m(
            target,
            transceiver,
            quantum_efficiency=self.quantum_efficiency,
            excess_noise=self.excess_noise,
            bandwidth_hz=reception.bandwidth_hz,
        )

    def course_step_s(self, step_s: float, *, filtered: bool) -> float | None:
        """The longest step, of an amplifier that clips."""
        return None if self.saturation_a is None else step_s

    def course_in_time(self, wave: Wave, time_s: Numbers, step_s: float) -> Numbers:
        """Signal behind an amplifier that clips and drains (docs/theory_receivers.md 2)."""
        assert self.saturation_a is not None
        return saturation.clipped_course(
            signal=wave.signal(time_s),
            step_s=step_s,
            saturation=float(self.saturation_a),
            recovery_s=float(self.recovery_s or 0.0),
        )


class ApdFile(Table[Apd]):
    """[detector] type = "apd"."""

    type: Literal["apd"]

    @model_validator(mode="after")
    def _one_excess_noise(self) -> ApdFile:
        if (self.excess_noise_index is None) == (self.ionisation_ratio is None):
            raise ValueError("one of excess_noise_index and ionisation_ratio must be given, got both or none")
        if self.recovery_ns is not None and self.saturation_ua is None:
            raise ValueError("recovery_ns: together with saturation_ua, from which the pulse recovers")
        return self
