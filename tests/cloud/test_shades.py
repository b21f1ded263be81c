"""Colours of a column: units for people, and categories by how frequent they are."""

import numpy as np
import pytest
from helpers.clouds import small_cloud

from lidarscene.cloud.shades import Shades, rgb


@pytest.mark.parametrize(
    ("column", "values", "low", "high", "label"),
    [
        ("pulse_width", {"pulse_width_s": 1e-9 * np.arange(101)}, 1.0, 99.0, "pulse width [ns]"),
        ("azimuth", {"azimuth_rad": np.radians(np.arange(101))}, 1.0, 99.0, "azimuth [°]"),
        ("range", {"range_m": np.arange(101)}, 1.0, 99.0, "range [m]"),
    ],
)
def test_units_for_people(column: str, values: dict[str, np.ndarray], low: float, high: float, label: str) -> None:
    shades = Shades(small_cloud(101, **values), column)
    assert shades.scale is not None
    assert (shades.scale.low, shades.scale.high) == (pytest.approx(low, rel=1e-5), pytest.approx(high, rel=1e-5))
    assert shades.label == label


def test_the_most_frequent_category_is_first() -> None:
    """Three points of the first class, two of the second and one of none; points have the colours of the list."""
    cloud = small_cloud(6, class_id=np.array([0, 1, 0, -1, 1, 0]))
    shades = Shades(cloud, "class")
    assert [name for name, _ in shades.kinds] == ["road", "car", "none"]
    colours = [tuple(rgb(colour)) for _, colour in shades.kinds]
    assert [tuple(colour) for colour in shades.rgb] == [colours[k] for k in (0, 1, 0, 2, 1, 0)]
