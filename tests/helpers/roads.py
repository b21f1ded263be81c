"""Closed forms of an isotropic road below the wheels of a vehicle."""

import numpy as np
from scipy.special import k1

from lidarscene.maths.arrays import Numbers
from lidarscene.physics.reference.surroundings import profile_density_m3
from lidarscene.physics.road.roughness import Roughness
from lidarscene.physics.road.suspension import Suspension


def wheel_spectrum(suspension: Suspension, frequency_hz: Numbers, speed_m_s: float, roughness: Roughness) -> Numbers:
    """(n, 4, 4) one-sided cross-spectra of the heights below the wheels [m2/Hz], straight ahead at one speed.

    Tracks T apart have the coherence z K1(z), z = 2 pi n T (T141); the rear axle comes later.
    """
    per_m = np.asarray(frequency_hz)[:, None, None] / speed_m_s
    ahead_m, aside_m = np.moveaxis(suspension.wheels_m[:, None] - suspension.wheels_m, 2, 0)
    z = 2.0 * np.pi * np.abs(aside_m) * per_m
    coherence = np.where(z > 1e-9, z * k1(np.maximum(z, 1e-9)), 1.0)
    density: Numbers = profile_density_m3(per_m, roughness) / speed_m_s
    spectrum: Numbers = density * coherence * np.exp(2j * np.pi * ahead_m * per_m)
    return spectrum


def output_spectrum(response: Numbers, spectrum: Numbers) -> Numbers:
    """(n,) one-sided spectrum of what answers to the wheels by (n, 4) responses."""
    return np.asarray(np.einsum("ni,nij,nj->n", response.conj(), spectrum, response).real)
