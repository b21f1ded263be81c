"""Every equation of the paper, at Table 1, against the equation typed out by hand.

Tolerance where none is said: float64 rounding, 1e-12 relative.
"""

from math import cos, exp, factorial, log, pi, sqrt

import pytest
from helpers.table_1 import (
    AVALANCHE,
    BW,
    CELLS,
    CS,
    DARK,
    DCR,
    DEAD,
    ESUN,
    ETA_R,
    ETA_RS,
    EXPONENT,
    FM,
    FWHM,
    HNU,
    IDB,
    IDS,
    K_PD,
    N_BP,
    N_SP,
    P_R,
    P_RS,
    PDE,
    PT,
    QE,
    RECEIVER,
    RHO,
    RL,
    RPD,
    TAU,
    THETA,
    TNR,
    A,
    F,
    M,
    N,
    R,
    T,
    X,
    field_of_view_sr,
    noise_18,
    plane_and_receiver,
    sigma_18,
)
from scipy.constants import c, e, k
from scipy.stats import norm

from lidarscene.physics.electronics import apd, range_limit, sipm, tdc
from lidarscene.physics.optics import pulse, radiometry
from lidarscene.physics.reference import apd as ref_apd
from lidarscene.physics.reference import electronics as ref_tdc
from lidarscene.physics.reference import optics as ref_optics
from lidarscene.physics.reference import sipm as ref_sipm

