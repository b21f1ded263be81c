"""What scanners do to the background: prisms keep aperture times solid angle, mirrors take aperture away."""

import math
from dataclasses import replace

import numpy as np
import pytest
from helpers import chain, scanners

from lidarscene.scene.model import Sun


def test_prisms_keep_aperture_times_solid_angle():
    """Rationale: why (8) has no share for prisms. Reference: three neighbouring rays through the wedges give the
    solid angle's growth, by differences of 1e-4; times the growth of the cross-section it is 1.
    """
    prisms = scanners.ALL["mid40"]()
    rng = np.random.default_rng(4)
    phases = [rng.uniform(0.0, 2.0 * math.pi, 300) for _ in prisms.wedges]

    def through(direction):
        share = 1.0
        for wedge, phase in zip(prisms.wedges, phases, strict=True):
            direction, widened = wedge.bend(direction, phase)
            share = share * widened
        return np.stack(np.broadcast_arrays(*direction)), share

    step = 1e-4
    middle, share = through((1.0, 0.0, 0.0))
    slopes = []
    for axis in (1, 2):
        aside = np.zeros(3)
        aside[axis] = math.sin(step)
        there, back = (through((math.cos(step), *(sign * aside[1:])))[0] for sign in (1.0, -1.0))
        slopes.append((there - back) / (2.0 * step))
    growth = np.abs(np.sum(middle * np.cross(slopes[0], slopes[1], axis=0), axis=0))
    assert np.ptp(share) > 0.05
    np.testing.assert_allclose(growth * share, 1.0, atol=1e-6)


@pytest.mark.parametrize(("name", "even"), [("mid40", True), ("mirror_step", False), ("polygon", False)])
def test_sky_in_all_directions(mi, name, even):
    """Even through prisms, whose echo is not; a mirror or a facet takes of both alike."""
    scanner = scanners.ALL[name]()
    described = chain.scene(chain.ball(at=(-50.0, 0.0, 0.0)), sky=0.1, sun=Sun(azimuth_rad=math.pi))
    light = chain.run(described, replace(chain.sensor("table1-apd"), scanner=scanner)).light
    relative = light.background_power_w / light.background_power_w.max()
    assert (np.ptp(relative) < 1e-5) == even
    pulse = scanners.frame(scanner)
    share = np.broadcast_to(scanner.background_share(pulse), len(pulse))
    np.testing.assert_allclose(relative, share / share.max(), rtol=1e-5)
