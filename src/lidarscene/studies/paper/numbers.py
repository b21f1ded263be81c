"""Numbers behind the sentences on the paper: each function computes those of some claims or errata at Table 1.

sentences.toml names the functions and their numbers.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...physics.electronics import apd, range_limit, sipm, tdc
from ...physics.optics import pulse, radiometry
from ...sensor.detectors import Apd, Sipm
from ...sensor.sensor_model import Sensor
from ..ranging import aperture_laws, plane
from ..ranging.plane import Target
from .case import (
    FLOOR,
    TABLE_1,
    apd_lidar,
    apd_noise,
    range_m,
    ranges_m,
    sipm_counts,
    sipm_in_time,
    sipm_printed,
    sipm_steady,
    snr_at,
)

Numbers = dict[str, Any]
Load = Callable[..., Sensor]

EXCESS_NOISE_INDEX, GAIN = 0.3, 80.0
"""Source: Table 1 of the paper; excess noise index and gain of the diode."""

SHORT_PULSE = ("detector.cells=900", "detector.pde=0.15", "detector.dead_time_ns=11", "laser.pulse_fwhm_ns=2.2")
"""Cells whose dead time is five pulses long: nearly all of the pulse is in the count's peak."""


def percent(ratio: float) -> float:
    """Change in percent that a ratio is."""
    return 100.0 * (ratio - 1.0)


# --- section 2: the model ---------------------------------------------------------------------------------


def background_light() -> Numbers:
    """Sunlight on the detector, (8), at two ranges and at 60 degrees of incidence."""
    tilted = replace(TABLE_1, cos_incidence=0.5)
    near_w, far_w, tilted_w = (
        float(np.ravel(plane.echoes_of_plane(apd_lidar(), target, distance_m).background_power_w)[0])
        for target, distance_m in ((TABLE_1, 10.0), (TABLE_1, 500.0), (tilted, 10.0))
    )
    return {"near_w": near_w, "far_w": far_w, "tilted_w": tilted_w, "independent": near_w == far_w == tilted_w}


def detection() -> Numbers:
    """(9) and (10) at TNR 5."""
    p_false = float(tdc.false_alarm_probability(threshold=5.0, noise=1.0))
    at_threshold = float(tdc.detection_probability(signal=5.0, threshold=5.0, noise_at_peak=1.0))
    after = {m: float(tdc.correct_probability(p_false=p_false, p_detect=0.5, comparisons=m)) for m in (1, 400, 668)}
    return {
        "p_false": p_false,
        "rare": p_false < 3e-7,
        "at_threshold": at_threshold,
        "even": abs(at_threshold - 0.5) < 1e-9,
        "percent_of_400": 100.0 * after[400],
        "percent_of_668": 100.0 * after[668],
        "as_printed": round(100.0 * after[400], 3) == 99.977,
        "after_1": after[1],
        "after_400": after[400],
        "late_is_worse": after[1] > after[400],
    }


