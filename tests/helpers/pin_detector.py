"""A PIN diode as a newcomer would add it: sensor/detectors/test_new_detector.py puts this file among the others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from ...files.table_model import Table
from ...maths.arrays import Lanes, xp
from ...maths.units import Quantity, Slider
from ...physics.constants import ELEMENTARY_CHARGE_C
from ...physics.electronics import apd, counting
from .detector import Detector, Reception
from .working_point import Noise, Response, WorkingPoint


@dataclass(frozen=True, slots=True, kw_only=True)
class Pin(Detector):
    """PIN diode with its amplifier: an APD without avalanche. SI units."""

    label: ClassVar[str] = "PIN diode"
    unit: ClassVar[str] = "A"

    radius_m: Annotated[Lanes, Quantity("mm", ge=1e-3, le=100)]
    quantum_efficiency: Annotated[Lanes, Quantity(gt=0, le=1), Slider("efficiency", "", 0.01, 1.0)]
    dark_current_a: Annotated[Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6)] = 0.0
    circuit_noise_a: Annotated[Lanes, Quantity("na", ge=0, le=1e6, finest=1e-6)] = 0.0

    @property
    def saturates(self) -> bool:
        """Never."""
        return False

    def working_point(
        self, background_power_w: Lanes, reception: Reception, *, range_m: Lanes | None = None
    ) -> WorkingPoint:
        """Shot noise of light and dark current, and the noise of the circuit."""
        responsivity = apd.responsivity_a_w(
            quantum_efficiency=self.quantum_efficiency, photon_energy_j=reception.photon_energy_j
        )
        per_ampere = 2.0 * ELEMENTARY_CHARGE_C * reception.bandwidth_hz
        variance = per_ampere * (responsivity * background_power_w + self.dark_current_a)
        variance = variance + self.circuit_noise_a * self.circuit_noise_a
        return WorkingPoint(
            noise=Noise(deviation=xp(variance).sqrt(variance), kappa_1=per_ampere, kappa_2=0.0),
            response=Response(
                signal=lambda power_w: responsivity * power_w, power_w=lambda signal: signal / responsivity
            ),
        )

    def background_counts(self, background_power_w: Lanes, reception: Reception) -> tuple[Lanes, Lanes]:
        """Electrons a second."""
        light_hz = counting.detected_photons_hz(
            power_w=background_power_w, efficiency=self.quantum_efficiency, photon_energy_j=reception.photon_energy_j
        )
        return light_hz + self.dark_current_a / ELEMENTARY_CHARGE_C, 1.0


class PinFile(Table[Pin]):
    """[detector] type = "pin"."""

    type: Literal["pin"]
