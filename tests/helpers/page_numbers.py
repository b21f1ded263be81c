"""What the expressions beside the numbers of the documentation are made of: `tests/docs/test_numbers.py`.

An expression gives one number, or several in any nesting; `...` leaves one out.
"""

# ruff: noqa: F401  what is imported here and not used is named on a page: `test_every_name_is_used_on_a_page`

import argparse
import ast
import math
import pkgutil
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import norm
from validation.sipm_events.cells import CellArray
from validation.sipm_events.table import GRID_SIGNAL, rows_of_published_error

from helpers import false_alarms, scanners
from helpers.documentation import NUMBER, ROOT, text_of, value_of
from lidarscene import catalog, load_sensor
from lidarscene.cli import main
from lidarscene.detection.outcomes import Status
from lidarscene.detection.photon_counting import tuning as peak_tuning
from lidarscene.files import inputs, installed_llvm, pvlib
from lidarscene.formats.cloud_columns import columns_of
from lidarscene.kernel.device import backend
from lidarscene.kernel.rays import onward
from lidarscene.kernel.world import bsdfs
from lidarscene.light import air_light
from lidarscene.materials import colour
from lidarscene.materials.material_file import catalogue_material
from lidarscene.physics.amplifier import high_pass
from lidarscene.physics.amplifier.low_pass import LOW_PASSES
from lidarscene.physics.constants import ELEMENTARY_CHARGE_C, SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import apd, mcintyre, sampling, sipm, sipm_response, tdc
from lidarscene.physics.optics import (
    air,
    dielectrics,
    glint,
    pulse,
    receiver,
    reflection,
    scintillation,
    solar_spectrum,
    sunlight,
)
from lidarscene.physics.optics.polarisation import pane_shares
from lidarscene.physics.photon_counting import matched_filter, pile_up
from lidarscene.physics.reference import electronics as reference_electronics
from lidarscene.physics.reference import mcintyre as reference_mcintyre
from lidarscene.physics.reference import optics as reference_optics
from lidarscene.physics.reference import sipm as reference_sipm
from lidarscene.physics.reference import surroundings as reference_surroundings
from lidarscene.physics.road import roughness
from lidarscene.physics.weather import glory, mie, particles, precipitation
from lidarscene.rendering.render_options import TraceOptions
from lidarscene.scene import ride
from lidarscene.scene.street import traffic
from lidarscene.scene.weather import Weather
from lidarscene.sensor.sensor_model import PULSE_BANDWIDTH, Sensor
from lidarscene.studies import published_values
from lidarscene.studies.eye_safety.eye_safety_report import eye_safety_report
from lidarscene.studies.fit import noise_photons, recorded_pulses
from lidarscene.studies.fit import tuning as fit_tuning
from lidarscene.studies.fit.on_scene import pulses_on_scene
from lidarscene.studies.held import LIMITS, Held
from lidarscene.studies.paper import case
from lidarscene.studies.paper import numbers as paper
from lidarscene.studies.paper.case import (
    TABLE_1,
    apd_lidar,
    range_m,
    sipm_counts,
    sipm_in_time,
    sipm_printed,
    sipm_steady,
)
from lidarscene.studies.paper.numbers import closed_forms, percent
from lidarscene.studies.ranging import conditions, plane
from lidarscene.studies.ranging.conditions import CONDITIONS
from lidarscene.studies.ranging.plane import Target
from lidarscene.studies.twin import tuning as twin_tuning


@cache
def values(expression: str) -> list[Any]:
    """The numbers that an expression gives, in order."""
    return list(flat(eval(f"({' '.join(expression.split())})", globals())))


def flat(given: Any) -> Iterable[Any]:
    if isinstance(given, np.ndarray | list | tuple):
        for one in given:
            yield from flat(one)
    else:
        yield given


def const(name: str) -> Any:
    """A value below lidarscene by its dotted name."""
    return pkgutil.resolve_name(f"lidarscene.{name}")