def apd_gain() -> Numbers:
    """The APD's gain: SNR without gain, at the best gain and at equal noise; McIntyre's excess noise; 10 % steps."""
    noise = apd_noise()
    parts = {
        "multiplied_variance_a2": noise.multiplied_a2,
        "unmultiplied_variance_a2": noise.unmultiplied_a2,
        "excess_noise_index": EXCESS_NOISE_INDEX,
    }
    best, equal = float(apd.best_gain(**parts)), float(apd.gain_of_equal_noise(**parts))
    gains = np.array([10.0, 30.0, GAIN, 200.0])
    # McIntyre: F = k M + (1 - k) (2 - 1 / M), linear in k.
    base = 2.0 - 1.0 / GAIN
    ionisation_ratio = (GAIN**EXCESS_NOISE_INDEX - base) / (GAIN - base)
    mcintyre = apd.excess_noise_mcintyre(gain=gains, ionisation_ratio=ionisation_ratio)
    changes = ("detector.quantum_efficiency=0.77", "laser.peak_power_w=49.5", "optics.efficiency_sun=0.71874")
    steps = [percent(snr_at(apd_lidar(change), 100.0) / snr_at(apd_lidar(), 100.0)) for change in changes]
    electrical_percent = 100.0 * noise.unmultiplied_a2 / (noise.unmultiplied_a2 + noise.multiplied_a2)
    bulk_dark_a2 = noise.bulk_dark_a2 * GAIN ** (2.0 + EXCESS_NOISE_INDEX)
    return {
        "electrical_percent": electrical_percent,
        "drowns": electrical_percent > 90.0,
        "snr_at_1": noise.snr(1.0),
        "snr_at_80": noise.snr(GAIN),
        "snr_at_best": noise.snr(best),
        "snr_at_equal": noise.snr(equal),
        "range_at_1_m": range_m(apd_lidar("detector.gain=1")),
        "ionisation_ratio": ionisation_ratio,
        "error_percent": 100.0 * (gains**EXCESS_NOISE_INDEX / mcintyre - 1.0),
        "step_percent": steps,
        "improve": min(steps) > 0.0,
        "best": best,
        "equal": equal,
        "ratio_at_best": noise.multiplied_a2 * best ** (2.0 + EXCESS_NOISE_INDEX) / noise.unmultiplied_a2,
        "two_over_index": 2.0 / EXCESS_NOISE_INDEX,
        "loss_percent": 100.0 * (1.0 - noise.snr(equal) / noise.snr(best)),
        "constant_percent": 100.0 * noise.unmultiplied_a2 / (noise.unmultiplied_a2 + bulk_dark_a2),
    }


def sipm_response() -> Numbers:
    """Cells that fire, (22), and dark counts."""
    efficiencies = np.array([0.1, 0.6])
    fired = [float(sipm.fired_cells_published(photons=200.0, pde=pde, cells=100.0)) for pde in efficiencies]
    free = [100.0 - float(sipm.fired_cells_published(photons=b, pde=0.22, cells=100.0)) for b in (0.0, 100.0, 1000.0)]
    dark = sipm_counts().dark
    return {
        "fired": fired,
        "linear_percent": 100.0 * np.array(fired) / (200.0 * efficiencies),
        # 10 % below the straight line, 1 - exp(-u) = 0.9 u, is at u = 0.21456.
        "linear_photons": [0.21456 * cells / 0.22 for cells in (100.0, 400.0)],
        "dark": dark,
        "small": dark < 1e-2,
        "free": free,
        "fewer": free[0] > free[1] > free[2],
    }


def sipm_snr() -> Numbers:
    """(27) as printed, its approximation (28), and cells in steady state and in time."""
    counts, limit_m = sipm_counts(), range_m(sipm_printed())
    edge = sipm_counts(distance_m=limit_m)
    printed, steady = (
        np.array([range_m(load(), illuminance_klux=klux) for klux in (100.0, 1.0)])
        for load in (sipm_printed, sipm_steady)
    )
    snr_printed, snr_steady, in_time_m = (
        snr_at(sipm_printed(), 100.0),
        snr_at(sipm_steady(), 100.0),
        range_m(sipm_in_time()),
    )
    background_percent = 100.0 * (counts.variance / (counts.variance + counts.dark))
    dim = snr_at(sipm_printed(), 900.0, illuminance_klux=1.0) / _approximate_snr(illuminance_klux=1.0, distance_m=900.0)
    return {
        "rough": [_approximate_snr(), _approximate_snr(distance_m=limit_m)],
        "snr_printed": snr_printed,
        "snr_steady": snr_steady,
        "snr_change_percent": percent(snr_steady / snr_printed),
        "load_percent": 100.0 * (edge.signal_photons * edge.pde / edge.cells),
        "busy_percent": 100.0 * counts.busy / counts.cells,
        "busy": counts.busy,
        "cells": counts.cells,
        "bound_m": float(plane.closed_form_range_m(sipm_printed(), TABLE_1)),
        "limit_m": limit_m,
        "dim_percent": percent(dim),
        "background_percent": background_percent,
        "dominated": background_percent > 99.0,
        "printed_m": printed,
        "steady_m": steady,
        "steady_percent": 100.0 * (steady / printed - 1.0),
        "in_time_m": in_time_m,
        "in_time_percent": percent(in_time_m / printed[0]),
    }


