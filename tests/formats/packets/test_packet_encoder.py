"""What all makers' packets say of two returns: whole steps and levels, the last one and the strongest."""

from typing import Any

import numpy as np
import pytest

from lidarscene.formats.packets.firings import Firings
from lidarscene.formats.packets.packet_encoder import last_and_strongest

STEP_M = 0.002


def encode_firing(ranges_m: Any, intensities: Any, *, two_returns: bool) -> Any:
    """(2, lasers) distances and reflectivities of (lasers, 2) returns, the strongest first."""
    range_m, intensity = np.array([ranges_m], float), np.array([intensities], np.float32)
    frame = Firings(
        range_m=range_m, intensity=intensity, signal=intensity, ambient=intensity[..., 0], number=0, time_s=np.zeros(1)
    )
    points = last_and_strongest(frame, step_m=STEP_M, two_returns=two_returns)
    return points["distance"][0].tolist(), points["reflectivity"][0].tolist()


def test_distances_and_levels_are_the_nearest_that_there_are() -> None:
    """A distance has 16 bits: 65,535 steps of 2 mm are its last one. A reflectivity has 8."""
    ranges_m = [[10.0013, 0.0], [131.0704, 0.0], [131.072, 0.0], [0.0, 0.0]]
    with pytest.warns(UserWarning, match=r"end at 131\.07 m: returns beyond are left out"):
        distance, reflectivity = encode_firing(ranges_m, [[12.6, 0], [300.0, 0], [-3.0, 0], [0, 0]], two_returns=False)
    assert distance == [[5001, 65_535, 0, 0]] * 2
    assert reflectivity == [[13, 255, 0, 0]] * 2


@pytest.mark.filterwarnings("ignore:packets of this sensor end at")
@pytest.mark.parametrize(
    ("ranges_m", "two_returns", "last", "strongest"),
    [
        ((10.0, 14.0), True, (7000, 2), (5000, 1)),  # the strongest is not the last
        ((14.0, 10.0), True, (7000, 1), (5000, 2)),  # it is: the second strongest follows
        ((14.0, 0.0), True, (7000, 1), (7000, 1)),  # a lone one is both
        ((10.0, 14.0), False, (5000, 1), (5000, 1)),  # a single one is the strongest, whatever is behind
        ((10.0, 200.0), True, (5000, 1), (5000, 1)),  # beyond what a distance can say nothing came back
    ],
)
def test_the_last_and_the_strongest(ranges_m: Any, two_returns: bool, last: Any, strongest: Any) -> None:
    """The manuals of Velodyne (63-9243, 9.2) and Hesai say: of two returns the last one and the strongest other."""
    distance, reflectivity = encode_firing([ranges_m], [(1.0, 2.0)], two_returns=two_returns)
    assert [(d[0], r[0]) for d, r in zip(distance, reflectivity, strict=True)] == [last, strongest]
