"""Numbers in the sentences of the documentation, against what the code computes, to the digits printed.

`says(page, words, ...)` finds the words on the page, once, and compares the number in place of each `{}`. Figures of
time and memory are measured, not computed: the page dates them and names the command.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import false_alarms
from helpers.documentation import says

from lidarscene import load_sensor
from lidarscene.materials.material_file import catalogue_material
from lidarscene.physics.constants import ELEMENTARY_CHARGE_C, SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import apd, mcintyre, sipm, sipm_response, tdc
from lidarscene.physics.optics import air, dielectrics, pulse, radiometry
from lidarscene.physics.optics.polarisation import pane_shares
from lidarscene.physics.reference import electronics as reference_electronics
from lidarscene.physics.reference import mcintyre as reference_mcintyre
from lidarscene.physics.reference import optics as reference_optics
from lidarscene.physics.reference import sipm as reference_sipm
from lidarscene.sensor.sensor_model import Sensor
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
from lidarscene.studies.paper.numbers import SHORT_PULSE, closed_forms
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

pytestmark = pytest.mark.fixed_streams

APD, SIPM = apd_lidar(), load_sensor("table1-sipm")
LIGHT = plane.echoes_of_plane(APD, TABLE_1, 100.0)


# --- theory -----------------------------------------------------------------------------------------


def test_light_and_air() -> None:
    says("theory.md", "Its energy is {} P_t t_FWHM", pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=1.0))
    says("theory.md", "Air at sea level is slower by 2.9e-4, {} mm at 100 m", 2.9e-4 * 100e3)
    says("theory.md", "({} % in Table 1, at any range)", 100.0 * TABLE_1.transmittance)
    alpha = {
        model: air.extinction_from_visibility_per_m(visibility_m=23e3, wavelength_m=905e-9, model=model)
        for model in ("kruse", "kim")
    }
    assert alpha["kruse"] == pytest.approx(alpha["kim"], rel=5e-3)
    says("theory.md", "{} per metre at 905 nm and 23 km", alpha["kim"])
    field = math.atan2(1e-4, 0.03)
    says("theory.md", "whose half angle is {} mrad at Table 1", 1e3 * field)
    says("theory.md", "At Table 1 (phi = {} mrad, the disc 4.65)", 1e3 * field)
    says(
        "theory.md",
        "with phi = {} mrad (Table 1) starts to lose light below r_A / phi = {} m",
        1e3 * field,
        0.025 / field,
    )
    says("theory.md", "is nearer than r_A f / r_PD ({} m at Table 1)", 0.025 * 0.03 / 1e-4)
    window_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=APD.tdc.window_s)
    says("theory.md", "the listening window not ({} us is {} m)", 1e6 * APD.tdc.window_s, window_m)


def test_retro_reflector() -> None:
    fall = (math.cos(math.radians(30.0)) / math.cos(math.radians(4.0))) ** 3.61
    says("theory.md", "which takes 250 at 4 degrees to {} at 30 degrees", 250.0 * fall)
    says("theory.md", "is at {} degrees to it at 6 m", math.degrees(0.02 / 6.0))


def test_sipm_of_table_1() -> None:
    energy = pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=1.0)
    says("theory.md", "for its energy, {} % less than a Gaussian's", 100.0 * (energy - 1.0))
    floor_klux = 0.023
    for klux, acts in ((floor_klux - 5e-4, True), (floor_klux + 5e-4, False)):
        light = plane.echoes_of_plane(SIPM, Target(illuminance_klux=klux), 100.0)
        point = SIPM.working_point(light.background_power_w)
        assert (TABLE_1_TNR * float(point.noise.deviation[0]) < 1.0) == acts, klux
    says("theory.md", "With Table 1 it would act below {} klux", floor_klux)
    ratio = {}
    for klux in (100.0, 1.0):
        p = []
        for counting in ("gaussian", "binomial"):
            sensor = sipm_in_time(f"detector.counting='{counting}'")
            light = plane.echoes_of_plane(sensor, Target(illuminance_klux=klux), 100.0)
            point = sensor.working_point(light.background_power_w)
            p.append(float(point.false_alarm_probability(sensor.threshold(point))[0]))
        ratio[klux] = p[1] / p[0]
    says("theory.md", "twice at 100 klux and {} times at 1 klux", pytest.approx(ratio[1.0], rel=0.05))
    assert round(ratio[100.0]) == 2


TABLE_1_TNR = 5.0


def test_edge() -> None:
    light = plane.echoes_of_plane(APD, TABLE_1, 50.0)
    point = APD.working_point(light.background_power_w)
    level = float(APD.threshold(point)[0] / point.response.signal(light.peak_power_w)[0])
    walk_s = pulse.leading_edge_time_s(level=level, fwhm_s=6e-9)
    says("theory.md", "is the walk error: {} m at 50 m", 0.5 * SPEED_OF_LIGHT_M_S * walk_s)
    share, line = edge_errors(5.0)
    says("theory.md", "At TNR 5 sigma_0 is {} % of U", 100.0 / 5.0)
    says("theory.md", "sigma(U) is {} %: the edge", 100.0 * share)
    short = 100.0 * (1.0 / line - 1.0)
    says("theory.md", "the straight line is {} to {} % short", math.floor(short), math.ceil(short))
    says("validation.md", "then {} to {} % above the straight line's", math.floor(short), math.ceil(short))
    says("validation.md", "the level moves by {} % ({} % without", 100.0 * share, 100.0 / 5.0)


def edge_errors(tnr: float) -> tuple[float, float]:
    """sigma(U) / U, and the deviation by the straight line over that of the model (the page's own example)."""
    sensor = load_sensor("table1-apd", overrides=[f"tdc.threshold_to_noise={tnr}"])
    light = plane.echoes_of_plane(sensor, TABLE_1, 50.0)
    point = sensor.working_point(light.background_power_w)
    level, peak = float(sensor.threshold(point)[0]), float(point.response.signal(light.peak_power_w)[0])
    noise_parameters = {
        "noise": float(point.noise.deviation[0]),
        "kappa_1": point.noise.kappa_1,
        "kappa_2": point.noise.kappa_2,
    }
    z = np.linspace(-4.9, 4.9, 20_001)
    weight = np.exp(-0.5 * z**2) / np.exp(-0.5 * z**2).sum()
    time_s = pulse.leading_edge_time_s(
        level=tdc.crossing_level(threshold=level, deviate=z, **noise_parameters) / peak, fwhm_s=6e-9
    )
    model = np.sqrt((weight * (time_s - (weight * time_s).sum()) ** 2).sum())
    slope = peak * reference_optics.leading_edge_slope_per_s(level=level / peak, fwhm_s=6e-9)
    sigma = float(tdc.noise_at_level(level=level, **noise_parameters))
    return sigma / level, sigma / slope / float(model)


def test_false_alarms() -> None:
    p_false = tdc.false_alarm_probability(threshold=5.0, noise=1.0)
    rate = tdc.false_alarm_rate_hz(p_false=p_false, bandwidth_hz=167e6)

    def rice(tnr: float) -> float:
        return float(tdc.rice_rate_hz(threshold=tnr, noise=1.0, bandwidth_hz=167e6))

    says("theory.md", "{} times as often at TNR 5:", rice(5.0) / rate)
    says("theory.md", "up to {} times rarer than those of band-limited noise", rice(5.0) / rate)
    says("limits.md", "band-limited noise crosses up to {} times as often", rice(5.0) / rate)
    equal = math.sqrt(25.0 + 2.0 * math.log(rice(5.0) / rate))
    says("theory.md", "TNR {} by Rice has the alarms of TNR 5 by (10)", equal)


def test_errata() -> None:
    derived, printed = closed_forms(as_printed=False), closed_forms(as_printed=True)
    counts, noise = sipm_counts(), case.apd_noise()
    short = 100.0 * (1.0 - 2.0**-0.25)
    says(
        "theory.md",
        "{} % too short; with the row above {} % too long ({} for {} m)",
        short,
        100.0 * (printed[0] / derived[0] - 1.0),
        printed[0],
        derived[0],
    )
    says(
        "theory.md",
        "with the first row {} % too long ({} for {} m)",
        100.0 * (printed[1] / derived[1] - 1.0),
        printed[1],
        derived[1],
    )
    parts = {
        "multiplied_variance_a2": noise.multiplied_a2,
        "unmultiplied_variance_a2": noise.unmultiplied_a2,
        "excess_noise_index": 0.3,
    }
    best, equal = float(apd.best_gain(**parts)), float(apd.gain_of_equal_noise(**parts))
    gains = (2.0 / 0.3, best, equal, noise.snr(best), noise.snr(equal), noise.snr(80.0), APD.detector.gain)
    says("theory.md", "factor {}; gain {}, not {}; SNR at 100 m {}, not {} ({} at the gain {} of the table)", *gains)
    says("paper.md", "2/x = {} times; best gain {}, equality at {}", *gains[:3])
    share = float(
        sipm.busy_share_steady_state(
            photons=counts.background_photons, pde=0.22, cells=400.0, dark_count_rate_hz=0.0, dead_time_s=6e-9
        )
    )
    variance = sipm.busy_variance_steady_state(busy_share=share, cells=400.0)
    says(
        "theory.md",
        "| {} busy cells, {} derived; variance {} and {}; {} m, {} m derived |",
        counts.busy,
        400.0 * share,
        counts.variance,
        variance,
        range_m(sipm_printed()),
        range_m(sipm_steady()),
    )
    steady, in_time = range_m(sipm_steady()), range_m(sipm_in_time())
    short = [range_m(make(*SHORT_PULSE)) for make in (sipm_steady, sipm_in_time)]
    says(
        "theory.md",
        "{} m by the half, {} m (+{} %); 900 cells of PDE 15 % and 11 ns with a pulse of 2.2 ns: {} m, {} m (+{} %)",
        steady,
        in_time,
        100.0 * (in_time / steady - 1.0),
        *short,
        100.0 * (short[1] / short[0] - 1.0),
    )
    unmultiplied_a2 = noise.unmultiplied_a2
    says(
        "theory.md",
        "| {} % of these terms do not depend on the gain |",
        100.0 * unmultiplied_a2 / (unmultiplied_a2 + 80.0**2.3 * noise.bulk_dark_a2),
    )
    says("theory.md", "| {} % of the photons, PDE / 2N |", 100.0 * 0.22 / 800.0)
    energy = pulse.pulse_energy_j(peak_power_w=1.0, fwhm_s=1.0)
    says("theory.md", "a Gaussian has {} times that | {} % of the photons", energy, 100.0 * (energy - 1.0))
    dark = [range_m(s, illuminance_klux=0.0) for s in (sipm_printed(), sipm_printed(FLOOR))]
    says("theory.md", "| {} m at 0 lux, {} m with the floor |", *dark)


def test_tails() -> None:
    k = mcintyre.ionisation_ratio(gain=80.0, excess_noise=80.0**0.3)
    says("theory.md", "F = 80^0.3 means k = {}", k)
    per_s = LIGHT.background_power_w[0] / APD.laser.photon_energy_j * 0.7
    per_s += APD.detector.bulk_dark_current_a / ELEMENTARY_CHARGE_C
    primaries = per_s * mcintyre.resolution_time_s(bandwidth_hz=167e6)
    says("theory.md", "With {} primaries in a resolution time", primaries)
    tail = {
        name: {
            tail: false_alarms.false_alarm_probability(APD, Target(illuminance_klux=klux), tail=tail)
            for tail in false_alarms.TAILS
        }
        for name, klux in (("bright", 100.0), ("dim", 10.0))
    }
    times = tail["bright"]["exact"] / tail["bright"]["gaussian"]
    says("theory.md", "the Gaussian has {} times too few alarms", times)
    says("theory.md", "has {} times too few at Table 1 (`tail", times)
    says("limits.md", "the APD's avalanche has {} times as many", times)
    equal = 5.0
    while (
        false_alarms.false_alarm_probability(with_threshold(equal), TABLE_1, tail="exact") > tail["bright"]["gaussian"]
    ):
        equal += 0.05
    says("theory.md", "and TNR {} is needed for the alarms that (9) promises", pytest.approx(equal, abs=0.05))
    percent_off = {n: saddle_point(n) for n in (24.0, 2.4, 0.5)}
    assert 0.4 < percent_off[0.5] < 0.6
    says(
        "theory.md",
        "The saddle point is {} % low with 24 primaries, {} % with 2.4",
        100 * percent_off[24.0],
        100 * percent_off[2.4],
    )
    assert float(tail["dim"]["exact"]) > 600 * tail["dim"]["gaussian"]


def with_threshold(tnr: float) -> Sensor:
    return load_sensor("table1-apd", overrides=[f"tdc.threshold_to_noise={tnr}"])


def saddle_point(primaries: float) -> float:
    """Its share of error at worst, from one to eight standard deviations, with Table 1's avalanche and amplifier."""
    numbers = {"primaries": primaries, "gain": 80.0, "ionisation_ratio": 0.02225, "amplifier": 311.0}
    sigma = math.hypot(311.0, 80.0 * math.sqrt(primaries * 80.0**0.3))
    return max(
        1.0
        - mcintyre.tail_probability(excess=k * sigma, **numbers)
        / reference_mcintyre.tail_probability_exact(excess=k * sigma, **numbers)
        for k in (1.0, 3.0, 5.0, 8.0)
    )


def test_saturation() -> None:
    light = plane.echoes_of_plane(APD, Target(reflectivity=0.8), 20.0)
    point = APD.working_point(light.background_power_w)
    signal, level = float(point.response.signal(light.peak_power_w)[0]), float(APD.threshold(point)[0])
    bias = reference_electronics.walk_bias_m(threshold=level, signal=signal, saturation=50e-6, fwhm_s=6e-9)
    says(
        "theory.md", "a wall of 80 % at 20 m has {} times that and is reported {} m too near", signal / 50e-6, abs(bias)
    )
    h = 5.0 + np.random.default_rng(1).exponential(1.0 / 5.0, 100_000)
    width = tdc.excursion_width_s(threshold=5.0, height=h, bandwidth_hz=167e6)
    says("theory.md", "{} ns in the mean at TNR 5 and 167 MHz", 1e9 * float(np.mean(width)))


def test_a_road_stretches_an_echo() -> None:
    """A quarter of the divergence at 1/e^2 is the beam's deviation, on ground that runs away by R / h of it."""
    pulse_m, ground_m = 0.5 * SPEED_OF_LIGHT_M_S * 5e-9 / 2.354820045, 45.0 * 0.25 * 3e-3 * 45.0 / 2.4
    says("limits.md", "pulse of 5 ns | the echo {} times as long", math.hypot(1.0, ground_m / pulse_m))


def test_panes() -> None:
    r60 = [dielectrics.fresnel_reflectance(cos_incidence=0.5, index=n) for n in (1.5,)]
    mean = float(dielectrics.pane_reflectance(surface=r60[0], internal=1.0))
    cos_t = math.sqrt(1.0 - 0.75 / 2.25)
    across = ((0.5 - 1.5 * cos_t) / (0.5 + 1.5 * cos_t)) ** 2
    along = ((1.5 * 0.5 - cos_t) / (1.5 * 0.5 + cos_t)) ** 2
    separate = 0.5 * sum(2.0 * r / (1.0 + r) for r in (across, along))
    says("theory.md", "the mean of the two panes mirrors {} % and not {}", 100.0 * separate, 100.0 * mean)
    shares = 100.0 * np.array([clear_glass(degrees) for degrees in (0, 60, 75)]).T
    says("theory.md", "mirror {}, {} and {} % and let {}, {} and {} % through", *shares.ravel())
    pane = pane_shares(cos_incidence=math.cos(math.radians(62.0)), index=1.52, internal=1.0, reflected=False)
    mean, mean_kept = 0.5 * (pane.across + pane.along), 0.5 * (pane.across**2 + pane.along**2)
    says("theory.md", "right mean of s and p, {} at 62 degrees", mean**2)
    kept = (100.0 * (share**2 / mean_kept - 1.0) for share in (pane.across, pane.along))
    says("limits.md", "{} % across the plane of incidence, +{} % in it, against an unpolarised one", *kept)
    matt = (100.0 * (share / mean - 1.0) for share in (pane.across, pane.along))
    says("limits.md", "a diffuse surface {} and +{} %", *matt)
    metal = []
    for degrees in (45.0, 60.0):
        cosine, index = math.cos(math.radians(degrees)), complex(2.052, 8.257)
        inside = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)
        s = abs((cosine - index * inside) / (cosine + index * inside)) ** 2
        p = abs((index * cosine - inside) / (index * cosine + inside)) ** 2
        metal.append(100.0 * (s - p) / (s + p))
    says(
        "theory.md", "aluminium reflects {} % more of s, and less of p, than their mean at 45 degrees, and {} %", *metal
    )
    water = 1.0 - (1.0 - reference_optics.diffuse_fresnel_reflectance(1.33)) / 1.33**2
    says("theory.md", "p = 1 - (1 - R_d) / n^2, {} for water", water)
    wet, dry = (catalogue_material(name).at(905e-9)["reflectivity"] for name in ("asphalt_wet", "asphalt"))
    says("theory.md", "{} instead of {} at 905 nm", wet, dry)
    says("theory.md", "adds tau / pi times its 0.005 sr, {} % of the sun", 100.0 * 0.505 / math.pi * 0.005)