def near(computed: float, share: float) -> Any:
    """A number that the page rounds more than its digits show."""
    return pytest.approx(computed, rel=share)


# --- numbers that are not computed here ---------------------------------------------------------------------


def oldest_python() -> float:
    return float(tomllib.loads(text_of(ROOT / "pyproject.toml"))["project"]["requires-python"].removeprefix(">="))


def measured(command: str, *figures: float) -> Sequence[float]:
    """Figures that a command measures, or a recording has: what it printed last, so that a digit changed is found."""
    for file in re.findall(r"\b(?:benchmarks|tools)/\w+\.(?:py|md)", command):
        assert (ROOT / file).is_file(), file
    return figures


def unchecked(experiment: str, *figures: float) -> Sequence[float]:
    """Figures of an experiment that nothing here repeats: a digit changed is found, and no more."""
    assert experiment
    return figures


def default(command: str, option: str) -> float:
    """Default of an option of the command line, as `-h` says."""
    (chosen,) = [a for a in main._parser()._actions if isinstance(a, argparse._SubParsersAction)]
    (action,) = [a for a in chosen.choices[command]._actions if option in a.option_strings]
    (text,) = re.findall(r"default:? (-?\d+(?:\.\d+)?)", action.help or "")
    assert action.default in (None, float(text))
    return float(text)


def bytes_per_point() -> int:
    """Size of a point with the truth, in memory."""
    return sum(np.dtype(column.dtype).itemsize for column in columns_of(truth=True, vectors=False))


RESULTS = text_of(ROOT / "benchmarks" / "RESULTS.md").splitlines()


def results(row: str, *columns: int) -> list[float]:
    """The first number of these cells of a row of benchmarks/RESULTS.md, which begins so."""
    cells = next(line for line in RESULTS if line.startswith(f"| {row} |")).split("|")
    return [value_of(NUMBER.findall(cells[column + 1])[0])[0] for column in columns]


def published(source: str, *figures: float) -> Sequence[float]:
    """Figures of a source, and what a page takes for granted."""
    assert source
    return figures


def held(file: str, *figures: float) -> Sequence[float]:
    """Figures that a test holds: each is written there, as it is or as a share of one where the page has percent."""
    written = literals(file)
    assert {float(figure) for figure in figures} <= written, f"{set(figures) - written} not in {file}"
    return figures


@cache
def literals(file: str) -> set[float]:
    """Every number that is written in a test file: as it is, and what a percentage of it would be."""
    text = text_of(ROOT / file)
    constants = [node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)]
    written = [float(value) for value in constants if isinstance(value, int | float)]
    written += map(float, re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])", text))
    return {round(k * number, 12) for number in written for k in (1.0, 100.0)}


# --- Table 1 ------------------------------------------------------------------------------------------------

APD, SIPM = apd_lidar(), sipm_printed()
FIELD_RAD = math.atan2(float(APD.detector.radius_m), float(APD.optics.focal_length_m))
BANDWIDTH_HZ, FWHM_S = float(APD.tdc.bandwidth_hz), float(APD.laser.pulse_fwhm_s)
SIGMA_M = 0.5 * SPEED_OF_LIGHT_M_S * FWHM_S / math.sqrt(8.0 * math.log(2.0))
PULSE_ENERGY = float(pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=1.0))
NOISE = case.apd_noise()
COUNTS = sipm_counts()


def light(*, distance_m: float = 100.0, **target: Any) -> Any:
    """Echo and sunlight of Table 1's plane, with changes."""
    return plane.echoes_of_plane(APD, Target(**target), distance_m)


