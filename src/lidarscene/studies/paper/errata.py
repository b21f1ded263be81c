"""What the paper prints, what follows from its own equations, and how large the difference is at Table 1.

`lidarscene` uses the derived forms; this table says why, and what it changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...physics.electronics import apd, range_limit, sipm
from ...physics.optics import pulse
from ...sensor.detectors import Apd, Sipm
from .case import FLOOR, TABLE_1, apd_lidar, apd_noise, range_m, sipm_counts, sipm_in_time, sipm_printed, sipm_steady

SHORT_PULSE = ("detector.cells=900", "detector.pde=0.15", "detector.dead_time_ns=11", "laser.pulse_fwhm_ns=2.2")
"""Cells whose dead time is five pulses long: nearly all of the pulse is in the count's peak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Erratum:
    """One row of the table."""

    place: str
    printed: str
    derived: str
    size: str


def closed_forms(*, as_printed: bool) -> tuple[float, float]:
    """(29) and (30) at Table 1, metres."""
    sensor, cells = apd_lidar(), sipm_printed().detector
    diode = sensor.detector
    assert isinstance(diode, Apd)
    assert isinstance(cells, Sipm)
    assert sensor.tdc.threshold_to_noise is not None
    target = range_limit.Plane(
        reflectivity=TABLE_1.reflectivity,
        sun_irradiance_w_m2=sensor.optics.sun_irradiance_w_m2,
        transmittance=TABLE_1.transmittance,
        cos_sun=TABLE_1.cos_sun,
    )
    receiver = range_limit.Receiver(
        peak_power_w=sensor.laser.peak_power_w,
        aperture_m2=sensor.optics.aperture_m2,
        photon_energy_j=sensor.laser.photon_energy_j,
        focal_over_radius=sensor.optics.focal_length_m / diode.radius_m,
        threshold_to_noise=sensor.tdc.threshold_to_noise,
        efficiency_laser=sensor.optics.efficiency_laser,
        efficiency_sun=sensor.optics.efficiency_sun,
    )
    apd_m = range_limit.maximum_range_apd_m(
        target,
        receiver,
        quantum_efficiency=diode.quantum_efficiency,
        excess_noise=diode.excess_noise,
        bandwidth_hz=sensor.tdc.bandwidth_hz,
        as_printed=as_printed,
    )
    sipm_m = range_limit.maximum_range_sipm_m(
        target,
        receiver,
        pulse_fwhm_s=sensor.laser.pulse_fwhm_s,
        pde=cells.pde,
        dead_time_s=cells.dead_time_s,
        as_printed=as_printed,
    )
    return float(apd_m), float(sipm_m)


def errata() -> list[Erratum]:
    """All of them, formulas first."""
    return [*_closed_forms(), *_gain(), *_cells(), *_words()]


def _closed_forms() -> list[Erratum]:
    derived, printed = closed_forms(as_printed=False), closed_forms(as_printed=True)
    root = 1.0 / math.sqrt(TABLE_1.cos_sun)
    half = 2.0**-0.25
    return [
        Erratum(
            place="(29), (30)",
            printed="a factor 1 / cos θs before the root",
            derived="none: (5) and (8) put cos θs under the root only",
            size=f"ranges {100 * (root - 1):.0f} % too long at 60°: (30) gives {printed[1]:.3f} for {derived[1]:.3f} m",
        ),
        Erratum(
            place="(29)",
            printed="a factor 1/2",
            derived="1/sqrt(2): shot noise 2 e i B has one factor 2 under the root",
            size=f"range {100 * (1 - half):.0f} % too short; with the row above "
            f"{100 * (printed[0] / derived[0] - 1):.0f} % too "
            f"long, {printed[0]:.3f} for {derived[0]:.3f} m",
        ),
        Erratum(
            place="(29), (30)",
            printed="maximum range",
            derived="an upper bound: the background's shot noise alone, no saturation",
            size=f"derived {derived[0]:.3f} and {derived[1]:.3f} m; (19) and (27) give "
            f"{range_m(apd_lidar()):.3f} and "
            f"{range_m(sipm_printed()):.3f} m",
        ),
    ]