def _approximate_snr(**place: float) -> float:
    """(28) at an illuminance and a distance."""
    counts = sipm_counts(**place)
    return float(
        sipm.snr_approximate(
            signal_photons=counts.signal_photons, background_photons=counts.background_photons, pde=counts.pde
        )
    )


# --- section 3: the results -------------------------------------------------------------------------------


def _lever(sign: int, keys: Mapping[str, tuple[str, float]], factor: float = 1.0) -> Callable[[], Numbers]:
    """Percent of range per percent of a key, by a central difference of 1 %, and whether its sign is the paper's.

    Args:
        sign: that the paper gives
        keys: detector -> key and its value in Table 1; "": the reflectivity of the target
        factor: scale of the exponent: area goes with the square of a radius
    """

    def numbers() -> Numbers:
        slopes = {}
        for kind, (key, value) in keys.items():
            load = apd_lidar if kind == "apd" else sipm_printed
            up, down = (
                range_m(load(f"{key}={value * step}")) if key else range_m(load(), reflectivity=value * step)
                for step in (1.01, 1.0 / 1.01)
            )
            slopes[kind] = factor * math.log(up / down) / (2.0 * math.log(1.01))
        return {**slopes, "right": all(slope * sign > 0.0 for slope in slopes.values())}

    return numbers


def _on_both(key: str, value: float) -> dict[str, tuple[str, float]]:
    return {"apd": (key, value), "sipm": (key, value)}


def threshold() -> Numbers:
    """TNR 4 instead of 5: range and false alarms."""
    strict, loose = (float(tdc.false_alarm_probability(threshold=tnr, noise=1.0)) for tnr in (5.0, 4.0))
    longer = [range_m(load("tdc.threshold_to_noise=4")) / range_m(load()) for load in (apd_lidar, sipm_printed)]
    return {"longer": longer, "alarms": loose / strict, "right": min(longer) > 1.0 and loose > strict}


def shorter_pulse() -> Numbers:
    """Twice the power, half the pulse, twice the bandwidth."""
    change = ("laser.peak_power_w=90", "laser.pulse_fwhm_ns=3", "tdc.bandwidth_mhz=334")
    return {
        name: (range_m(load(*change)), range_m(load()))
        for name, load in (("apd_m", apd_lidar), ("sipm_m", sipm_printed))
    }


def snr_over_distance() -> Numbers:
    """Fig. 6(a)."""
    distances_m = np.geomspace(1.0, 1000.0, 400)
    of_apd, printed, steady = (plane.snr(s, TABLE_1, distances_m) for s in (apd_lidar(), sipm_printed(), sipm_steady()))
    noise, multiplied = apd_noise(), GAIN ** (2.0 + EXCESS_NOISE_INDEX)
    share = noise.optical_a2 * multiplied / (noise.multiplied_a2 * multiplied + noise.unmultiplied_a2)
    bound_apd_m, bound_sipm_m = (float(plane.closed_form_range_m(s, TABLE_1)) for s in (apd_lidar(), sipm_printed()))
    far_out = (bound_apd_m / bound_sipm_m) ** 2
    efficiency, excess = math.sqrt(0.70 / 0.22), math.sqrt(GAIN**EXCESS_NOISE_INDEX)
    limit_m = range_m(sipm_printed())
    single = float(sipm.fired_share_published(photons=1.0, pde=0.22, cells=400.0))
    photons_90 = math.log(10.0) / -math.log1p(-single)
    places = ((apd_lidar(), 280.0), (sipm_printed(), limit_m), (sipm_printed(), 1000.0))
    return {
        "least_printed": np.min(of_apd / printed),
        "least_steady": np.min(of_apd / steady),
        "ahead": np.min(of_apd / steady) > 1.0,
        "sun_percent": 100.0 * share,
        "efficiency": efficiency,
        "excess": excess,
        "given_back": far_out * excess / efficiency,
        "far_out": far_out,
        "at_limit": snr_at(apd_lidar(), limit_m) / 5.0,
        "highest": printed[0],
        "saturated_m": 100.0 * math.sqrt(sipm_counts().signal_photons / photons_90),
        "slope": [_slope(sensor, distance_m) for sensor, distance_m in places],
    }