def clear_glass(degrees: float) -> tuple[float, float]:
    """R and T of 4 mm at 905 nm."""
    values = catalogue_material("clear_glass").at(905e-9)
    cosine, index = math.cos(math.radians(degrees)), values["index_n"]
    depth = dielectrics.optical_depth(index_k=values["index_k"], thickness_m=4e-3, wavelength_m=905e-9)
    surface = dielectrics.fresnel_reflectance(cos_incidence=cosine, index=index)
    internal = dielectrics.internal_transmittance(depth=depth, cos_incidence=cosine, index=index)
    reflectance = dielectrics.pane_reflectance(surface=surface, internal=internal)
    return float(reflectance), float(dielectrics.pane_transmittance(surface=surface, internal=internal))


def test_two_boards() -> None:
    sigma_m = 0.5 * SPEED_OF_LIGHT_M_S * 6e-9 / math.sqrt(8.0 * math.log(2.0))
    says("theory.md", "are apart from {} m on at best", 2.0 * sigma_m)
    d = math.sqrt(8.0 * math.log(4.0))
    says("theory.md", "from {} m on if the level is at half of one echo's peak", d * sigma_m)


# --- the guides -------------------------------------------------------------------------------------


def test_sipm_page() -> None:
    short_pulse = sipm_response.captured_photons(photons=1.0, pulse_fwhm_s=1.0, dead_time_s=1e3)
    equal_duration = sipm_response.captured_photons(photons=1.0, pulse_fwhm_s=1.0, dead_time_s=1.0)
    says("sipm.md", "light in the count at its peak, {} times what (24) has", short_pulse)
    says("sipm.md", "a pulse as long as tau has {} times", equal_duration)
    low, high = 0.1, 10.0
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        more = sipm_response.captured_photons(photons=1.0, pulse_fwhm_s=middle, dead_time_s=1.0) > 1.0
        low, high = (middle, high) if more else (low, middle)
    says("sipm.md", "(24) counts right at FWHM = {} tau only", low)
    p = {}
    for photons in (686.093, 50.0):
        exact = sipm_in_time("detector.counting='binomial'")
        power = photons * exact.laser.photon_energy_j / exact.detector.dead_time_s
        point = exact.working_point(np.array([power]))
        share = photons * 0.22 / 400.0 / (1.0 + photons * 0.22 / 400.0)
        p[photons] = (
            float(point.false_alarm_probability(exact.threshold(point))[0]),
            float(reference_sipm.binomial_skewness(share=share, cells=400.0)),
        )
    gaussian = tdc.false_alarm_probability(threshold=5.0, noise=1.0)
    says(
        "sipm.md",
        "P_f at TNR 5: {} by (9), {} exactly at 686 background photons (skewness {}), {} at 50 ({})",
        gaussian,
        *p[686.093],
        *p[50.0],
    )


