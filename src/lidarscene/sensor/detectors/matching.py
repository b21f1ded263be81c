"""Checks that a detector can see its laser: by wavelength, and by field of view."""

from __future__ import annotations

from .detector import Detector

SILICON_M = 1150e-9
"""Source: Green, Solar Energy Materials and Solar Cells 92, 2008; longest wavelength that silicon absorbs: its band gap
of 1.12 eV is 1107 nm, phonons add some 40 nm."""

WIDER = 2.0
"""Choice: beam over field of view from which on more than half of a Gaussian beam is beside it: exp(-2 / 2^2) =
0.61."""


def silicon_doubt(detector: Detector, *, wavelength_m: float) -> str | None:
    """Say in one line that a detector of silicon does not see the laser; None if it does, or is none."""
    if wavelength_m <= SILICON_M:
        return None
    if detector.silicon is None:
        return None
    return (
        f"{detector.silicon} and sees nothing at {1e9 * wavelength_m:.4g} nm: change laser.wavelength_nm, or give the "
        "numbers of a detector of InGaAs, as mems-1550 has"
    )


def spot_doubt(detector: Detector, *, divergence_rad: float, focal_length_m: float) -> str | None:
    """Warning, one line, that most of the beam is beside the field of view; None if it is not. Small angles."""
    seen_rad = 2.0 * float(detector.radius_m) / focal_length_m
    if divergence_rad <= WIDER * seen_rad:
        return None
    return (
        f"a beam of {1e3 * divergence_rad:.4g} mrad is far wider than the field of view of {1e3 * seen_rad:.4g} mrad "
        "(2 detector.radius_mm / optics.focal_length_mm), and its echo counts whole: lower laser.divergence_mrad, or "
        "give [optics.overlap]"
    )
