"""Numbers that all detectors of cells in Geiger mode have: efficiency and dark counts, and what moves them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated

from ...maths.arrays import Lanes
from ...maths.units import Quantity, Slider
from ...physics.electronics import geiger
from ...physics.optics.radiometry import disc_area_m2
from .detector import Detector

TOGETHER = (("temperature_k", "rated_temperature_k"), ("overvoltage_v", "rated_overvoltage_v", "trigger_voltage_v"))
"""Keys that are given together or not at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GeigerDetector(Detector):
    """Cells of a SiPM or SPADs of a pixel. SI units.

    Attributes:
        pde: photon detection efficiency at the rated overvoltage and temperature
        cell_gap_m: border between active areas; with it ``pde`` is that of the active area
        overvoltage_v: above the breakdown that the cells have at the rated temperature; the bias stays as it warms
        breakdown_drift_v_k: of the breakdown; None: the bias follows it
    """

    pde: Annotated[
        Lanes,
        Quantity(gt=0, le=1, about="photon detection efficiency; of the active area alone with `cell_gap_um`"),
        Slider("PDE", "", 0.01, 1.0),
    ]
    dark_count_rate_hz: Annotated[Lanes, Quantity(ge=0, le=1e9, about="of each cell or SPAD")]
    cell_gap_m: Annotated[
        Lanes | None,
        Quantity("um", ge=0, le=1000, about="border between active areas of square cells; it lowers the fill factor"),
    ] = None
    overvoltage_v: Annotated[
        Lanes | None, Quantity(gt=0, le=100, about="bias above breakdown, at the rated temperature")
    ] = None
    rated_overvoltage_v: Annotated[
        Lanes | None, Quantity(gt=0, le=100, about="at which `pde` and `dark_count_rate_hz` hold")
    ] = None
    trigger_voltage_v: Annotated[
        Lanes | None, Quantity(gt=0, le=100, about="V_0 of 1 - exp(-V / V_0), the chance of an avalanche")
    ] = None
    temperature_k: Annotated[Lanes | None, Quantity(ge=100, le=500, about="of the cells")] = None
    rated_temperature_k: Annotated[Lanes | None, Quantity(ge=100, le=500, about="at which the numbers above hold")] = (
        None
    )
    dark_doubling_k: Annotated[
        Lanes | None, Quantity(gt=0, le=100, about="warming that doubles the dark counts; none does if left out")
    ] = None
    breakdown_drift_v_k: Annotated[
        Lanes | None, Quantity(ge=0, le=1, about="of the breakdown under a fixed bias; the bias follows if left out")
    ] = None

    @property
    @abstractmethod
    def number_of_cells(self) -> Lanes:
        """Cells or SPADs on the disc of the photosensitive area."""

    @property
    def saturates(self) -> bool:
        """True: each cell counts an echo only once, and their number is finite."""
        return True

    @property
    def silicon(self) -> str:
        """Always."""
        return "a SiPM or SPAD is of silicon"

    @property
    def fill_factor(self) -> Lanes:
        """Active share of the area; 1 where ``pde`` has it."""
        if self.cell_gap_m is None:
            return 1.0
        return geiger.fill_factor(
            area_m2=disc_area_m2(radius_m=self.radius_m), cells=self.number_of_cells, gap_m=self.cell_gap_m
        )

    @property
    def warming_k(self) -> Lanes:
        """Temperature above the rated one."""
        if self.temperature_k is None or self.rated_temperature_k is None:
            return 0.0
        return self.temperature_k - self.rated_temperature_k

    @property
    def trigger_ratio(self) -> Lanes | None:
        """Chance of an avalanche over that at the rated overvoltage; None without an overvoltage."""
        if self.overvoltage_v is None or self.rated_overvoltage_v is None or self.trigger_voltage_v is None:
            return None
        volts = self.overvoltage_v
        if self.breakdown_drift_v_k is not None:
            volts = geiger.overvoltage_v(rated_v=volts, drift_v_k=self.breakdown_drift_v_k, warming_k=self.warming_k)
        now, rated = (
            geiger.trigger_probability(overvoltage_v=bias_v, scale_v=self.trigger_voltage_v)
            for bias_v in (volts, self.rated_overvoltage_v)
        )
        return now / rated

    @property
    def efficiency(self) -> Lanes:
        """Photon detection efficiency with fill factor, overvoltage and temperature."""
        efficiency = self.pde if self.cell_gap_m is None else self.pde * self.fill_factor
        ratio = self.trigger_ratio
        return efficiency if ratio is None else efficiency * ratio

    @property
    def dark_rate_hz(self) -> Lanes:
        """Dark counts of each cell with overvoltage and temperature."""
        rate, ratio = self.dark_count_rate_hz, self.trigger_ratio
        if self.dark_doubling_k is not None:
            rate = rate * geiger.dark_growth(warming_k=self.warming_k, doubling_k=self.dark_doubling_k)
        return rate if ratio is None else rate * ratio


def check_operation(detector: GeigerDetector) -> None:
    """Check that the numbers of overvoltage and temperature go together.

    Raises:
        ValueError: where some are missing, have no effect, or leave no avalanche
    """
    for keys in TOGETHER:
        given = [key for key in keys if getattr(detector, key) is not None]
        if given and len(given) < len(keys):
            raise ValueError(f"{', '.join(keys)}: must be given together, got {', '.join(given)}")
    moved = [key for key in ("dark_doubling_k", "breakdown_drift_v_k") if getattr(detector, key) is not None]
    if moved and detector.temperature_k is None:
        raise ValueError(f"{moved[0]}: must go with temperature_k, got none")
    if detector.temperature_k is not None and not moved:
        raise ValueError("temperature_k: must go with dark_doubling_k or breakdown_drift_v_k, got none of them")
    if detector.breakdown_drift_v_k is not None and detector.overvoltage_v is None:
        raise ValueError("breakdown_drift_v_k: must go with overvoltage_v, got none")
    if not detector.fill_factor > 0.0:
        raise ValueError("cell_gap_um: must be less than the pitch of the cells, so that some of them is active")
    if detector.trigger_ratio is not None and not detector.trigger_ratio > 0.0:
        raise ValueError("overvoltage_v: must be above the breakdown, which rises by breakdown_drift_v_k")
