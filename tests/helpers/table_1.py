"""Table 1 of the paper in SI units and, typed out by hand, the powers (5) and (8) and the noise (18)."""

from math import cos, exp, pi, radians, sqrt
from typing import Any

from scipy.constants import c, e, h, k

from lidarscene.physics.electronics import range_limit
from lidarscene.physics.optics import radiometry
from lidarscene.physics.reference import apd as reference_apd

PT, RHO, TAU, ETA_R, RA, ESUN, CS, ETA_RS = 45.0, 0.1, 0.98, 0.7206, 0.025, 29.4, cos(pi / 3), 0.7986
F, BW, RPD, LAMBDA, R, THETA = 0.03, 167e6, 1e-4, 905e-9, 100.0, radians(20.0)
M, QE, IDS, IDB, X, RL, T = 80.0, 0.7, 1e-10, 1e-10, 0.3, 1e4, 300.0
N, PDE, DEAD, DCR, FWHM, TNR = 400.0, 0.22, 6e-9, 2007.0, 6e-9, 5.0
HNU = h * c / LAMBDA
A = pi * RA**2
P_R = TAU**2 * ETA_R * RHO * PT * A * cos(THETA) / (pi * R**2)
P_RS = ESUN * ETA_RS * TAU * RHO * A * (RPD / F) ** 2 * CS
K_PD = e * QE / HNU
FM = M**X
N_SP, N_BP = P_R * FWHM / (2 * HNU), P_RS * DEAD / HNU
EXPONENT = exp(-PDE / N) - 1

AVALANCHE = {"gain": M, "excess_noise": FM, "bandwidth_hz": BW}
CELLS = {"pde": PDE, "cells": N}
DARK = {"dark_count_rate_hz": DCR, "dead_time_s": DEAD}
RECEIVER = {"aperture_m2": A, "transmittance": TAU}


def plane_and_receiver() -> tuple[range_limit.Plane, range_limit.Transceiver]:
    """What (29) and (30) have alike."""
    return (
        range_limit.Plane(
            reflectivity=RHO, cos_incidence=cos(THETA), transmittance=TAU, sun_irradiance_w_m2=ESUN, cos_sun=CS
        ),
        range_limit.Transceiver(
            peak_power_w=PT,
            aperture_m2=A,
            focal_over_radius=F / RPD,
            threshold_to_noise=TNR,
            photon_energy_j=HNU,
            efficiency_laser=ETA_R,
            efficiency_sun=ETA_RS,
        ),
    )


def field_of_view_sr(detector_radius_m: float, focal_length_m: float) -> Any:
    """Solid angle of the detector behind its lens, as (8) has it."""
    return radiometry.field_of_view_solid_angle_sr(detector_radius_m=detector_radius_m, focal_length_m=focal_length_m)


def sigma_18(power_w: float) -> float:
    """(18) by hand."""
    return sqrt(2 * e * K_PD * power_w * M**2 * FM * BW + 2 * e * (IDS + IDB * M**2 * FM) * BW + 4 * k * T * BW / RL)


def noise_18() -> Any:
    """The package's (18)."""
    return reference_apd.noise_without_echo_a(
        reference_apd.Diode(
            responsivity_a_w=K_PD, surface_dark_current_a=IDS, bulk_dark_current_a=IDB, gain=M, excess_noise=FM
        ),
        reference_apd.Amplifier(temperature_k=T, load_resistance_ohm=RL, bandwidth_hz=BW),
        background_power_w=P_RS,
    )