def _slope(sensor: Sensor, distance_m: float) -> float:
    """Exponent of the SNR over distance."""
    low, high = plane.snr(sensor, TABLE_1, np.array([distance_m / 1.01, distance_m * 1.01]))
    return float(math.log(high / low) / (2.0 * math.log(1.01)))


def scan_edges() -> Numbers:
    """Fig. 6(b): the APD's range at -30, 0 and 30 degrees by each law of the aperture."""
    angles_deg = np.array([-30.0, 0.0, 30.0])
    return {
        law: plane.maximum_range_m(apd_lidar(), Target(aperture_share=aperture_laws.LAWS[law](angles_deg)))[0]
        for law in ("cosine", "mirror", "constant")
    }


def ranges_over_sun() -> Numbers:
    """Fig. 6(c)."""
    levels_klux = (10.0, 3.0, 1.0, 0.1, 0.01, 0.0)
    trios = [ranges_m((apd_lidar(), sipm_printed(), sipm_steady()), illuminance_klux=klux) for klux in levels_klux]
    ratio = [printed / of_apd for of_apd, printed, _ in trios]
    window_m = float(radiometry.range_from_time_of_flight_m(time_of_flight_s=4e-6))
    klux = np.geomspace(0.1, 100.0, 2000)
    reach_m = plane.maximum_range_m(apd_lidar(), Target(illuminance_klux=klux))[0]
    return {
        "equal_klux": plane.equal_range_illuminance_klux(apd_lidar(), sipm_printed(), TABLE_1),
        "equal_steady_klux": plane.equal_range_illuminance_klux(apd_lidar(), sipm_steady(), TABLE_1),
        "ratio": ratio,
        "rising": all(after > before for before, after in itertools.pairwise(ratio)),
        "floored": trios[-1][2] / trios[-1][0],
        "window_m": window_m,
        "window_klux": float(np.interp(-window_m, -reach_m, klux)),
    }


def conclusions() -> Numbers:
    """The engineering advice and the conclusions of 3.2."""
    pair = (apd_lidar, sipm_printed)
    of_pde = [range_m(sipm_steady(f"detector.pde={pde}")) for pde in (0.4, 0.6, 0.8)]
    many_cells = range_m(sipm_steady("detector.pde=0.6", "detector.cells=4000"))
    best_printed = _best_aperture(sipm_printed)
    return {
        "half": [range_m(load("optics.sun_irradiance_w_m2=14.7")) for load in pair],
        "narrow": [range_m(load("detector.radius_mm=0.05")) for load in pair],
        "plain": [range_m(load()) for load in pair],
        "dark": ranges_m((apd_lidar(), sipm_printed(), sipm_steady()), illuminance_klux=0.0),
        "of_pde": of_pde,
        "many_cells": many_cells,
        "more_cells_help": many_cells > of_pde[1],
        "best_printed": best_printed,
        "best_steady": _best_aperture(sipm_steady),
        "peaks": best_printed[0] < 200.0,
    }


def _best_aperture(load: Load) -> tuple[float, float]:
    """Aperture radius [mm] of the longest range, and that: the vertex of a parabola through the highest three of many
    radii, along logarithms.
    """
    radii = np.geomspace(5.0, 200.0, 120)
    ranges = [range_m(load(f"optics.aperture_radius_mm={radius}")) for radius in radii]
    top = min(max(int(np.argmax(ranges)), 1), len(radii) - 2)
    near = slice(top - 1, top + 2)
    bend, slope, _ = np.polyfit(np.log(radii[near]), ranges[near], 2)
    best = math.exp(-0.5 * slope / bend)
    return best, range_m(load(f"optics.aperture_radius_mm={best}"))