def test_crosstalk() -> None:
    """The pulse is weak, under Table 1's sun: the events' number is held by test_what_crosstalk_costs, to 0.03."""
    snr_and_probability = []
    for keys in ((), ("detector.crosstalk=0.1",), ("detector.crosstalk=0.25",)):
        sensor = sipm_in_time(*keys)
        photon = sensor.laser.photon_energy_j
        point = sensor.working_point(np.array([686.093 * photon / 6e-9]))
        signal = point.response.signal(np.array([2.0 * 311.96 * photon / 6e-9]))
        sigma = np.sqrt(point.noise.deviation**2 + point.noise.kappa_1 * signal + point.noise.kappa_2 * signal**2)
        p_detect = point.detection_probability(sensor.threshold(point), signal, sigma)
        snr_and_probability.append((float(signal[0] / point.noise.deviation[0]), float(p_detect[0])))
    loss = [100.0 * (1.0 - snr / snr_and_probability[0][0]) for snr, _ in snr_and_probability]
    says(
        "theory.md",
        "where P_d is {} without, 10 % of crosstalk cost {} % of the SNR and leave {}, and 25 % cost {} % and leave {}",
        snr_and_probability[0][1],
        loss[1],
        snr_and_probability[1][1],
        loss[2],
        snr_and_probability[2][1],
    )


