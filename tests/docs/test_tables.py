"""The tables of the documentation, cell by cell against what the code computes, to the digits printed."""

import ast
import math
import re
import tomllib
from functools import cache

import numpy as np
import pytest
from helpers import false_alarms
from helpers.documentation import ROOT, printed_numbers, row_says, says, table, text_of, value_of
from scipy.stats import norm

from lidarscene import catalog, load_sensor
from lidarscene.files import pvlib
from lidarscene.light.footprint import points
from lidarscene.materials import colour
from lidarscene.materials.material_file import catalogue_material
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import sampling, sipm, tdc
from lidarscene.physics.optics import dielectrics, glint, receiver, reflection, scintillation, solar_spectrum
from lidarscene.physics.optics.polarisation import pane_shares
from lidarscene.physics.reference import electronics as reference_electronics
from lidarscene.physics.reference import optics as reference_optics
from lidarscene.scene.weather import Weather
from lidarscene.studies import published_values
from lidarscene.studies.eye_safety.eye_safety_report import eye_safety_report
from lidarscene.studies.held import Held
from lidarscene.studies.paper import case
from lidarscene.studies.paper.case import (
    FLOOR,
    TABLE_1,
    apd_lidar,
    range_m,
    sipm_counts,
    sipm_in_time,
    sipm_printed,
    sipm_steady,
)
from lidarscene.studies.paper.numbers import closed_forms
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

pytestmark = pytest.mark.fixed_streams

# --- theory -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("row", table("theory_glass.md", "at | by the mean r"), ids=lambda row: row[0])
def test_polarised_light_through_a_pane(row: list[str]) -> None:
    """There and back: mean of r, then s and p, with an unpolarised and with a polarised way back."""
    cosine = math.cos(math.radians(float(row[0].split()[0])))
    face = dielectrics.fresnel_reflectance(cos_incidence=cosine, index=1.52)
    mean = dielectrics.pane_transmittance(surface=face, internal=1.0) ** 2
    pane = pane_shares(cos_incidence=cosine, index=1.52, internal=1.0, reflected=False)
    back = 0.5 * (pane.across + pane.along)
    pairs = [mean, pane.across * back, pane.along * back, pane.across**2, pane.along**2]
    printed = [number for cell in row[1:] for number in cell.split(" / ")]
    assert printed == [f"{value:.2f}" for value in pairs]


@pytest.mark.parametrize("row", table("theory_light.md", "full divergence |"), ids=lambda row: row[0])
def test_speckle_at_1550_nm(row: list[str]) -> None:
    """The rms at each of the heading's radii of the lens."""
    for printed, lens_mm in zip(row[1:], (2.5, 5.0, 12.5), strict=True):
        assert printed == f"{speckle_rms(float(row[0].split()[0]), lens_mm, 1550.0):.2f}"


def speckle_rms(divergence_mrad: float, lens_mm: float, wavelength_nm: float, **more: float) -> float:
    """1 / sqrt(M) at 50 m; ``more`` are linewidth_m and cos_incidence."""
    numbers = {"linewidth_m": 0.0, "cos_incidence": 1.0} | more
    return float(
        scintillation.speckle_cells(
            spot_rad=0.5e-3 * divergence_mrad,
            range_m=np.float64(50.0),
            aperture_radius_m=1e-3 * lens_mm,
            wavelength_m=1e-9 * wavelength_nm,
            **numbers,
        )
        ** -0.5
    )


def test_sizes_of_fluctuations() -> None:
    slope = {"linewidth_m": 3e-9, "cos_incidence": math.cos(math.radians(10.0))}
    says("theory_light.md", "1 mrad and 12.5 mm have {} straight on", speckle_rms(1.0, 12.5, 905.0))
    says("theory_light.md", "straight on, and {} at 10 degrees and 50 m", speckle_rms(1.0, 12.5, 905.0, **slope))
    says("theory_light.md", "it is {} times that where M is large", 905.0 / 1550.0)
    rms = [
        100.0
        * math.sqrt(
            scintillation.turbulence_variance(
                structure_constant=1e-13, range_m=np.float64(range_m), wavelength_m=905e-9, aperture_radius_m=12.5e-3
            )
        )
        for range_m in (50.0, 100.0, 200.0)
    ]
    says("theory_light.md", "lens of 12.5 mm it is {}, {} and {} % at 50, 100 and 200 m", *rms)
    lidars = [
        load_sensor("mems-1550", overrides=["laser.divergence_mrad=1", *more]) for more in ([], ["laser.speckle={}"])
    ]
    near_m = 0.9 * plane.maximum_range_m(lidars[0], TABLE_1)[0]
    found = [float(plane.detection_probability(lidar, TABLE_1, near_m)[0]) for lidar in lidars]
    says("theory_light.md", "P_d falls from {} to {} at nine tenths", *found)
    field = float(load_sensor("table1-apd").detector.radius_m / load_sensor("table1-apd").optics.focal_length_m)
    says("limits.md", "half angle phi: {} % rho rho' at Table 1, 10 m", 100.0 * (field * 10.0 / 1.0) ** 2 / 3.0)


