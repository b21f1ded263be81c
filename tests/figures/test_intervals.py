"""Charts with intervals: each bar reaches from its own low end to its own high end."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from lidarscene.figures.intervals import Series, _draw_markers, _draw_over_bins


def series(label: str, ends: tuple[float, float], expected: float) -> Series:
    x, y = np.array([1.0, 3.0]), np.array([5.0, 7.0])
    return Series(label=label, x=x, y=y, low=y - ends[0], high=y + ends[1], expected=np.full(2, expected))


@pytest.mark.parametrize("vertical", [True, False])
def test_bars_reach_from_low_to_high(vertical: bool) -> None:
    """Reference: the segments that matplotlib draws; the ends are not as far apart."""
    axes = Figure().subplots()
    interval = series("a", (0.5, 2.0), 6.0)
    _draw_markers(
        axes, 0, interval, *((interval.x, interval.y) if vertical else (interval.y, interval.x)), vertical=vertical
    )
    (bars,) = axes.collections
    ends = np.array(bars.get_segments())[:, :, int(vertical)]
    np.testing.assert_allclose(np.sort(ends, axis=1), np.stack([interval.low, interval.high], axis=1))


def test_sensors_stand_beside_each_other_and_lines_are_expected_values() -> None:
    axes = Figure().subplots()
    _draw_over_bins(axes, [series("a", (1.0, 1.0), 6.0), series("b", (1.0, 1.0), 8.0)])
    middles = [np.array(bars.get_segments())[:, 0, 0] for bars in axes.collections]
    np.testing.assert_allclose(0.5 * (middles[0] + middles[1]), [1.0, 3.0])
    assert (middles[1] - middles[0] > 0.0).all()
    assert (middles[1] - middles[0] < 1.0).all()
    lines = [
        line.get_ydata().tolist() for line in axes.lines if line.get_linestyle() == "-" and line.get_linewidth() > 1
    ]
    assert [line for line in lines if line[0] == line[1]] == [[6.0, 6.0], [8.0, 8.0]]