def test_stray_light() -> None:
    """A sign over a wall by (T8) and (5); how far its stray light is as much as the least that is found in the dark."""
    sign_to_wall = math.pi * 120.0 / 0.1
    sensor = load_sensor("vls-128")
    point = sensor.working_point(np.zeros(1))
    least_w = float(point.response.power_w(sensor.threshold(point))[0])
    optics = sensor.optics
    wall_w_m2 = float(sensor.laser.peak_power_w * optics.echo_efficiency * optics.aperture_m2) * 0.1 / math.pi
    says(
        "theory_light.md",
        "shines {} times as bright as a wall of 10 %, and with a share of 1e-4 it is a wall of {} % beside: `vls-128` "
        "would find it in the dark up to {} m",
        sign_to_wall,
        100.0 * 0.1 * 1e-4 * sign_to_wall,
        math.sqrt(wall_w_m2 * 1e-4 * sign_to_wall / least_w),
    )


def test_turn_of_the_head() -> None:
    """(T124) and (T126) of a column of 1024 at 10 Hz; the pulse's own width in range."""
    sensor = load_sensor("os1-128", overrides=["scanner.columns_per_turn=1024"])
    spread_m = math.tan(math.radians(60.0)) * 20.0 * sensor.sweep_rad / math.sqrt(12.0)
    pulse_m = 0.5 * SPEED_OF_LIGHT_M_S * float(sensor.laser.pulse_fwhm_s) / math.sqrt(8.0 * math.log(2.0))
    says("theory_light.md", "with 1024 columns at 10 Hz {} mrad", 1e3 * sensor.sweep_rad)
    alike, apart = 1.0 - math.sqrt(0.5), 0.5 * 0.5  # SPADs fired by half of the light in all shots, by all in half
    says("photon_counting.md", "fires half of the SPADs, {} % too many photons", 100.0 * (alike / apart - 1.0))
    says("photon_counting.md", "stand meanwhile: {} mm at 30 m/s", 30e3 / (1024 * 10))
    says(
        "theory_light.md",
        "{} mm at 20 m and 60 degrees by the sweep alone, beside {} mm of a pulse of {} ns",
        1e3 * spread_m,
        1e3 * pulse_m,
        1e9 * float(sensor.laser.pulse_fwhm_s),
    )