def edge(tnr: float) -> tuple[float, float]:
    """sigma(U) / U, and the deviation by the straight line over that of the model."""
    sensor = apd_lidar(f"tdc.threshold_to_noise={tnr}")
    echo = light(distance_m=50.0)
    point = sensor.working_point(echo.background_power_w)
    level, peak = float(sensor.threshold(point)[0]), float(point.response.signal(echo.peak_power_w)[0])
    noise = {"noise": float(point.noise.deviation[0]), "kappa_1": point.noise.kappa_1, "kappa_2": point.noise.kappa_2}
    z = np.linspace(-4.9, 4.9, 20_001)
    weight = np.exp(-0.5 * z**2) / np.exp(-0.5 * z**2).sum()
    crossing = tdc.crossing_level(threshold=level, deviate=z, **noise)
    time_s = pulse.leading_edge_time_s(level=crossing / peak, fwhm_s=FWHM_S)
    model = np.sqrt((weight * (time_s - (weight * time_s).sum()) ** 2).sum())
    slope = peak * reference_optics.leading_edge_slope_per_s(level=level / peak, fwhm_s=FWHM_S)
    sigma = float(tdc.noise_at_level(level=level, **noise))
    return sigma / level, sigma / slope / float(model)


def walk_m(distance_m: float) -> float:
    echo = light(distance_m=distance_m)
    point = APD.working_point(echo.background_power_w)
    level = float(APD.threshold(point)[0] / point.response.signal(echo.peak_power_w)[0])
    return 0.5 * SPEED_OF_LIGHT_M_S * float(pulse.leading_edge_time_s(level=level, fwhm_s=FWHM_S))


def p_false(tnr: float) -> float:
    return float(tdc.false_alarm_probability(threshold=tnr, noise=1.0))


def rice_over_published(tnr: float) -> float:
    """Alarms by Rice over those of (10)."""
    rice = tdc.rice_rate_hz(threshold=tnr, noise=1.0, bandwidth_hz=BANDWIDTH_HZ)
    return float(rice / tdc.false_alarm_rate_hz(p_false=p_false(tnr), bandwidth_hz=BANDWIDTH_HZ))


def equal_klux(other: Sensor, probability: float | None = None) -> float:
    more = {} if probability is None else {"probability": probability}
    return float(plane.equal_range_illuminance_klux(APD, other, TABLE_1, **more))


def floor_klux() -> float:
    """Light below which TNR sigma is less than a cell, of the SiPM in steady state."""

    def over(klux: float) -> float:
        point = sipm_steady().working_point(light(illuminance_klux=klux).background_power_w)
        return 5.0 * float(point.noise.deviation[0]) - 1.0

    return brentq(over, 1e-3, 1.0)


def binomial_over_gaussian(klux: float) -> float:
    """False alarms of the SiPM with the count's own tail, over those of the Gaussian."""
    background_w = light(illuminance_klux=klux).background_power_w
    p = []
    for counting in ("binomial", "gaussian"):
        sensor = sipm_in_time(f"detector.counting='{counting}'")
        point = sensor.working_point(background_w)
        p.append(float(point.false_alarm_probability(sensor.threshold(point))[0]))
    return p[0] / p[1]


def gains() -> tuple[float, float]:
    """Gain of the best SNR, and that of equal optical and electrical noise."""
    parts = {
        "multiplied_variance_a2": NOISE.multiplied_a2,
        "unmultiplied_variance_a2": NOISE.unmultiplied_a2,
        "excess_noise_index": 0.3,
    }
    return float(apd.best_gain(**parts)), float(apd.gain_of_equal_noise(**parts))


def approximate_over_exact(distance_m: float, klux: float) -> float:
    """SNR by (28) over that by (27)."""
    counts = sipm_counts(distance_m=distance_m, illuminance_klux=klux)
    photons = {"signal_photons": counts.signal_photons, "background_photons": counts.background_photons}
    return float(sipm.snr_approximate(**photons, pde=counts.pde)) / case.snr_at(SIPM, distance_m, illuminance_klux=klux)