# --- validation -------------------------------------------------------------------------------------


@cache
def literals(file: str) -> set[float]:
    """Every number that is written in a test file: as it is, and what a percentage of it would be."""
    written = {
        float(node.value)
        for node in ast.walk(ast.parse(text_of(ROOT / file)))
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float)
    }
    words = {float(n.replace("_", "")) for n in re.findall(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.])", text_of(ROOT / file))}
    return {round(k * n, 12) for n in written for k in (1.0, 100.0)} | words


@pytest.mark.parametrize("row", table("validation.md", "check |"), ids=lambda row: row[0][:40])
def test_tolerances_are_those_of_the_tests(row: list[str]) -> None:
    """Every tolerance on the page is a number in one of the named test files."""
    files = re.findall(r"`(tests/[\w/]+\.py)", row[1])
    written = set().union(*map(literals, files))
    first = re.split("[;:]|a false alarm rate", row[2])[0]
    for number in re.findall(r"(?<![\w.(-])\d+(?:\.\d+)?(?:e-?\d+)?", first):
        assert round(float(number), 12) in written, f"{number} of '{row[0]}' is not in {files}"


def test_numbers_of_the_reference() -> None:
    printed_values = {row[0]: row[1] for row in table("validation.md", "quantity | value")}
    apd, printed = apd_lidar(), sipm_printed()
    light = plane.echoes_of_plane(apd, TABLE_1, 100.0)
    counts = sipm_counts()
    signal = printed.working_point(light.background_power_w).response.signal(light.peak_power_w)[0]
    p_false = tdc.false_alarm_probability(threshold=5.0, noise=1.0)
    comparisons = tdc.comparisons(window_s=4e-6, bandwidth_hz=100e6)
    p_correct = tdc.correct_probability(p_false=p_false, p_detect=0.5, comparisons=comparisons)
    share = sipm.busy_share_steady_state(
        photons=counts.background_photons, pde=0.22, cells=400.0, dark_count_rate_hz=0.0, dead_time_s=6e-9
    )
    floored = sipm_printed(FLOOR)
    ranges = {
        name: [range_m(sensor, illuminance_klux=klux) for klux in (100.0, 50.0, 10.0, 1.0)]
        for name, sensor in (("APD", apd), ("SiPM", printed))
    }
    expected = {
        "photon energy at 905 nm": (apd.laser.photon_energy_j,),
        "P_rs (8)": (light.background_power_w[0],),
        "P_r (5), 100 m": (light.peak_power_w[0],),
        "SNR (19), APD, 100 m": (case.snr_at(apd, 100.0),),
        "(22)-(24) at 100 m": (counts.background_photons, counts.busy, counts.signal_photons, signal),
        "SNR (27), SiPM, 100 m": (case.snr_at(printed, 100.0),),
        "R_max at 100, 50, 10, 1 klux, APD": tuple(ranges["APD"]),
        "R_max at 100, 50, 10, 1 klux, SiPM": tuple(ranges["SiPM"]),
        "illuminance of equal ranges": (plane.equal_range_illuminance_klux(apd, printed, TABLE_1),),
        "P_f (9) at TNR 5": (p_false,),
        "P_correct (10)": (p_correct,),
        "closed forms, derived": closed_forms(as_printed=False),
        "busy cells in steady state, variance": (
            400.0 * share,
            sipm.busy_variance_steady_state(busy_share=share, cells=400.0),
        ),
        "range in the dark without and with the floor": (
            range_m(printed, illuminance_klux=0.0),
            2600.0,  # a bound, which the test has
        ),
    }
    assert range_m(floored, illuminance_klux=0.0) < 2600.0
    says("validation.md", "a false alarm rate of {} per comparison", 2.0 * norm.sf(4.0))
    assert set(printed_values) == set(expected)
    for quantity, computed in expected.items():
        row_says([printed_values[quantity]], *computed)


# --- the catalogue ----------------------------------------------------------------------------------