def test_paper_page() -> None:
    linear_fractions = [
        sipm.fired_cells_published(photons=200.0, pde=pde, cells=100.0) / (200.0 * pde) for pde in (0.1, 0.6)
    ]
    says(
        "paper.md",
        "200 photons on 100 cells give {} % of linear at 10 %, {} % at 60 %",
        *(100.0 * f for f in linear_fractions),
    )
    ranges = {k: [range_m(s, illuminance_klux=k) for s in (sipm_printed(), sipm_steady())] for k in (100.0, 1.0)}
    more = {k: 100.0 * (b / a - 1.0) for k, (a, b) in ranges.items()}
    says("paper.md", "{} % of range at 100 klux from busy cells alone, {} % at 1 klux", more[100.0], more[1.0])
    limit = ranges[100.0][0]
    near, far = (case.snr_at(sipm_printed(), limit * k) for k in (1.0 / 1.01, 1.01))
    says("paper.md", "SiPM R^{} at its limit", math.log(far / near) / (2.0 * math.log(1.01)))
    equal = plane.equal_range_illuminance_klux(apd_lidar(), sipm_printed(), TABLE_1)
    says("paper.md", "equal ranges at {} klux", equal)
    says("paper.md", "| below {} klux |", equal)
    says("paper.md", "dark counts of {} a dead time", 400 * 2007.0 * 6e-9)
    comparisons = tdc.comparisons(window_s=4e-6, bandwidth_hz=100e6)
    p_correct = tdc.correct_probability(
        p_false=tdc.false_alarm_probability(threshold=5.0, noise=1.0), p_detect=0.5, comparisons=comparisons
    )
    says("paper.md", "P_correct of {} %", 100.0 * p_correct)
    radii = np.arange(30.0, 60.0, 0.5)
    best = radii[int(np.argmax([range_m(sipm_printed(f"optics.aperture_radius_mm={a}")) for a in radii]))]
    says("paper.md", "has a best radius, {} mm at 100 klux", best)
    rough = {
        (d, k): float(
            sipm.snr_approximate(signal_photons=c.signal_photons, background_photons=c.background_photons, pde=c.pde)
        )
        / case.snr_at(sipm_printed(), d, illuminance_klux=k)
        for d, k in ((limit, 100.0), (100.0, 100.0), (900.0, 1.0))
        for c in [sipm_counts(distance_m=d, illuminance_klux=k)]
    }
    bound = closed_forms(as_printed=False)[1]
    says(
        "paper.md",
        "{} % in SNR and {} % in range at the limit, a factor {} at 100 m, {} % at 1 klux",
        100.0 * (rough[limit, 100.0] - 1.0),
        100.0 * (bound / limit - 1.0),
        rough[100.0, 100.0],
        100.0 * abs(rough[900.0, 1.0] - 1.0),
    )
    says("limits.md", "is the paper's approximation, {} % off in SNR at the limit", 100.0 * (rough[limit, 100.0] - 1.0))


