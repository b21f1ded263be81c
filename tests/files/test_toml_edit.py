"""Edits keep comments, order and all other values."""

import tomllib

from lidarscene.files.toml_edit import get_value, put_values, remove_values

TEXT = """\
name = "x"  # of the unit
[laser]
power_w = 5 # [W]
[laser.pulse]
fwhm_ns = 1.5
[sources]
"laser.power_w" = "data sheet"
"""


def test_values_are_put_into_old_and_new_tables() -> None:
    """Numbers have six digits, whole ones stay whole; what is not named stays, comments too."""
    text = put_values(
        TEXT,
        {
            ("laser", "power_w"): 2.0 / 3.0,
            ("laser", "pulse", "shots"): 12,
            ("optics", "overlap"): {},
            ("optics", "lens", "place_mm"): [1.0 / 3.0, 2.0],
            ("sources", "laser.power_w"): "fitted",
        },
    )
    assert tomllib.loads(text) == {
        "name": "x",
        "laser": {"power_w": 0.666667, "pulse": {"fwhm_ns": 1.5, "shots": 12}},
        "optics": {"overlap": {}, "lens": {"place_mm": [0.333333, 2.0]}},
        "sources": {"laser.power_w": "fitted"},
    }
    assert "# of the unit" in text


def test_keys_are_removed_where_they_are() -> None:
    paths = [("laser", "pulse", "fwhm_ns"), ("sources", "laser.power_w"), ("optics", "focus_at_m"), ("name", "first")]
    text = remove_values(TEXT, paths)
    assert tomllib.loads(text) == {"name": "x", "laser": {"power_w": 5, "pulse": {}}, "sources": {}}
    assert get_value(text, ("laser", "pulse", "fwhm_ns")) is None
    assert get_value(TEXT, ("laser", "pulse")) == {"fwhm_ns": 1.5}


def test_long_lists_have_eight_numbers_in_a_line() -> None:
    values = [0.1 * n for n in range(20)]
    text = put_values(TEXT, {("laser", "pulse", "shape"): values}, digits=17)
    assert tomllib.loads(text)["laser"]["pulse"]["shape"] == values
    assert [line.count(",") for line in text.splitlines() if line.startswith("    ")] == [8, 8, 4]