def test_materials() -> None:
    rows = table("materials.md", "Material |")
    assert [row[0].strip("`") for row in rows] == catalog.names("materials")
    for row in rows:
        data = tomllib.loads(text_of(catalog.path_of("materials", row[0].strip("`"))))
        material = catalogue_material(row[0].strip("`"))
        assert row[1:3] == [data["description"], data["bsdf"]]
        sources = {spectrum_entry["wavelength_nm"]: spectrum_entry["source"] for spectrum_entry in data["reflectivity"]}
        stars = {nm: "*" * sources[nm].startswith("estimate") for nm in (905, 1550)}
        expected = [f"{material.at(nm * 1e-9)['reflectivity']:.3f}{stars[nm]}" for nm in (905, 1550)]
        assert row[3:5] == expected, row[0]


def test_what_a_colour_is_worth() -> None:
    exponents, spreads = table("materials.md", "by colour |")
    row_says(exponents[1:], *colour.EXPONENTS)
    row_says(spreads[1:], *colour.SPREADS)
    at_905, at_1550 = math.exp(colour.SPREADS[1]), math.exp(colour.SPREADS[-1])
    says("materials.md", "a factor of {} either way at 905 nm and {} at 1550 nm", at_905, at_1550)


def test_flat_angles_of_rough_surfaces() -> None:
    def backscatter(slope_deg: float, theta_deg: float) -> float:
        cos = math.cos(math.radians(theta_deg))
        relief = reflection.relief(math.radians(slope_deg))
        per_sr = reflection.rough_diffuse_per_sr(
            reflectivity=1.0, relief=relief, cos_in=cos, cos_out=cos, cos_between=1.0
        )
        return float(math.pi * per_sr * cos)

    brightness = [backscatter(slope, 83) / math.cos(math.radians(83)) for slope in (30, 45)]
    says("theory.md", "At 83 degrees it is {} and {} times as bright as Lambert's", *brightness)
    says("theory.md", "1 + {} K", (1.0 / reflection.largest_reflectivity(1e3) - 1.0) / float(reflection.relief(1e3)))


def test_wavelengths_of_materials() -> None:
    """Every file has these five, which the page names."""
    nm = []
    for name in catalog.names("materials"):
        data = tomllib.loads(text_of(catalog.path_of("materials", name)))
        if isinstance(data["reflectivity"], list):
            nm.append([row["wavelength_nm"] for row in data["reflectivity"]])
    assert nm
    assert all(wavelengths == nm[0] for wavelengths in nm)
    says("materials.md", "the wavelengths {}, {}, {}, {} and {} nm", *nm[0])
    says("theory.md", "A green leaf reflects {} % at 905 nm and lets {} % through", *leaf(905))
    says("theory.md", "at 1550 nm {} and {} (`leaf`)", *leaf(1550))


def leaf(nm: float) -> tuple[float, float]:
    values = catalogue_material("leaf").at(1e-9 * nm)
    return 100.0 * values["reflectivity"], 100.0 * values["transmittance"]


@cache
def check_published(name: str) -> list[Held]:
    return published_values.compare(name)


def test_published_against_simulated() -> None:
    """Largest errors of the ranges, in words that `catalog check` prints row by row."""
    ranges = [row for name in catalog.names("sensors") for row in published_values.compare_ranges(name)]
    errors = {row.value: row for row in ranges if row.value is not None}
    worst_low, worst_high = errors[min(errors)], errors[max(errors)]
    assert [(row.subject, row.condition[:3]) for row in (worst_low, worst_high)] == [
        ("os2-128", "80%"),
        ("os1-128", "10%"),
    ]
    says(
        "sensors.md",
        "up to {} % short (`os2-128`, 80 %) and up to {} % long (`os1-128`, 10 %)",
        -100.0 * min(errors),
        100.0 * max(errors),
    )


def test_modes_of_the_ousters() -> None:
    """The mode that is farthest off, of the 25."""
    farthest = {
        name: 100.0 * max(abs(row.value) for row in check_published(name) if row.quantity == "range factor")
        for name in ("os0-128", "os1-128", "os2-128")
    }
    says(
        "sensors.md",
        "`os1-128` and `os2-128` follow to {} %, `os0-128` to {} %",
        max(farthest["os1-128"], farthest["os2-128"]),
        farthest["os0-128"],
    )


