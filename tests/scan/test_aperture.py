"""Effective apertures against areas counted on a grid, and against plain cases."""

import math

import numpy as np
import pytest
from helpers import scanners

from lidarscene.scan.aperture import mirror_share, round_mirror_share, slit_share

GRID = (np.arange(1500) + 0.5) / 1500 * 2 - 1
U, V = np.meshgrid(GRID, GRID)
DISC = U**2 + V**2 <= 1


def on_disc(condition):
    """Part of the unit disc where the condition holds."""
    return np.count_nonzero(condition & DISC) / np.count_nonzero(DISC)


@pytest.mark.parametrize("mirror", [0.5, 0.99, 1.0, 1.2, 2.0, 5.0])
def test_round_mirror_before_a_round_lens(mirror):
    """Reference: the ellipse counted on a grid. Tolerance: the grid's."""
    for cos in (1.0, 0.95, 0.8, 0.5, 0.3, 0.05):
        share = round_mirror_share(cos_incidence=np.array([cos]), mirror_radius_m=mirror * 0.01, lens_radius_m=0.01)
        counted = on_disc((U / mirror) ** 2 + (V / (mirror * cos)) ** 2 <= 1)
        assert share[0] == pytest.approx(counted, abs=1e-3), (mirror, cos)


def test_round_mirror_limits():
    """Covered: 1. Inside the lens: the projected mirror's own area. Exact."""
    cos = np.array([0.9, 0.5])
    big = round_mirror_share(cos_incidence=cos, mirror_radius_m=0.03, lens_radius_m=0.01)
    np.testing.assert_allclose(big, 1.0, atol=1e-6)
    small = round_mirror_share(cos_incidence=cos, mirror_radius_m=0.005, lens_radius_m=0.01)
    np.testing.assert_allclose(small, 0.25 * cos, rtol=1e-9)


@pytest.mark.parametrize(("left", "right"), [(2, 2), (0.5, 2), (0.3, 0.6), (-0.2, 0.9), (-1.5, 3), (0.1, -0.2)])
def test_slit(left, right):
    share = slit_share(left=np.array([float(left)]), right=np.array([float(right)]))
    assert share[0] == pytest.approx(on_disc((-left < U) & (right > U)), abs=1e-3)


def test_a_mirror_that_shows_its_back_sees_nothing():
    assert mirror_share(cos_incidence=np.array([-0.1]), cos_at_rest=0.7)[0] == 0.0


@pytest.mark.parametrize("name", scanners.ALL)
def test_shares_are_1_on_the_axis_and_never_negative(name):
    scanner = scanners.ALL[name]()
    pulse = scanners.frame(scanner)
    x = np.broadcast_to(scanner.direction(pulse)[0], len(pulse))
    share = np.broadcast_to(scanner.aperture_share(pulse), len(pulse))
    assert share.min() >= 0.0
    middle = np.argmax(x)
    if x[middle] > 1.0 - 1e-6:
        # Crossed wedges still squeeze the beam a little, or widen it with the inclined faces to the laser.
        on_axis = {"mid40": 0.993, "six_beams": 1.1}.get(name, 1.0)
        assert share[middle] == pytest.approx(on_axis, abs=2e-3)


def test_the_mirror_law_of_the_range_curves_is_this_one():
    """`ranging.aperture.mirror` is `MirrorPair`'s or `Gimbal`'s share in the plane of incidence, at 45 degrees."""
    from lidarscene.studies.ranging import aperture_laws

    angle_deg = np.linspace(-40.0, 40.0, 9)
    gimbal = scanners.gimbal(incidence_rad=math.radians(45.0), side="right")
    _, share = gimbal.beam(np.radians(angle_deg) / 2, np.zeros(9))
    np.testing.assert_allclose(share, aperture_laws.mirror(angle_deg), rtol=1e-12)
    _, share = scanners.gimbal(incidence_rad=math.radians(45.0), side="left").beam(
        np.radians(-angle_deg) / 2, np.zeros(9)
    )
    np.testing.assert_allclose(share, aperture_laws.mirror(angle_deg), rtol=1e-12)


def test_a_flash_sees_its_pupil_foreshortened():
    scanner = scanners.flash()
    x, _, _ = scanner.direction(scanners.frame(scanner))
    np.testing.assert_allclose(scanner.aperture_share(scanners.frame(scanner)), x, rtol=1e-6)
    natural = scanners.flash(falloff="pupil_and_pixel").aperture_share(scanners.frame(scanner))
    np.testing.assert_allclose(natural, x**4, rtol=1e-6)