def test_range_page() -> None:
    at_nine_tenths = plane.equal_range_illuminance_klux(apd_lidar(), sipm_printed(), TABLE_1, probability=0.9)
    lit = replace(TABLE_1, illuminance_klux=at_nine_tenths)
    says(
        "range.md",
        "`crossing at {} klux: table1-apd rises above table1-sipm, {} m`",
        at_nine_tenths,
        plane.detection_range_m(apd_lidar(), lit, 0.9)[0],
    )
    reached_m = plane.detection_range_m(apd_lidar(), TABLE_1, 0.9)[0]
    snr = float(plane.snr(apd_lidar(), TABLE_1, reached_m)[0])
    says("range.md", "`table1-apd: range {} m at P_d {}, where SNR {}`", reached_m, 0.9, snr)
    says("compare.md", "{} klux for the paper's APD and SiPM", at_nine_tenths)
    equal = plane.equal_range_illuminance_klux(apd_lidar(), sipm_printed(), TABLE_1)
    in_time = plane.equal_range_illuminance_klux(apd_lidar(), sipm_in_time(), TABLE_1)
    says("theory.md", "equal at {} klux by (27), at {} klux in the time domain", equal, in_time)


def test_wavelength_of_oblique_light() -> None:
    shifts = (905.0 / math.sqrt(1.0 - (math.sin(math.radians(angle)) / 1.8) ** 2) - 905.0 for angle in (5.0, 14.0))
    says("theory_light.md", "at 905 nm and n = 1.8 that is {} nm at 5 degrees and {} at 14", *shifts)
    says("theory_light.md", "from 25 to 85 degrees the edge emitter moves by {} nm", 0.28 * 60.0)


def test_effects_page() -> None:
    says("effects.md", "a mounting that slipped turns the cloud, {} cm at 10 m", 100.0 * 10.0 * 5e-3)
    says("effects.md", "Blanking hides what is nearer than {} m", 0.5 * SPEED_OF_LIGHT_M_S * 20e-9)
