"""Stokes' parameters at a pane: limits that are known without them."""

import numpy as np
import pytest

from lidarscene.physics.optics import dielectrics
from lidarscene.physics.optics.polarisation import LobeShares, Stokes, pane_shares

COSINES = np.cos(np.radians(np.linspace(0.0, 89.0, 90)))


@pytest.mark.parametrize("internal", [1.0, 0.7])
def test_shares_keep_their_order(internal: float) -> None:
    """T + R of a clear pane is 1 for s and p; the mixed share never beats the mean of both (Cauchy and Schwarz)."""
    lobes = [
        pane_shares(cos_incidence=COSINES, index=1.52, internal=internal, reflected=reflected)
        for reflected in (False, True)
    ]
    for name in ("across", "along"):
        total = sum(getattr(lobe, name) for lobe in lobes)
        assert np.all(total <= 1.0 + 1e-12)
        if internal == 1.0:
            np.testing.assert_allclose(total, 1.0, rtol=1e-12)
    for lobe in lobes:
        assert np.all(lobe.mixed**2 <= lobe.across * lobe.along * (1.0 + 1e-12))
    # Straight through, s and p are alike, and a reflection turns one of them round.
    for lobe, sign in zip(lobes, (1.0, -1.0), strict=True):
        assert lobe.across[0] == pytest.approx(lobe.along[0], rel=1e-12)
        assert lobe.mixed[0] == pytest.approx(sign * lobe.across[0], rel=1e-12)


def test_brewster() -> None:
    """Nothing of p is mirrored at tan theta = n, and p passes whole."""
    cosine = np.float64(1.0 / np.hypot(1.0, 1.52))
    shares = pane_shares(cos_incidence=cosine, index=1.52, internal=1.0, reflected=False)
    assert shares.along == pytest.approx(1.0, rel=1e-12)
    light = Stokes(1.0, -1.0, 0.0).passed(shares)  # p swings across the axis, which is that of s
    assert (light.intensity, light.level) == pytest.approx((1.0, -1.0), rel=1e-12)


def test_one_face_is_that_of_unpolarised_light() -> None:
    """The mean of both polarisations of one face is `fresnel_reflectance`."""
    r_s, r_p = dielectrics.fresnel_amplitudes(cos_incidence=COSINES, index=1.52)
    mean = dielectrics.fresnel_reflectance(cos_incidence=COSINES, index=1.52)
    np.testing.assert_allclose(0.5 * (r_s**2 + r_p**2), mean, rtol=1e-12)
    assert r_p[0] == -r_s[0]


def test_a_turn_of_the_axis_keeps_the_light() -> None:
    """Turned by chi and by -chi: the same; a lobe that treats both polarisations alike does not care for the axis."""
    light, double = Stokes(1.0, 0.6, -0.3), np.radians(50.0)
    there = light.turned(np.cos(double), np.sin(double))
    back = there.turned(np.cos(double), -np.sin(double))
    assert (back.level, back.diagonal) == pytest.approx((0.6, -0.3), rel=1e-12)
    assert np.hypot(there.level, there.diagonal) == pytest.approx(np.hypot(0.6, 0.3), rel=1e-12)
    even = LobeShares(across=0.5, along=0.5, mixed=0.5)
    assert there.passed(even).times(there.passed(even)) == pytest.approx(0.25 * light.times(light), rel=1e-12)
