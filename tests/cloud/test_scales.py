"""Scales of colours: where a value lies on them, and which values they reach over."""

import numpy as np
import pytest

from lidarscene.cloud.scales import Scale, scale_of


@pytest.mark.parametrize(
    ("kind", "low", "high", "value", "part"),
    [
        ("linear", 2.0, 10.0, 4.0, 0.25),
        ("root", 2.0, 10.0, 4.0, 0.5),
        ("logarithmic", 1.0, 100.0, 10.0, 0.5),
        ("logarithmic", 0.5, 8.0, 1.0, 0.25),
        ("linear", 2.0, 10.0, 0.0, 0.0),
        ("linear", 2.0, 10.0, 99.0, 1.0),
    ],
)
def test_places_on_a_scale(kind: str, low: float, high: float, value: float, part: float) -> None:
    """Computed by hand: a quarter of the way, its root, and factors of a decade or of 16."""
    assert Scale(low=low, high=high, kind=kind, map="viridis").part(value) == pytest.approx(part)


@pytest.mark.parametrize(
    ("name", "low", "high", "kind"),
    [
        ("range", 10.0, 990.0, "root"),
        ("detection_probability", 0.0, 1.0, "linear"),
        ("snr", 10.0, 990.0, "logarithmic"),
        ("time", 10.0, 990.0, "linear"),
    ],
)
def test_the_bulk_of_a_column_decides(name: str, low: float, high: float, kind: str) -> None:
    """The bulk is from the 1st to the 99th percentile of 0, 1, ..., 1000; probabilities from 0 to 1; nothing that is no
    number.
    """
    values = np.append(np.arange(1001.0), [np.inf, np.nan])
    scale = scale_of(name, values)
    # Of powers only those above 0 count: percentiles of 1 to 1000.
    expected = (10.99, 990.01) if name == "snr" else (low, high)
    assert (scale.low, scale.high, scale.kind) == (pytest.approx(expected[0]), pytest.approx(expected[1]), kind)
    assert scale_of(name, values, limits=(3.0, 7.0)).low == 3.0