def _gain() -> list[Erratum]:
    noise = apd_noise()
    parts = {
        "multiplied_variance_a2": noise.multiplied_a2,
        "unmultiplied_variance_a2": noise.unmultiplied_a2,
        "excess_noise_index": 0.3,
    }
    best, equal = float(apd.best_gain(**parts)), float(apd.gain_of_equal_noise(**parts))
    bias = {"bias_v": 0.95, "breakdown_v": 1.0, "exponent": 0.7}
    forms = float(apd.gain_from_bias(**bias)), float(apd.gain_from_bias_miller(**bias))
    dark = noise.bulk_dark_a2 * 80.0**2.3
    return [
        Erratum(
            place="after (20)",
            printed="optical noise equals electrical noise at the best gain",
            derived="d SNR / dM = 0 gives M^(2+x) = 2c / (x (a + b)): the multiplied variance is 2/x times the rest",
            size=f"factor {2 / 0.3:.2f}; gain {best:.2f}, not {equal:.2f}; SNR at 100 m {noise.snr(best):.2f}, not "
            f"{noise.snr(equal):.2f}",
        ),
        Erratum(
            place="after (19)",
            printed="the last three terms depend on the multiplication factor alone",
            derived="of them only the bulk dark current's share of the second does; the rest is (20)'s constant c",
            size=f"{100 * noise.unmultiplied_a2 / (noise.unmultiplied_a2 + dark):.0f} % of these three terms do not "
            "depend on the gain",
        ),
        Erratum(
            place="under (12)",
            printed="M = (1 - V/Vbd)^-n",
            derived="Miller: M = 1 / (1 - (V/Vbd)^n), the same at n = 1 only",
            size=f"at V = 0.95 Vbd and n = 0.7: {forms[0]:.1f} for {forms[1]:.1f}; not used, Table 1 gives the gain",
        ),
    ]


def _cells() -> list[Erratum]:
    counts = sipm_counts()
    share = float(
        sipm.busy_share_steady_state(
            photons=counts.background_photons,
            pde=counts.pde,
            cells=counts.cells,
            dark_count_rate_hz=0.0,
            dead_time_s=6e-9,
        )
    )
    variance = float(sipm.busy_variance_steady_state(busy_share=share, cells=counts.cells))
    many = [
        float(sipm.fired_cells_published(photons=2000.0, pde=0.22, cells=400.0)),
        400.0
        * float(
            sipm.busy_share_steady_state(
                photons=2000.0, pde=0.22, cells=400.0, dark_count_rate_hz=0.0, dead_time_s=6e-9
            )
        ),
    ]
    steady = range_m(sipm_steady())
    short_pulse = [range_m(make(*SHORT_PULSE)) for make in (sipm_steady, sipm_in_time)]
    whole = [steady, range_m(sipm_in_time())]
    dark = [range_m(sensor, illuminance_klux=0.0) for sensor in (sipm_printed(), sipm_printed(FLOOR))]
    energy = float(pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=1.0))
    return [
        Erratum(
            place="(24)",
            printed="half of the pulse's photons fire cells: those that have come when it peaks",
            derived="a cell stays busy for the dead time, so the count peaks with all light of the last dead time in "
            "it: up to twice the half, and cells that fired early are missing",
            size=f"range by the half {whole[0]:.1f} for {whole[1]:.1f} m ({100 * (whole[1] / whole[0] - 1):+.0f} %); "
            "900 cells of PDE 15 %, dead for 11 ns, and a pulse of 2.2 ns: "
            f"{short_pulse[0]:.1f} for {short_pulse[1]:.1f} m ({100 * (short_pulse[1] / short_pulse[0] - 1):+.0f} %)",
        ),
        Erratum(
            place="(23), and with it (24) and (25)",
            printed="N_b = N (1 - exp(-x)): every dead time starts with all cells alive",
            derived="a cell dead for tau after firing is busy x / (1 + x) of the time",
            size=f"{counts.busy:.1f} busy cells for {counts.cells * share:.1f}; at 2000 photons {many[0]:.1f} for "
            f"{many[1]:.1f}; variance {counts.variance:.1f} for {variance:.1f}; SiPM range "
            f"{range_m(sipm_printed()):.1f} for {steady:.1f} m",
        ),
        Erratum(
            place="(S2), hence (22)",
            printed="k photons split evenly over the cells",
            derived="Poisson light thinned over the cells: 1 - exp(-n PDE / N)",
            size=f"{100 * counts.pde / (2 * counts.cells):.3f} % of the photons (PDE / 2N)",
        ),
        Erratum(
            place="under (24)",
            printed="pulse energy P_r B_pulse",
            derived="a Gaussian pulse has sqrt(pi / 4 ln 2) of it",
            size=f"{100 * (energy - 1):.1f} % of the photons; the printed form is kept",
        ),
        Erratum(
            place="(27) in the dark",
            printed="SNR 5 decides",
            derived="sigma falls below one cell, and a "
            "comparator cannot see "
            "less than one: the threshold needs a floor",
            size=f"{dark[0]:.1f} m at 0 lux, {dark[1]:.1f} m with the floor",
        ),
    ]


def _words() -> list[Erratum]:
    return [
        Erratum(
            place="under (15)",
            printed="k_e is the electron ionization rate",
            derived="the ratio of the holes' rate to the electrons', as McIntyre's F needs it",
            size="none",
        ),
        Erratum(place="(S6)", printed="standard deviation", derived="it is the variance", size="none"),
        Erratum(place="after (10)", printed="according to Eq. (5)", derived="Eq. (10)", size="none"),
        Erratum(
            place="before (12), before (18), after (28), after (30)",
            printed="Eq. (14); Eq. (15,16,17) into Eq. (15); improve the APD trigger SNR; Eq. (28, 29)",
            derived="Eq. (12); (15)-(17) into (13); the SiPM's; Eq. (29, 30)",
            size="none",
        ),
    ]