def slope_of_snr(sensor: Sensor, distance_m: float) -> float:
    """The power of the distance with which the SNR goes."""
    near_and_far = (case.snr_at(sensor, distance_m * k) for k in (1.0 / 1.01, 1.01))
    return -math.log(next(near_and_far) / next(near_and_far)) / (2.0 * math.log(1.01))


def best_radius_mm() -> float:
    """Aperture of the SiPM's longest range."""
    radii = np.arange(30.0, 60.0, 0.5)
    return float(radii[np.argmax([range_m(sipm_printed(f"optics.aperture_radius_mm={a}")) for a in radii])])


# --- light --------------------------------------------------------------------------------------------------


def extinction_per_m(visibility_km: float, nm: float, model: str) -> float:
    return float(
        air.extinction_from_visibility_per_m(visibility_m=1e3 * visibility_km, wavelength_m=1e-9 * nm, model=model)
    )


def cos(degrees: float) -> float:
    return math.cos(math.radians(degrees))


@cache
def paint_over_lambert(degrees: float) -> float:
    """The diffuse part of a paint, straight back, over rho / pi."""
    mi = backend.mitsuba()
    paint = {"bsdf": "coated", "coat_ior": 1.5, "coat_roughness": 0.05, "reflectivity": 0.4}
    whole = bsdfs.bsdf_dict(paint)
    whole["inner"]["specular_reflectance"] = 0.0
    bsdf = mi.load_dict(whole)
    surface = mi.SurfaceInteraction3f()
    surface.wi = mi.Vector3f(math.sin(math.radians(degrees)), 0.0, cos(degrees))
    back = mi.Vector3f(math.sin(math.radians(degrees)), 0.0, cos(degrees))
    per_sr = np.array(bsdf.eval(mi.BSDFContext(), surface, back, True)[0], dtype=float)[0] / cos(degrees)
    return float(per_sr * math.pi / 0.4)


def percent_of(material: str, nm: float, *keys: str) -> list[float]:
    numbers = catalogue_material(material).at(1e-9 * nm)
    return [100.0 * numbers[key] for key in keys]


def clear_glass(degrees: float) -> tuple[float, float]:
    """R and T of 4 mm at 905 nm, in percent."""
    glass = catalogue_material("clear_glass").at(905e-9)
    depth = dielectrics.optical_depth(index_k=glass["index_k"], thickness_m=4e-3, wavelength_m=905e-9)
    surface = dielectrics.fresnel_reflectance(cos_incidence=cos(degrees), index=glass["index_n"])
    internal = dielectrics.internal_transmittance(depth=depth, cos_incidence=cos(degrees), index=glass["index_n"])
    return (
        100.0 * float(dielectrics.pane_reflectance(surface=surface, internal=internal)),
        100.0 * float(dielectrics.pane_transmittance(surface=surface, internal=internal)),
    )


def clear_pane(degrees: float, index: float) -> Any:
    """What a pane that absorbs nothing lets through, across the plane of incidence and in it."""
    return pane_shares(cos_incidence=cos(degrees), index=index, internal=1.0, reflected=False)


def through_and_back(degrees: float) -> list[float]:
    """Light that a pane of n = 1.52 leaves there and back: by the mean reflectance, then s and p mixed, and kept."""
    face = dielectrics.fresnel_reflectance(cos_incidence=cos(degrees), index=1.52)
    mean = float(dielectrics.pane_transmittance(surface=face, internal=1.0)) ** 2
    pane = clear_pane(degrees, 1.52)
    back = 0.5 * (pane.across + pane.along)
    return [mean, pane.across * back, pane.along * back, pane.across**2, pane.along**2]


def pane_percent(degrees: float, *, kept: bool) -> list[float]:
    """What lies behind a pane, over what an unpolarised laser sees: across the plane of incidence and in it."""
    pane = clear_pane(degrees, 1.52)
    shares = np.array([pane.across, pane.along]) ** (2 if kept else 1)
    return [percent(share) for share in shares / shares.mean()]