def test_beams_of_the_catalogue() -> None:
    for names, printed, _ in table("sensors.md", "name | azimuth x elevation"):
        for name in re.findall(r"`([\w-]+)`", names):
            laser = load_sensor(name).laser
            sizes_rad = [laser.divergence_rad]
            if " x " in printed:
                sizes_rad.append(laser.divergence_elevation_rad)
            if "from" in printed:
                sizes_rad.append(laser.exit_diameter_m)
            row_says([printed], *(1e3 * float(size_rad) for size_rad in sizes_rad))
    documented_names = re.findall(
        r"`([\w-]+)`", " ".join(row[0] for row in table("sensors.md", "name | azimuth x elevation"))
    )
    wide = [name for name in catalog.names("sensors") if float(load_sensor(name).laser.divergence_rad) > 0.0]
    assert sorted(documented_names) == wide


def test_white_on_the_scales_of_intensity() -> None:
    for names, white, above, _ in table("theory.md", "sensors | white"):
        for name in re.findall(r"`([\w-]+)`", names):
            scale = load_sensor(name).intensity
            row_says([white], scale.white_value)
            if "%" not in above:
                row_says([above], scale.white_value + 1.0, 255.0)


def test_tails_of_the_avalanche() -> None:
    apd = apd_lidar()
    places = {
        "100 klux": {"target": TABLE_1},
        "10 klux": {"target": Target(illuminance_klux=10.0)},
        "night sky": {"target": TABLE_1, "sky": True},
    }
    rows = table("theory.md", "light | Gaussian")
    assert [row[0] for row in rows] == list(places)
    for row in rows:
        tails = ("gaussian", "mcintyre", "webb", "exact")
        row_says(row[1:], *(false_alarms.false_alarm_probability(apd, tail=tail, **places[row[0]]) for tail in tails))


def test_deviations_of_four_ways_to_time_a_pulse() -> None:
    """The ways, without the echo's own noise: the slope formula, (T76) at half of the peak, (T77), (T79)."""
    apd = apd_lidar()
    fwhm_s, bandwidth_hz = apd.laser.pulse_fwhm_s, apd.tdc.bandwidth_hz
    sigma_m = 0.5 * SPEED_OF_LIGHT_M_S * fwhm_s / math.sqrt(8.0 * math.log(2.0))
    x = sampling.widths(bandwidth_hz=bandwidth_hz, pulse_fwhm_s=fwhm_s)
    correlation = tdc.noise_correlation(lag_s=fwhm_s / 2.0, bandwidth_hz=bandwidth_hz)
    for row in table("theory.md", "SNR | edge"):
        noise = 1.0 / float(row[0])
        edge = 1.0 / (5.0 * math.sqrt(2.0 * math.log(float(row[0]) / 5.0)))
        half = reference_electronics.fraction_deviation(
            fraction=0.5, noise_share_at_fraction=noise, noise_share_at_peak=noise, correlation=correlation
        )
        peak = sampling.peak_deviation(noise_share=noise, slope_noise=sampling.slope_noise(x=x), curvature=1.0)
        matched = sampling.peak_deviation(
            noise_share=noise * math.sqrt(sampling.matched_noise_share(x=x)),
            slope_noise=sampling.matched_slope_noise(x=x),
            curvature=0.5,
        )
        row_says(row[1:], *(100.0 * sigma_m * float(deviation) for deviation in (edge, half, peak, matched)))


def test_glint_of_a_pane() -> None:
    """White boards as bright as a window pane: of 3 mrad from an exit of 10 mm, and a lens of 25 mm."""
    area_m2 = math.pi * 0.025**2
    heading = "distance | 0 mrad off | 1 mrad off | 2 mrad off"
    for distance, *boards in table("theory.md", heading):
        range_m = float(distance.removesuffix(" m"))
        spot_rad = receiver.spot_radius_rad(exit_radius_m=5e-3, half_divergence_rad=1.5e-3, range_m=2.0 * range_m)
        wide_m = 2.0 * range_m * float(spot_rad)
        for off_mrad, printed in enumerate(boards):
            share = glint.share_on_aperture(
                profile="gaussian",
                aside_m=(2e-3 * range_m * off_mrad, 0.0),
                spot_radius_m=(wide_m, wide_m),
                aperture_radius_m=0.025,
            )
            bright = 0.08 * glint.apparent_backscatter_per_sr(share=share, range_m=range_m, aperture_m2=area_m2)
            row_says([printed], math.pi * float(bright))


def test_rays_on_the_wrong_side_of_an_edge() -> None:
    random = np.random.default_rng(1)
    angle, distance = random.uniform(0.0, 2.0 * math.pi, 4000), random.uniform(-1.0, 1.0, 4000)
    beyond = norm.sf(2.0 * distance)
    across = np.stack([np.cos(angle), np.sin(angle)])
    for row in table("theory.md", "rays | spiral"):
        rays = int(row[0])
        for printed, places in zip(
            row[1:], (points("gaussian", rays), 0.5 * random.standard_normal((rays, 2))), strict=True
        ):
            share = (places @ across > distance).mean(axis=0)
            row_says([printed], 100.0 * math.sqrt(np.mean((share - beyond) ** 2)))


