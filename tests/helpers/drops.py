"""Raindrops without their glory, whose table takes a second to compute: for tests of which it is not the point."""

import numpy as np
import pytest

from lidarscene.physics.weather import glory


def as_bright_as_their_faces(patch: pytest.MonkeyPatch) -> None:
    """sigma grows as D^2 then, and is the same into any lens."""
    patch.setattr(glory, "gain", lambda *, diameter_m, within_rad, **_: np.ones_like(diameter_m * within_rad))