def metal_contrast_percent(degrees: float, index: complex = 2.052 + 8.257j) -> float:
    """How much more than the mean aluminium reflects of s."""
    inside = np.sqrt(1.0 - (1.0 - cos(degrees) ** 2) / index**2)
    s = abs((cos(degrees) - index * inside) / (cos(degrees) + index * inside)) ** 2
    p = abs((index * cos(degrees) - inside) / (index * cos(degrees) + inside)) ** 2
    return 100.0 * (s - p) / (s + p)


def glint_boards(distance_m: float, off_mrad: float) -> float:
    """White boards as bright as a window pane: of 3 mrad from an exit of 10 mm, and a lens of 25 mm."""
    spot_rad = receiver.spot_radius_rad(exit_radius_m=5e-3, half_divergence_rad=1.5e-3, range_m=2.0 * distance_m)
    wide_m = 2.0 * distance_m * float(spot_rad)
    share = glint.share_on_aperture(
        profile="gaussian",
        aside_m=(2e-3 * distance_m * off_mrad, 0.0),
        spot_radius_m=(wide_m, wide_m),
        aperture_radius_m=0.025,
    )
    bright = glint.apparent_backscatter_per_sr(share=share, range_m=distance_m, aperture_m2=math.pi * 0.025**2)
    return math.pi * 0.08 * float(bright)


def speckle_rms(divergence_mrad: float, lens_mm: float, nm: float, line_nm: float = 0.0, degrees: float = 0.0) -> float:
    """1 / sqrt(M) at 50 m."""
    return float(
        scintillation.speckle_cells(
            spot_rad=0.5e-3 * divergence_mrad,
            range_m=np.float64(50.0),
            aperture_radius_m=1e-3 * lens_mm,
            wavelength_m=1e-9 * nm,
            linewidth_m=1e-9 * line_nm,
            cos_incidence=cos(degrees),
        )
        ** -0.5
    )


def turbulence_percent(distance_m: float) -> float:
    variance = scintillation.turbulence_variance(
        structure_constant=1e-13, range_m=np.float64(distance_m), wavelength_m=905e-9, aperture_radius_m=12.5e-3
    )
    return 100.0 * math.sqrt(variance)


def sun_disc_mw() -> float:
    return 1e3 * float(
        sunlight.sun_disc_power_w(
            sun_irradiance_w_m2=29.4,
            sun_angle_rad=0.0,
            field_rad=FIELD_RAD,
            aperture_m2=APD.optics.aperture_m2,
            efficiency=0.7986,
        )
    )


def sign_over_wall(share: float) -> list[float]:
    """A sign of R_A 120 over a wall of 10 %, the wall that stray light of it is [%], and how far vls-128 sees that."""
    bright = math.pi * 120.0 / 0.1
    sensor = load_sensor("vls-128")
    point = sensor.working_point(np.zeros(1))
    least_w = float(point.response.power_w(sensor.threshold(point))[0])
    wall_w_m2 = (
        float(sensor.laser.peak_power_w * sensor.optics.echo_efficiency * sensor.optics.aperture_m2) * 0.1 / math.pi
    )
    return [bright, 10.0 * share * bright, math.sqrt(wall_w_m2 * share * bright / least_w)]


OUSTER = load_sensor("os1-128", overrides=["scanner.columns_per_turn=1024"])


def pulse_mm(fwhm_s: float) -> float:
    return 1e3 * 0.5 * SPEED_OF_LIGHT_M_S * fwhm_s / math.sqrt(8.0 * math.log(2.0))


def glory_gains(distance_m: float) -> tuple[float, float]:
    """The least and the most of drops of 0.2, 0.3 and 0.4 mm, with a lens of 25 mm."""
    diameter_m, within_rad = np.linspace(0.2e-3, 0.4e-3, 41), np.array(0.0125 / distance_m)
    gain = glory.gain(diameter_m=diameter_m, wavelength_m=905e-9, within_rad=within_rad)[[0, 20, 40]]
    return gain.min(), gain.max()


