"""Cells of bodies that move, in their one Mitsuba scene."""

import numpy as np
import pytest

from lidarscene.kernel.world.mover_scene import MARGIN_M, side_by_side


def boxes(sizes: np.ndarray) -> np.ndarray:
    """(g, 2, 3) boxes of these sizes, each somewhere in a frame of its own."""
    low = np.random.default_rng(3).uniform(-2.0, 1.0, sizes.shape)
    return np.stack([low, low + sizes], axis=1)


CAR, PERSON, ROAD = (4.5, 1.8, 1.5), (0.6, 0.8, 1.8), (400.0, 300.0, 0.2)


@pytest.mark.parametrize(
    ("sizes", "farthest_m"),
    [
        pytest.param([CAR], 2.4, id="a car"),
        pytest.param(30 * [CAR] + 20 * [PERSON], 10.0, id="traffic"),
        pytest.param([ROAD] + 30 * [CAR], 201.0, id="a long one beside cars"),
    ],
)
def test_cells_stand_apart_and_near_the_origin(sizes: list[tuple[float, ...]], farthest_m: float) -> None:
    """One of two cells ends before the other begins, rims and all; traffic is within 10 m of the origin."""
    own = boxes(np.array(sizes))
    low, high = np.moveaxis(own + side_by_side(own)[:, None], 1, 0)
    apart = (low[:, None] - MARGIN_M > high[None] + MARGIN_M).any(axis=-1)
    assert np.all(apart | apart.T | np.eye(len(own), dtype=bool))
    assert max(np.abs(low).max(), np.abs(high).max()) < farthest_m


def test_cars_beside_a_road_stay_where_single_precision_is_fine() -> None:
    """They are above it, in its middle: coordinates of some 10 m, and not of 200 m."""
    own = boxes(np.array([ROAD] + 30 * [CAR]))
    placed = own + side_by_side(own)[:, None]
    assert np.ptp(placed[1:], axis=(0, 1)).max() < 20.0
