"""A laser beside its filter: the closed form against a stack of thin films, whose light is computed layer by layer."""

import math

import numpy as np
import pytest

from lidarscene.physics.optics.interference_filter import oblique_factor, passed_share
from lidarscene.physics.optics.solar_spectrum import super_gaussian_filter

HIGH, LOW, GLASS = 2.3, 1.45, 1.52
"""Refractive indices of titania, silica and the substrate."""

MIRROR = ["H", "L"] * 6
STACKS = {
    # Effective indices of first-order cavities: Macleod, Thin-Film Optical Filters, 4th ed., (8.32) and (8.33).
    "high": ([*MIRROR, "H", "H", *MIRROR[::-1]], math.sqrt(HIGH * LOW)),
    "low": ([*MIRROR, "H", "L", "L", "H", *MIRROR[::-1]], LOW / math.sqrt(1.0 - LOW / HIGH + (LOW / HIGH) ** 2)),
}


def transmittance(layers: list[str], wavelength_m: np.ndarray, angle_rad: float, *, along: bool) -> np.ndarray:
    """Transmittance of quarter-wave layers at 905 nm on glass, by characteristic matrices (Macleod, 2.6).

    along  whether the light is polarised in the plane of incidence
    """

    def cosine(index: float) -> float:
        return math.sqrt(1.0 - (math.sin(angle_rad) / index) ** 2)

    def admittance(index: float) -> float:
        return index / cosine(index) if along else index * cosine(index)

    b, c = np.ones(len(wavelength_m), dtype=complex), np.full(len(wavelength_m), admittance(GLASS), dtype=complex)
    for layer in reversed(layers):
        index = HIGH if layer == "H" else LOW
        phase = 0.5 * math.pi * 905e-9 / wavelength_m * cosine(index)
        y = admittance(index)
        b, c = np.cos(phase) * b + 1j * np.sin(phase) / y * c, 1j * y * np.sin(phase) * b + np.cos(phase) * c
    outside = admittance(1.0)
    return np.asarray(4.0 * outside * admittance(GLASS) / np.abs(outside * b + c) ** 2)


@pytest.mark.parametrize("along", [False, True])
@pytest.mark.parametrize("stack", STACKS)
def test_the_band_moves_as_that_of_thin_films(stack: str, along: bool) -> None:
    """The peak of a filter of quarter waves at 5 to 20 degrees.

    Tolerance: 5 % of the shift, to which the effective index, a number for small angles, holds at 20 degrees; and half
    a step of the wavelengths.
    """
    layers, index = STACKS[stack]
    for degrees in (5.0, 10.0, 15.0, 20.0):
        expected = 905e-9 * oblique_factor(incidence_rad=math.radians(degrees), effective_index=index)
        wavelengths = expected + 1e-12 * np.arange(-2500, 2501)
        peak = wavelengths[np.argmax(transmittance(layers, wavelengths, math.radians(degrees), along=along))]
        assert abs(peak - expected) <= 0.05 * (905e-9 - expected) + 0.5e-12, degrees


def test_the_share_of_a_gaussian_filter() -> None:
    """By hand: a Gaussian 20 nm wide at half, 10 nm beside its middle, has half of the light. Tolerance: its table."""
    curve = super_gaussian_filter(centre_m=905e-9, width_m=20e-9)
    assert passed_share(curve, reference_m=905e-9, emitted_m=915e-9) == pytest.approx(0.5, rel=1e-4)
    assert passed_share(curve, reference_m=895e-9, emitted_m=905e-9) == pytest.approx(2.0, rel=1e-4)
    # At an angle the filter's middle stands at 905 b, so light of that wavelength passes whole.
    factor = oblique_factor(incidence_rad=0.2, effective_index=1.8)
    assert passed_share(curve, reference_m=905e-9, emitted_m=905e-9 * factor, incidence_factor=factor) == 1.0
    with pytest.raises(ValueError, match="passes nothing at 800 nm"):
        passed_share(curve, reference_m=800e-9, emitted_m=905e-9)