# --- photon counting and fits ---------------------------------------------------------------------------------

HEAD_DWELL_S = 1.0 / (1024 * 10)
"""Of a column of the page's head.toml."""


def place_deviation_in_the_dark() -> float:
    """The noise of the place of the filter's peak by many photons of an echo, times their root, in sigmas (T176)."""
    signal = 1e9
    variance = signal * matched_filter.SIGNAL_VARIANCE
    place = matched_filter.place_variance(signal=signal, background=0.0, signal_variance=variance)
    return math.sqrt(signal * float(place))


def two_lenses(name: str) -> tuple[float, float]:
    """Where the axes of a file's lenses meet, and where it is in focus."""
    overlap = tomllib.loads(text_of(catalog.path_of("sensors", name)))["optics"]["overlap"]
    return overlap["parallax_free_at_m"], overlap["focus_at_m"]


# --- receivers ----------------------------------------------------------------------------------------------


def avalanche(light: str, tail: str) -> float:
    """P_f of the APD at TNR 5."""
    where = {"100 klux": {}, "10 klux": {"illuminance_klux": 10.0}, "night sky": {}}[light]
    return false_alarms.false_alarm_probability(APD, Target(**where), sky=light == "night sky", tail=tail)


def primaries() -> float:
    """Electrons of light and dark current that start an avalanche in a resolution time."""
    per_s = light().background_power_w[0] / APD.laser.photon_energy_j * 0.7
    per_s += APD.detector.bulk_dark_current_a / ELEMENTARY_CHARGE_C
    return float(per_s * mcintyre.resolution_time_s(bandwidth_hz=BANDWIDTH_HZ))


def saddle_point_percent(primaries: float) -> float:
    """Its error at worst, from one to eight standard deviations, with Table 1's avalanche and amplifier."""
    numbers = {"primaries": primaries, "gain": 80.0, "ionisation_ratio": 0.02225, "amplifier": 311.0}
    sigma = math.hypot(311.0, 80.0 * math.sqrt(primaries * 80.0**0.3))
    return 100.0 * max(
        1.0
        - mcintyre.tail_probability(excess=k * sigma, **numbers)
        / reference_mcintyre.tail_probability_exact(excess=k * sigma, **numbers)
        for k in (1.0, 3.0, 5.0, 8.0)
    )


def timing_cm(snr: float) -> list[float]:
    """Deviations without the echo's own noise: the slope formula, (T76) at half of the peak, (T77), (T79)."""
    x = sampling.widths(bandwidth_hz=BANDWIDTH_HZ, pulse_fwhm_s=FWHM_S)
    half = reference_electronics.fraction_deviation(
        fraction=0.5,
        noise_share_at_fraction=1.0 / snr,
        noise_share_at_peak=1.0 / snr,
        correlation=tdc.noise_correlation(lag_s=FWHM_S / 2.0, bandwidth_hz=BANDWIDTH_HZ),
    )
    peak = sampling.peak_deviation(noise_share=1.0 / snr, slope_noise=sampling.slope_noise(x=x), curvature=1.0)
    matched = sampling.peak_deviation(
        noise_share=math.sqrt(sampling.matched_noise_share(x=x)) / snr,
        slope_noise=sampling.matched_slope_noise(x=x),
        curvature=0.5,
    )
    straight = 1.0 / (5.0 * math.sqrt(2.0 * math.log(snr / 5.0)))
    return [100.0 * SIGMA_M * float(deviation) for deviation in (straight, half, peak, matched)]


def scales(*sensors: str) -> list[float]:
    """The value of white on the scale of intensity of these sensors, and where retro-reflectors begin and end."""
    (white,) = {load_sensor(name).intensity.white_value for name in sensors}
    return [white, white + 1.0, 255.0]


def matched_is_worse_below() -> float:
    """The width in the noise's time below which a matched filter leaves more noise, (T78)."""
    return brentq(lambda x: float(sampling.matched_noise_share(x=x)) - 1.0, 1.0, 3.0)


