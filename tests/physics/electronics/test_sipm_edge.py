"""The rising edge of a count of SiPM cells."""

import numpy as np
import pytest

from lidarscene.physics.electronics.sipm_edge import CountEdge


@pytest.mark.parametrize("dead", [2.5, 5.0, 20.0, 80.0])
@pytest.mark.parametrize("rate", [1e-3, 0.02, 0.1, 0.3])
def test_the_peak_is_where_the_count_is_highest(dead: float, rate: float) -> None:
    """Reference: a search. On a plateau the place is not sharp: within 0.6 % of the height."""
    numbers = {"sigma_s": 1.0, "rate_hz": rate, "dead_time_s": dead, "cells": 1000.0, "free": 900.0, "variance": 0.09}
    edge = CountEdge.from_cells(**{name: np.array([value]) for name, value in numbers.items()})
    highest = edge.course(np.linspace(-4.0, 0.5 * dead + 1.0, 4001)).max()
    assert 0.994 * highest <= float(edge.course(edge.peak)[0]) <= 1.000001 * highest
