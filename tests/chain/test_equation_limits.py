"""The equations under a change of units, and at their limits: gain one, many cells, no sun."""

from math import cos, exp, sqrt

import pytest
from helpers.table_1 import (
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
    RHO,
    RL,
    RPD,
    TAU,
    THETA,
    A,
    F,
    N,
    R,
    T,
    X,
    field_of_view_sr,
    noise_18,
    plane_and_receiver,
    sigma_18,
)
from scipy.constants import e, k

from lidarscene.physics.electronics import apd, range_limit, sipm
from lidarscene.physics.reference import optics as reference_optics
from lidarscene.physics.reference import sipm as reference_sipm

# --- dimensions: a change of units changes nothing but the unit ---------------------------------------


@pytest.mark.parametrize("metre", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("second", [1e-9, 1.0])
@pytest.mark.parametrize("watt", [1e-6, 1.0])
def test_scaling_of_units(metre, second, watt):
    """Lengths, times and powers in other units: powers and photon numbers follow, ratios stay."""
    echo = reference_optics.lambertian_echo_power_w(
        peak_power_w=PT * watt,
        reflectivity=RHO,
        cos_incidence=1.0,
        range_m=R * metre,
        transmittance=TAU,
        aperture_m2=A * metre**2,
        efficiency=ETA_R,
    )
    assert echo == pytest.approx(watt * P_R / cos(THETA), rel=1e-12)
    sun = reference_optics.lambertian_sun_power_w(
        sun_irradiance_w_m2=ESUN * watt / metre**2,
        reflectivity=RHO,
        cos_sun=CS,
        aperture_m2=A * metre**2,
        field_of_view_sr=field_of_view_sr(RPD * metre, F * metre),
        transmittance=TAU,
        efficiency=ETA_RS,
    )
    assert sun == pytest.approx(watt * P_RS, rel=1e-12)
    photons = sipm.background_photons(power_w=sun, dead_time_s=DEAD * second, photon_energy_j=HNU * watt * second)
    assert photons == pytest.approx(N_BP, rel=1e-12)
    limit = range_limit.maximum_range_sipm_m(
        *plane_and_receiver(
            peak_power_w=PT * watt,
            aperture_m2=A * metre**2,
            sun_irradiance_w_m2=ESUN * watt / metre**2,
            photon_energy_j=HNU * watt * second,
        ),
        pulse_fwhm_s=FWHM * second,
        pde=PDE,
        dead_time_s=DEAD * second,
    )
    still = range_limit.maximum_range_sipm_m(*plane_and_receiver(), pulse_fwhm_s=FWHM, pde=PDE, dead_time_s=DEAD)
    assert limit == pytest.approx(metre * still, rel=1e-12)


@pytest.mark.parametrize("factor", [0.01, 4.0])
def test_scaling_of_noise(factor):
    """Every variance of (14)-(17) is linear in the bandwidth, so (18) is in its root."""
    wide = noise_18(bandwidth_hz=factor * BW)
    assert wide == pytest.approx(sqrt(factor) * noise_18(), rel=1e-12)
    # A current is a charge over a time: currents and B times f, thermal power too, and sigma grows by f.
    faster = noise_18(
        background_power_w=factor * P_RS,
        surface_dark_current_a=factor * IDS,
        bulk_dark_current_a=factor * IDB,
        temperature_k=factor * T,
        bandwidth_hz=factor * BW,
    )
    assert faster == pytest.approx(factor * noise_18(), rel=1e-12)


# --- limits -------------------------------------------------------------------------------------------


def test_gain_of_one_is_a_plain_photodiode():
    assert apd.excess_noise_power_law(gain=1.0, index=X) == 1.0
    assert apd.excess_noise_mcintyre(gain=1.0, ionisation_ratio=0.4) == pytest.approx(1.0)
    plain = sqrt(2 * e * (K_PD * P_RS + IDS + IDB) * BW + 4 * k * T * BW / RL)
    assert noise_18(gain=1.0, excess_noise=1.0) == pytest.approx(plain, rel=1e-12)


def test_many_cells_count_photons():
    """N to infinity: cells that fire are photons times PDE, (27) becomes (28), and printed becomes derived."""
    many_cells = {"pde": PDE, "cells": 1e9}
    assert sipm.fired_cells_published(photons=N_SP, **many_cells) == pytest.approx(PDE * N_SP, rel=1e-5)
    dark = {"dark_count_rate_hz": 0.0, "dead_time_s": DEAD}
    photons = {"signal_photons": N_SP, "background_photons": N_BP}
    simple = sipm.snr_approximate(pde=PDE, **photons)
    assert reference_sipm.snr_published(**photons, **many_cells, **dark) == pytest.approx(simple, rel=1e-5)
    assert reference_sipm.snr_steady_state(**photons, **many_cells, **dark) == pytest.approx(simple, rel=1e-5)


def test_without_sun_the_electronics_remain():
    """E_sun to 0: (18) keeps dark and thermal noise; (27) the dark counts' (26)."""
    assert noise_18(background_power_w=0.0) == pytest.approx(sigma_18(0.0), rel=1e-12)
    share = {"signal_photons": N_SP, "background_photons": 0.0, **CELLS, **DARK}
    dark = N * DCR * DEAD
    expected = (N - dark) * (1 - exp(N_SP * EXPONENT)) / sqrt(dark)
    assert reference_sipm.snr_published(**share) == pytest.approx(expected, rel=1e-9)
    assert reference_sipm.snr_steady_state(**share) == pytest.approx(expected, rel=1e-3)  # (S2): PDE / 2N