def intensity_gain_percent(name: str) -> float:
    scanner = load_sensor(name).scanner
    gain = np.asarray(scanner.intensity_gain(np.arange(scanner.lasers)), float)
    return 100.0 * float(np.std(gain / gain.mean()))


def best_cutoff(kind: str) -> float:
    """f t_FWHM of the best SNR in white noise."""

    def snr(log: float) -> float:
        share = LOW_PASSES[kind].peak_share(fwhm_s=np.array(1.0), cutoff_hz=math.exp(log))
        return float(share) / math.exp(0.5 * log)

    return math.exp(minimize_scalar(lambda log: -snr(log), bounds=(-4.0, 1.0), method="bounded").x)


# --- the SiPM, the sun, the weather --------------------------------------------------------------------------


def captured(fwhm_over_dead_time: float) -> float:
    """Photons in the count at its peak, over (24)'s half of the pulse."""
    return float(sipm_response.captured_photons(photons=1.0, pulse_fwhm_s=fwhm_over_dead_time, dead_time_s=1.0))


def exact_alarms(photons: float, tnr: float = 5.0) -> tuple[float, float]:
    """P_f of the count itself, and its skewness."""
    sensor = sipm_in_time("detector.counting='binomial'", f"tdc.threshold_to_noise={tnr}")
    power = photons * sensor.laser.photon_energy_j / sensor.detector.dead_time_s
    point = sensor.working_point(np.array([power]))
    x = photons * 0.22 / 400.0
    return (
        float(point.false_alarm_probability(sensor.threshold(point))[0]),
        float(reference_sipm.binomial_skewness(share=x / (1.0 + x), cells=400.0)),
    )


def published_errors() -> list[list[float]]:
    """Rows of the page: FWHM over dead time, background, and errors of (27) in percent, as printed and as counted."""
    array = CellArray(cells=400, pde=0.22, dead_time_s=6e-9, dark_count_rate_hz=2007.0)
    return [[float(word) for cell in row for word in cell.split(" / ")] for row in rows_of_published_error(array)]


@cache
def spectrum(name: str) -> Any:
    pytest.importorskip("pvlib")
    return pvlib.reference_spectrum(name)


def w_m2_nm(nm: float, width_nm: float = 20.0) -> float:
    """Mean irradiance at 100 klux of `global`."""
    box = solar_spectrum.box_filter(centre_m=1e-9 * nm, width_m=1e-9 * width_nm)
    return float(solar_spectrum.irradiance_at_100_klux_w_m2(spectrum("global"), box)) / width_nm


def sunlight_of(name: str) -> tuple[float, float]:
    """W/m2 and klux of a standard spectrum."""
    irradiance = reference_optics.total(spectrum(name))
    return float(irradiance), 1e-3 * float(solar_spectrum.illuminance_lux(spectrum(name)))


def box_nm(name: str) -> float:
    """Width of the box around 905 nm that lets Table 1's sunlight through."""
    return 1e9 * float(reference_optics.implied_box_width_m(spectrum(name), centre_m=905e-9, irradiance_w_m2=29.4))


def weather(unit_m: float, **kind: Any) -> list[float]:
    """Extinction, dB/km and lidar ratio at 905 and at 1550 nm, and the visibility in this unit."""
    air_and = Weather(**kind)
    row = []
    for nm in (905, 1550):
        (medium,) = air_and.media(1e-9 * nm)
        alpha = float(medium.extinction_per_m)
        row += [alpha, 1e4 * alpha / math.log(10.0), alpha / float(medium.backscatter_per_m_sr)]
    return [*row, 3.912 / float(air_and.extinction_at_per_m(550e-9)) / unit_m]


