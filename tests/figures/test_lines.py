"""Line charts and bars: nothing that they say is cut off at the edge of the picture."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarscene.figures import lines
from lidarscene.figures.lines import Chart, Level, Line, Mark


@pytest.fixture
def saved_figures(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The figures as they are when they are written."""
    from matplotlib.figure import Figure

    figures: list[Any] = []
    savefig = Figure.savefig

    def save_and_keep(figure: Figure, *args: Any, **options: Any) -> None:
        figures.append(figure)
        savefig(figure, *args, **options)

    monkeypatch.setattr(Figure, "savefig", save_and_keep)
    return figures


def test_a_chart_of_marks_alone(saved_figures: list[Any], tmp_path: Path) -> None:
    """The mark of a front of one design lies within the axes."""
    mark = Mark(x=300.0, y=5.0, text="chosen")
    lines.save(Chart(lines=(), x_label="x", y_label="y", title="one", marks=(mark,)), [tmp_path / "a.png"])
    low, high = saved_figures[0].axes[0].get_xlim()
    assert low < 300.0 < high


def test_a_chart_is_whole_in_its_picture(saved_figures: list[Any], tmp_path: Path) -> None:
    """Labels, title, legend and numbers, with a tall label at the left that needs room."""
    x = np.linspace(0.0, 1.0, 5)
    chart = Chart(
        lines=(Line(label="one", x=x, y=1e5 * x), Line(label="two", x=x, y=x, colour=1)),
        x_label="below",
        y_label="left,\nin three\nlines",
        title="it fits, " * 30,
        marks=(Mark(x=0.5, y=5e4, text="here"),),
        levels=(Level(y=2e4, text="level"),),
    )
    lines.save(chart, [tmp_path / "a.png", tmp_path / "a.svg"])
    assert len(saved_figures) == 2
    whole_in_its_picture(saved_figures[0])


def test_bars_are_whole_in_their_picture(saved_figures: list[Any], tmp_path: Path) -> None:
    """Names along the left edge are the widest that there is."""
    bars = [("a name that is as long as a key of a sensor file", 0.5), ("short", -0.25)]
    lines.tornado([tmp_path / "a.png"], bars=bars, title="title", label="exponent")
    whole_in_its_picture(saved_figures[0])


def whole_in_its_picture(figure: Any) -> None:
    width, height = figure.get_size_inches()
    box = figure.get_tightbbox()
    assert box.x0 >= 0.0
    assert box.y0 >= 0.0
    assert box.x1 <= width
    assert box.y1 <= height
    (axes,) = figure.axes
    assert axes.get_position().width > 0.5  # and the curves have most of it


def test_texts_of_marks_that_lie_close_do_not_overlap(saved_figures: list[Any], tmp_path: Path) -> None:
    """Six marks within a twentieth of the axis, at the right edge, all with one offset."""
    from matplotlib.text import Text

    x = np.linspace(0.0, 1.0, 200)
    marks = tuple(Mark(x=0.95 + 0.01 * k, y=0.5 + 0.002 * k, text=f"{k}23.4 m", colour=k) for k in range(6))
    chart = Chart(lines=(Line(label="one", x=x, y=x),), x_label="x", y_label="y", marks=marks)
    lines.save(chart, [tmp_path / "a.png"])
    (figure,) = saved_figures
    renderer = figure.canvas.get_renderer()
    boxes = [Text.get_window_extent(text, renderer) for text in figure.axes[0].texts]
    assert len(boxes) == 6
    for number, box in enumerate(boxes):
        assert box.count_overlaps(boxes[:number]) == 0
        assert box.x1 <= figure.bbox.x1


def test_the_text_of_a_lone_mark_is_at_its_offset(saved_figures: list[Any], tmp_path: Path) -> None:
    mark = Mark(x=0.5, y=0.5, text="here", offset=(-9.0, -22.0))
    line = Line(label="one", x=np.linspace(0.0, 1.0, 9), y=np.linspace(0.0, 1.0, 9))
    lines.save(Chart(lines=(line,), x_label="x", y_label="y", marks=(mark,)), [tmp_path / "a.png"])
    (text,) = saved_figures[0].axes[0].texts
    assert text.xyann == mark.offset