# --- weather ----------------------------------------------------------------------------------------

DECIBEL = 10.0 / math.log(10.0)


def weather_of(words: str) -> Weather:
    if words.startswith("`fog"):
        return Weather(fog=words.split('"')[1])
    rate = float(re.findall(r"(\d+) mm/h", words)[0])
    if words.startswith("rain"):
        return Weather(rain_mm_h=rate)
    return Weather(snow_mm_h=rate, snow=words.split()[0])


@pytest.mark.parametrize("row", table("weather.md", "weather | 905"), ids=lambda row: row[0])
def test_weather(row: list[str]) -> None:
    weather = weather_of(row[0])
    computed: list[float] = []
    for nm in (905, 1550):
        (medium,) = weather.media(1e-9 * nm)
        alpha = medium.extinction_per_m
        computed += [alpha, 1e3 * DECIBEL * alpha, alpha / medium.backscatter_per_m_sr]
    visibility_m = 3.912 / weather.extinction_at_per_m(550e-9)
    computed.append(1e-3 * visibility_m if row[-1].endswith("km") else visibility_m)
    row_says(row[1:], *computed)


# --- SiPM -------------------------------------------------------------------------------------------


def test_ranges_of_the_sipm() -> None:
    for row in table("sipm.md", "klux | (27)"):
        klux = float(row[0])
        row_says(
            row, klux, *(range_m(s, illuminance_klux=klux) for s in (sipm_printed(), sipm_steady(), sipm_in_time()))
        )


# --- the sun ----------------------------------------------------------------------------------------


def test_sun() -> None:
    pytest.importorskip("pvlib")
    spectra = {name: pvlib.reference_spectrum(name) for name in ("global", "direct", "extraterrestrial")}
    for name, _, w_m2, klux in table("sun.md", "name | what"):
        spectrum = spectra[name.split("`")[1]]
        row_says([w_m2], reference_optics.total_irradiance_w_m2(spectrum))
        row_says([klux], 1e-3 * solar_spectrum.illuminance_lux(spectrum))
    for name, width in table("sun.md", "spectrum | box"):
        box_m = reference_optics.implied_box_width_m(spectra[name.strip("`")], centre_m=905e-9, irradiance_w_m2=29.4)
        row_says([width], 1e9 * box_m)

    def mean(nm: float, width: float = 20.0) -> float:
        """W/m2/nm at 100 klux, of `global`."""
        box = solar_spectrum.box_filter(centre_m=1e-9 * nm, width_m=1e-9 * width)
        return float(solar_spectrum.irradiance_at_100_klux_w_m2(spectra["global"], box)) / width

    (row,) = table("sun.md", "nm | 850")
    row_says(row[1:], *(mean(nm) for nm in (850, 905, 940, 1064, 1550)))
    says("sun.md", "With a 20 nm box the same sensor would see {} W/m2", 20.0 * mean(905))


# --- eye safety -------------------------------------------------------------------------------------


def test_eye_safety_of_table_1() -> None:
    stationary, moved = (
        {c.quantity: c for c in report.criteria if c.subject == "eye"}
        for report in (eye_safety_report(load_sensor("table1-apd"), scanned=scanned) for scanned in (False, True))
    )
    rows = {row[0]: row[1:] for row in table("eye_safety.md", "| limit")}
    for name, unit in (("single pulse", 1e9), ("pulse train", 1e9), ("average power", 1e3)):
        check_still, check_moved = stationary[name], moved[name]
        c5 = [float(c.note.split()[2]) for c in (check_still, check_moved) if c.note.startswith("C5")]
        limits = [unit * (check_still.reference or 0.0)]
        if c5:
            limits += [c5[0], unit * (check_moved.reference or 0.0), c5[1]]
        row_says(rows[name], *limits, check_still.value, check_moved.value)
    powers = [
        eye_safety_report(load_sensor("table1-apd"), scanned=scanned).class_1_peak_power_w for scanned in (False, True)
    ]
    says("eye_safety.md", "at rest or scanned: {} W and {} W of peak power", *powers)


# --- what the tests themselves say ------------------------------------------------------------------


def test_error_of_the_table_in_time() -> None:
    (percent,) = printed_numbers("sipm.md", "it is good to {} % of the signal")
    assert round(value_of(percent)[0], 12) in literals("tests/validation/sipm_events/test_working_point.py")