# --- errata -----------------------------------------------------------------------------------------------


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
    receiver = range_limit.Transceiver(
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


def closed_form_errata() -> Numbers:
    """(29) and (30) as printed and derived, and the ranges that they bound."""
    derived, printed = closed_forms(as_printed=False), closed_forms(as_printed=True)
    return {
        "derived": derived,
        "printed": printed,
        "root_percent": percent(1.0 / math.sqrt(TABLE_1.cos_sun)),
        "half_percent": 100.0 * (1.0 - 2.0**-0.25),
        "both_percent": percent(printed[0] / derived[0]),
        "apd_m": range_m(apd_lidar()),
        "sipm_m": range_m(sipm_printed()),
    }


def gain_of_bias() -> Numbers:
    """Gain at 95 % of the breakdown voltage: as printed, and by Miller."""
    bias = {"bias_v": 0.95, "breakdown_v": 1.0, "exponent": 0.7}
    return {"printed": float(apd.gain_from_bias(**bias)), "miller": float(apd.gain_from_bias_miller(**bias))}


def half_pulse() -> Numbers:
    """Range by (24)'s half of the pulse, and with the whole pulse followed in time."""
    steady_m, in_time_m = range_m(sipm_steady()), range_m(sipm_in_time())
    short_m = [range_m(load(*SHORT_PULSE)) for load in (sipm_steady, sipm_in_time)]
    return {
        "steady_m": steady_m,
        "in_time_m": in_time_m,
        "in_time_percent": percent(in_time_m / steady_m),
        "short_m": short_m,
        "short_percent": percent(short_m[1] / short_m[0]),
    }


def busy_cells() -> Numbers:
    """Busy cells by (23) and in steady state, and their variance."""
    counts = sipm_counts()

    def busy_share(photons: float, pde: float, cells: float) -> float:
        light = {"photons": photons, "pde": pde, "cells": cells}
        return float(sipm.busy_share_steady_state(**light, dark_count_rate_hz=0.0, dead_time_s=6e-9))

    share = busy_share(counts.background_photons, counts.pde, counts.cells)
    return {
        "busy": counts.busy,
        "busy_steady": counts.cells * share,
        "many": float(sipm.fired_cells_published(photons=2000.0, pde=0.22, cells=400.0)),
        "many_steady": 400.0 * busy_share(2000.0, 0.22, 400.0),
        "variance": counts.variance,
        "variance_steady": float(sipm.busy_variance_steady_state(busy_share=share, cells=counts.cells)),
        "printed_m": range_m(sipm_printed()),
        "steady_m": range_m(sipm_steady()),
        "thinned_percent": 100.0 * counts.pde / (2.0 * counts.cells),
    }


def pulse_energy() -> Numbers:
    """Energy of a Gaussian pulse over peak power times FWHM."""
    return {"energy_percent": percent(float(pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=1.0)))}


def cell_floor() -> Numbers:
    """Range in the dark, without and with a threshold of one cell at least."""
    printed_m, floored_m = ranges_m((sipm_printed(), sipm_printed(FLOOR)), illuminance_klux=0.0)
    return {"printed_m": printed_m, "floored_m": floored_m}


FUNCTIONS: dict[str, Callable[[], Numbers]] = {
    **{
        function.__name__: function
        for function in (
            background_light,
            detection,
            apd_gain,
            sipm_response,
            sipm_snr,
            threshold,
            shorter_pulse,
            snr_over_distance,
            scan_edges,
            ranges_over_sun,
            conclusions,
            closed_form_errata,
            gain_of_bias,
            half_pulse,
            busy_cells,
            pulse_energy,
            cell_floor,
        )
    },
    # What the text of 3.1 names, and the sign it gives.
    "lever_efficiency": _lever(1, {"apd": ("detector.quantum_efficiency", 0.70), "sipm": ("detector.pde", 0.22)}),
    "lever_aperture": _lever(1, _on_both("optics.aperture_radius_mm", 25.0), 0.5),
    "lever_reflectivity": _lever(1, _on_both("", 0.1)),
    "lever_sun": _lever(-1, _on_both("optics.sun_irradiance_w_m2", 29.4)),
    "lever_excess_noise": _lever(-1, {"apd": ("detector.excess_noise_index", EXCESS_NOISE_INDEX)}),
    "lever_power": _lever(1, _on_both("laser.peak_power_w", 45.0)),
    "lever_field_of_view": _lever(-1, _on_both("detector.radius_mm", 0.1)),
}
"""Name in sentences.toml -> what computes its numbers."""