def lidar_ratio_range() -> tuple[float, float]:
    """The least and the most at 905 nm of fogs of droplets larger than those of radiation fog."""
    ratios = [
        weather(1.0, fog=fog)[2] for fog in ("strong_advection", "moderate_advection", "strong_spray", "chu_hogg")
    ]
    return min(ratios), max(ratios)


def carbonneau_lower_percent(rate_mm_h: float) -> float:
    """How much less Carbonneau's rain takes away than the rain here."""
    theirs = reference_surroundings.rain_extinction_carbonneau_per_m(rate_mm_h=rate_mm_h)
    return 100.0 * (1.0 - float(theirs / precipitation.rain_extinction_per_m(rate_mm_h=rate_mm_h)))


# --- the catalogue ------------------------------------------------------------------------------------------


def beams(*sensors: str) -> list[float]:
    """Divergences, and the size at the exit where the file has one, of sensors that have the same [mrad, mm]."""
    (sizes,) = {
        tuple(
            1e3 * float(size)
            for size in (laser.divergence_rad, laser.divergence_elevation_rad, laser.exit_diameter_m)
            if size is not None
        )
        for laser in (load_sensor(name).laser for name in sensors)
    }
    return list(dict.fromkeys(size for size in sizes if size))


FWHM_DEG = math.degrees(1e-3 * math.sqrt(0.5 * math.log(2.0)))
"""Full width at half maximum of a Gaussian beam of 1 mrad at 1/e^2."""


def risley_cone_deg(**faces: Any) -> float:
    """Field of view of a Mid-40's prisms."""
    scanner = scanners.mid40(frame_hz=1.0, **faces)
    return 2.0 * math.degrees(math.acos(scanner.direction(scanners.frame(scanner))[0].min()))


def nearest_seen_m(name: str) -> float:
    """Where the rim of the spot meets that of the detector's field, beside each other, the lens's width included."""
    seen = load_sensor(name).optics.overlap.geometry
    between_m = seen.alignment.offset_m - seen.spot.exit_radius_m - seen.aperture_radius_m
    return float(between_m / (seen.spot.half_divergence_rad + seen.field_rad))


@cache
def published_ranges() -> list[tuple[float, Held]]:
    """All published ranges, after the error of each, which is simulated over published minus one."""
    rows = [row for sensor in catalog.names("sensors") for row in published_values.compare_ranges(sensor)]
    return [(row.value, row) for row in rows if row.value is not None]


def single_range_errors() -> dict[str, float]:
    """Errors of the ranges that are the only one of their sensor."""
    count = Counter(row.subject for _, row in published_ranges())
    return {row.subject: error for error, row in published_ranges() if count[row.subject] == 1}


def range_errors(name: str, reflectivity_percent: int) -> tuple[float, float]:
    """The least and the largest error of all published ranges, which are those of this sensor and target."""
    errors = dict(published_ranges())
    farthest = [errors[end] for end in (min(errors), max(errors))]
    assert (name, f"{reflectivity_percent}%") in [(row.subject, row.condition[:3]) for row in farthest]
    return min(errors), max(errors)


@cache
def mode_error_percent(name: str) -> float:
    """Error of the mode that is farthest off."""
    rows = published_values.compare(name)
    return 100.0 * max(abs(row.value) for row in rows if row.quantity == "range factor" and row.value is not None)


def eye_margins(criterion: str) -> list[float]:
    """Limit, at rest and scanned where C5 makes two of it, and the margins."""
    still, moved = (
        next(
            c for c in eye_safety_report(APD, scanned=scanned).criteria if (c.subject, c.quantity) == ("eye", criterion)
        )
        for scanned in (False, True)
    )
    unit = 1e3 if criterion == "average power" else 1e9
    corrected = [float(c.note.split()[2]) for c in (still, moved) if c.note.startswith("C5")]
    limits = [unit * (still.reference or 0.0)]
    if corrected:
        limits = [limits[0], corrected[0], unit * (moved.reference or 0.0), corrected[1]]
    return [*limits, still.value, moved.value]