CASES = {
    "1": (radiometry.range_from_time_of_flight_m(time_of_flight_s=1e-6), c * 1e-6 / 2),
    "2": (ref_optics.time_of_flight_from_beat_s(beat_frequency_hz=1e6, chirp_rate_hz_s=1e12), 1e6 / 1e12),
    "3": (
        ref_optics.lambertian_intensity_w_sr(
            reflectivity=RHO, transmittance=TAU, peak_power_w=PT, cos_incidence=cos(THETA)
        ),
        RHO * TAU * PT / pi * cos(THETA),
    ),
    "4": (radiometry.aperture_solid_angle_sr(aperture_m2=A, range_m=R), A / R**2),
    "5": (
        ref_optics.lambertian_echo_power_w(
            peak_power_w=PT, reflectivity=RHO, cos_incidence=cos(THETA), range_m=R, efficiency=ETA_R, **RECEIVER
        ),
        P_R,
    ),
    "6, A_b": (
        ref_optics.field_of_view_area_m2(range_m=R, detector_radius_m=RPD, focal_length_m=F, cos_incidence=cos(THETA)),
        pi * (R * RPD / F) ** 2 / cos(THETA),
    ),
    "6": (ref_optics.sun_flux_w(sun_irradiance_w_m2=ESUN, seen_area_m2=0.4, cos_sun=CS), ESUN * 0.4 * CS),
    "7": (
        ref_optics.sun_intensity_w_sr(
            sun_flux_w=ESUN * pi * (R * RPD / F) ** 2 / cos(THETA) * CS, reflectivity=RHO, cos_incidence=cos(THETA)
        ),
        ESUN * RHO * R**2 * (RPD / F) ** 2 * CS,
    ),
    "8": (
        ref_optics.lambertian_sun_power_w(
            sun_irradiance_w_m2=ESUN,
            reflectivity=RHO,
            cos_sun=CS,
            field_of_view_sr=field_of_view_sr(RPD, F),
            efficiency=ETA_RS,
            **RECEIVER,
        ),
        P_RS,
    ),
    "10": (
        tdc.correct_probability(p_false=norm.sf(5), p_detect=0.5, comparisons=400.0),
        (1 - norm.sf(5)) ** 399 * 0.5 / (1 - (1 - norm.sf(5)) ** 399 * 0.5),
    ),
    "11": (tdc.signal_to_noise(signal=7.0, noise=2.0), 3.5),
    "12": (
        ref_apd.signal_a(
            responsivity_a_w=apd.responsivity_a_w(quantum_efficiency=QE, photon_energy_j=HNU), gain=M, power_w=P_R
        ),
        e / HNU * M * QE * P_R,
    ),
    "12, M printed": (apd.gain_from_bias(bias_v=150.0, breakdown_v=200.0, exponent=0.5), (1 - 0.75) ** -0.5),
    "12, M Miller": (apd.gain_from_bias_miller(bias_v=150.0, breakdown_v=200.0, exponent=3.0), 1 / (1 - 0.75**3)),
    "F, k_e": (apd.excess_noise_mcintyre(gain=M, ionisation_ratio=0.02), 0.02 * M + (1 - 0.02) * (2 - 1 / M)),
    "F, M^x": (apd.excess_noise_power_law(gain=M, index=X), M**X),
    "13": (
        ref_apd.total_noise_a(
            signal_variance_a2=1.0,
            background_variance_a2=2.0,
            dark_variance_a2=3.0,
            thermal_variance_a2=4.0,
            circuit_noise_a=5.0,
        ),
        sqrt(1 + 2 + 3 + 4 + 5**2),
    ),
    "14, 15": (
        apd.light_shot_variance_a2(responsivity_a_w=K_PD, power_w=P_R, **AVALANCHE),
        2 * e * K_PD * P_R * M**2 * FM * BW,
    ),
    "16": (
        apd.dark_shot_variance_a2(surface_dark_current_a=IDS, bulk_dark_current_a=IDB, **AVALANCHE),
        2 * e * IDS * BW + 2 * e * IDB * M**2 * FM * BW,
    ),
    "17": (apd.thermal_variance_a2(temperature_k=T, load_resistance_ohm=RL, bandwidth_hz=BW), 4 * k * T * BW / RL),
    "best gain, k_e": (
        # k M^3 + (1 - k) M = 2 c / (a + b) at its root
        (lambda g: 0.02 * g**3 + 0.98 * g)(
            apd.best_gain_mcintyre(multiplied_variance_a2=1e-20, unmultiplied_variance_a2=3e-16, ionisation_ratio=0.02)
        ),
        2 * 3e-16 / 1e-20,
    ),
    "21": (
        ref_sipm.photon_detection_efficiency(quantum_efficiency=0.7, trigger_probability=0.5, fill_factor=0.6),
        0.7 * 0.5 * 0.6,
    ),
    "22, 23, S5": (sipm.fired_cells_published(photons=N_SP, **CELLS), N * (1 - exp(N_SP * EXPONENT))),
    "23, photons": (sipm.background_photons(power_w=P_RS, dead_time_s=DEAD, photon_energy_j=HNU), P_RS * DEAD / HNU),
    "23, N_d": (sipm.dark_counts(cells=N, **DARK), N * DCR * DEAD),
    "24, photons": (
        sipm.signal_photons(peak_power_w=P_R, pulse_fwhm_s=FWHM, photon_energy_j=HNU),
        P_R * FWHM / (2 * HNU),
    ),
    "24": (
        sipm.signal_cells_published(background_cells=125.0, dark_counts=0.005, photons=N_SP, **CELLS),
        (N - 125.0 - 0.005) * (1 - exp(N_SP * EXPONENT)),
    ),
    "25, S6": (
        sipm.fired_variance_published(fired=N * (1 - exp(N_BP * EXPONENT)), cells=N),
        N * (1 - exp(N_BP * EXPONENT)) * exp(N_BP * EXPONENT),
    ),
    "26": (ref_sipm.dark_deviation(dark_counts=N * DCR * DEAD), sqrt(N * DCR * DEAD)),
    "27": (
        ref_sipm.snr_published(signal_photons=N_SP, background_photons=N_BP, **CELLS, **DARK),
        (N - N * (1 - exp(N_BP * EXPONENT)) - N * DCR * DEAD)
        * (1 - exp(N_SP * EXPONENT))
        / sqrt(N * (1 - exp(N_BP * EXPONENT)) * exp(N_BP * EXPONENT) + N * DCR * DEAD),
    ),
    "27, derived": (
        ref_sipm.snr_steady_state(signal_photons=N_SP, background_photons=N_BP, **CELLS, **DARK),
        N * (1 - exp(-N_SP * PDE / N)) / sqrt(N * (N_BP * PDE / N + DCR * DEAD)),
    ),
    "28": (
        sipm.snr_approximate(signal_photons=N_SP, background_photons=N_BP, pde=PDE),
        P_R * FWHM / (2 * sqrt(HNU * P_RS * DEAD)) * sqrt(PDE),
    ),
    "S1": (ref_sipm.photon_count_probability(photons=7.0, mean_photons=5.0), 5**7 * exp(-5) / factorial(7)),
    "S2": (ref_sipm.quiet_probability_published(photons=7.0, **CELLS), exp(-7 * PDE / N)),
    "S3": (
        ref_sipm.fired_joint_probability_published(photons=7.0, mean_photons=5.0, **CELLS),
        5**7 * exp(-5) / factorial(7) * (1 - exp(-7 * PDE / N)),
    ),
    "S4": (sipm.fired_share_published(photons=N_SP, **CELLS), 1 - exp(N_SP * EXPONENT)),
    "pulse energy": (pulse.pulse_energy_j(peak_power_w=PT, fwhm_s=FWHM), PT * FWHM * sqrt(pi / (4 * log(2)))),
}


