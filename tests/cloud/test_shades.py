"""Colours of a column: units for people, and categories by how frequent they are."""

from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import small_cloud

from lidarscene import view
from lidarscene.cloud.shades import NO_SURFACE, PALETTE, Shades, rgb
from lidarscene.figures.pictures import ALARM


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


TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
"""Linear sRGB to XYZ, IEC 61966-2-1."""
SEEN_BY = {
    "all cones": np.eye(3),
    "deuteranopes, Machado 2009": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.042940, 0.968881]]
    ),
    "deuteranopes, Vienot 1999": np.array(
        [[0.29275, 0.70725, -0.02978], [0.29275, 0.70725, -0.02978], [-0.02234, 0.02234, 1.0]]
    ),
}
"""On linear sRGB. Machado, Oliveira, Fernandes, IEEE TVCG 15 (2009), severity 1; Vienot, Brettel, Mollon, Color Res.
Appl. 24 (1999).
"""


@pytest.mark.parametrize("eye", SEEN_BY)
def test_kinds_are_told_apart(eye: str) -> None:
    """CIE76 of each pair, and from the grey of no surface and the magenta of false alarms: 12 is five just noticeable
    differences of 2.3, so that small points of two classes are not taken for one.
    """
    colours = np.array([rgb(colour) for colour in (*PALETTE, NO_SURFACE, ALARM)]) / 255.0
    linear = np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ SEEN_BY[eye].T, 0.0, 1.0) @ TO_XYZ.T / TO_XYZ.sum(axis=1)
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    lab = np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)
    apart = np.linalg.norm(lab[:, None] - lab, axis=2)[np.triu_indices(len(lab), 1)]
    assert apart.min() > 12.0


def test_the_page_of_the_view_has_the_same_colours() -> None:
    script = (Path(view.__file__).parent / "static" / "legend.js").read_text(encoding="utf-8")
    assert f'const KINDS = "{" ".join(colour[1:] for colour in PALETTE)}"' in script
