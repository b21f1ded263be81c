"""A warning names the line of the user's program, whatever decorators and helpers of ours are between."""

import warnings

import pytest

import lidarscene

COARSE = ("scanner.azimuth_step_deg=8", "scanner.elevation_step_deg=8")
BRIGHT = {"sun.illuminance_klux": 1e4}
CALLS = {
    "render": lambda: lidarscene.render("range", "table1-apd", overrides=COARSE, scene_overrides=BRIGHT),
    "frames": lambda: lidarscene.render_frames(
        "range", "table1-apd", frames=1, overrides=COARSE, scene_overrides=BRIGHT
    ),
    "range": lambda: lidarscene.max_range("apd-905", illuminance_klux=1e4),
    "compare": lambda: lidarscene.compare("range", ["table1-apd"] * 2, overrides=COARSE, illuminance_klux=[1e4]),
}


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.usefixtures("mi")
def test_the_line_is_the_callers(call: str) -> None:
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        CALLS[call]()
    assert {warning.filename for warning in told} == {__file__}