@pytest.mark.parametrize("equation", CASES)
def test_as_typed_by_hand(equation):
    """Tolerance 1e-9: the series of expm1 and of log Gamma."""
    computed, expected = CASES[equation]
    assert computed == pytest.approx(expected, rel=1e-9 if equation[0] in "2S" else 1e-12)


def test_apd_noise_and_snr():
    """(18), (19), and (20), which is (19) in other letters."""
    assert noise_18() == pytest.approx(sigma_18(P_RS), rel=1e-12)
    snr = ref_apd.snr(responsivity_a_w=K_PD, gain=M, echo_power_w=P_R, noise_a=noise_18())
    assert snr == pytest.approx(K_PD * M * P_R / sigma_18(P_RS), rel=1e-12)
    abc = apd.snr_of_gain(
        signal_at_unit_gain_a=K_PD * P_R,
        optical_variance_a2=2 * e * K_PD * P_RS * BW,
        bulk_dark_variance_a2=2 * e * IDB * BW,
        unmultiplied_variance_a2=2 * e * IDS * BW + 4 * k * T * BW / RL,
        gain=M,
        excess_noise_index=X,
    )
    assert abc == pytest.approx(snr, rel=1e-12)


def test_false_alarms_and_back():
    """(9) and its inverse, against SciPy; 2.9e-10 of `normal_tail`."""
    for ratio in (0.5, 3.0, 5.0, 9.0):
        p = tdc.false_alarm_probability(threshold=ratio * 0.3, noise=0.3)
        assert p == pytest.approx(norm.sf(ratio), rel=1e-9)
        assert ref_tdc.threshold_to_noise(p_false=p) == pytest.approx(ratio, rel=1e-9)
    assert ref_tdc.threshold_to_noise(p_false=0.9) == pytest.approx(norm.isf(0.9), rel=1e-8)
    p = tdc.false_alarm_probability(threshold=5.0, noise=1.0)
    rice = tdc.rice_rate_hz(threshold=5.0, noise=1.0, bandwidth_hz=BW)
    assert rice == pytest.approx(BW / sqrt(3) * exp(-12.5), rel=1e-12)
    assert rice / tdc.false_alarm_rate_hz(p_false=p, bandwidth_hz=BW) == pytest.approx(7.5, abs=0.01)


OPTICS = (cos(THETA) * TAU**1.5 * ETA_R / (2 * pi * CS * sqrt(HNU * ETA_RS * CS))) ** 0.5


def test_closed_range_limits():
    """(29) and (30) as printed, and the factors between printed and derived."""
    light_in = plane_and_receiver()
    for_apd = {"quantum_efficiency": QE, "excess_noise": FM, "bandwidth_hz": BW}
    for_sipm = {"pulse_fwhm_s": FWHM, "pde": PDE, "dead_time_s": DEAD}
    printed = range_limit.maximum_range_apd_m(*light_in, as_printed=True, **for_apd)
    light = (QE * RHO * A / (ESUN * FM * BW)) ** 0.25 * (PT * F / (TNR * RPD)) ** 0.5
    assert printed == pytest.approx(OPTICS * light, rel=1e-12)
    assert range_limit.maximum_range_apd_m(*light_in, **for_apd) == pytest.approx(
        printed * sqrt(sqrt(2) * CS), rel=1e-12
    )
    printed = range_limit.maximum_range_sipm_m(*light_in, as_printed=True, **for_sipm)
    light = (PDE * RHO * A / ESUN) ** 0.25 * (PT * FWHM * F / (TNR * RPD)) ** 0.5 / DEAD**0.25
    assert printed == pytest.approx(OPTICS * light, rel=1e-12)
    assert range_limit.maximum_range_sipm_m(*light_in, **for_sipm) == pytest.approx(printed * sqrt(CS), rel=1e-12)
