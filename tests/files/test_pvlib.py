"""Where the sun is: published positions, simple astronomy, our convention, and mistakes in scene files."""

import builtins
import math
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from helpers.mistakes import mistakes, told
from helpers.scene_text import scene_of

from lidarscene.errors import LidarSceneError
from lidarscene.files import pvlib
from lidarscene.scene.scene import Sun

BODY = '[[bodies]]\nname = "ball"\nprimitive = "sphere"\nradius_m = 1\nmaterial = "asphalt"\n'


def sun_of(folder: Path, entry: str) -> Sun:
    return scene_of(folder, f"sun = {{ {entry} }}\n{BODY}").sun


def north_up(latitude_deg: float, longitude_deg: float, time: str) -> tuple[float, float]:
    pytest.importorskip("pvlib")
    return pvlib.sun_north_up_deg(
        latitude_deg=latitude_deg, longitude_deg=longitude_deg, time=datetime.fromisoformat(time)
    )


def test_example_of_the_algorithm() -> None:
    """Reference: NREL/TP-560-34302, appendix A.5: azimuth 194.34024, zenith 50.11162 at 1830 m and 820 mbar.

    Sea-level refraction lifts it by 0.004 degrees more.
    """
    azimuth, elevation = north_up(39.742476, -105.1786, "2003-10-17T12:30:30-07:00")
    assert azimuth == pytest.approx(194.34024, abs=1e-4)
    assert elevation == pytest.approx(90 - 50.11162, abs=6e-3)


@pytest.mark.parametrize(
    ("latitude", "day", "declination"),
    [
        (48.0, "2026-06-21", 23.44),
        (48.0, "2026-12-21", -23.44),
        (60.0, "2026-03-20", 0.0),
        (10.0, "2026-12-21", -23.44),
    ],
)
def test_highest_of_the_day(latitude: float, day: str, declination: float) -> None:
    """90 degrees - latitude + declination, due south, when the sun crosses the meridian; refraction to 0.06 degrees."""
    noon = datetime.fromisoformat(f"{day}T12:00:00+00:00")
    path = [north_up(latitude, 0.0, (noon + timedelta(minutes=m)).isoformat()) for m in range(-20, 21)]
    azimuth, elevation = max(path, key=lambda place: place[1])
    assert elevation == pytest.approx(90 - latitude + declination, abs=0.06)
    assert azimuth == pytest.approx(180, abs=0.6)


def test_sunrise_is_in_the_east_at_the_equinox() -> None:
    azimuth, elevation = north_up(0.0, 0.0, "2026-03-20T06:10:00Z")
    assert azimuth == pytest.approx(90, abs=0.5)
    assert elevation == pytest.approx(0.6, abs=0.5)


@pytest.mark.parametrize(
    ("north", "morning_deg"),
    [("", 0.0), ("north_deg = 90,", 0.0), ("north_deg = 0,", -90.0), ("north_deg = 200,", 110.0)],
)
def test_azimuth_in_the_scene(north: str, morning_deg: float, tmp_path: Path) -> None:
    """East is +x by default; azimuth runs counter-clockwise, so east is 90 degrees before north."""
    pytest.importorskip("pvlib")
    sun = sun_of(tmp_path, f"{north} place = [0.0, 0.0], time = 2026-03-20T06:30:00Z, illuminance_klux = 20")
    assert math.degrees(sun.azimuth_rad) == pytest.approx(morning_deg, abs=0.5)
    assert math.degrees(sun.elevation_rad) == pytest.approx(5.7, abs=0.5)
    assert sun.illuminance_klux == 20


def test_noon_is_south_in_the_scene(tmp_path: Path) -> None:
    """Also when the time is text; +y is north, so the noon sun stands towards -y."""
    pytest.importorskip("pvlib")
    direction = sun_of(tmp_path, 'place = [48.0, 11.0], time = "2026-06-21T13:18:00+02:00"').direction
    assert direction == pytest.approx([0.0, -math.cos(math.radians(65.44)), math.sin(math.radians(65.44))], abs=2e-3)


def test_angles_as_before(tmp_path: Path) -> None:
    sun = sun_of(tmp_path, "azimuth_deg = 30, elevation_deg = 60")
    assert (math.degrees(sun.azimuth_rad), math.degrees(sun.elevation_rad)) == pytest.approx((30, 60))


@mistakes(
    """
    place = HERE, time = "2026-06-21T12:00:00" | sun.time | offset from UTC | 2026-06-21T12:00:00
    place = HERE, time = 2026-06-21T12:00:00 | sun.time | offset from UTC
    place = HERE, time = 2026-06-21 | sun.time | a time | 2026-06-21
    place = HERE, time = "noon" | sun.time | a time | noon
    place = HERE, time = 1600-06-21T12:00:00Z | sun.time | 1900 to 2100
    place = HERE | sun | place and time | place
    time = NOON | sun | place and time | time
    north_deg = 3 | sun | place and time | north_deg
    place = [111.0, 11.0], time = NOON | sun.place[0] | <= 90 | 111.0
    place = [48.0], time = NOON | sun.place | [48.0]
    place = HERE, time = NOON, azimuth_deg = 3 | sun | angles | azimuth_deg and place and time
    """,
    HERE="[48.0, 11.0]",
    NOON="2026-06-21T12:00:00Z",
)
def test_mistakes(given: str, named: str, tmp_path: Path) -> None:
    with told(named):
        sun_of(tmp_path, given)


def test_the_door_wants_an_offset() -> None:
    with pytest.raises(ValueError, match="offset from UTC"):
        pvlib.sun_north_up_deg(latitude_deg=0, longitude_deg=0, time=datetime(2026, 1, 1))


def test_without_pvlib(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """One line that says what to install, and angles still work."""
    real = builtins.__import__

    def absent(name: str, *arguments: Any) -> Any:
        if name.split(".")[0] == "pvlib":
            raise ModuleNotFoundError("No module named 'pvlib'")
        return real(name, *arguments)

    monkeypatch.setattr(builtins, "__import__", absent)
    pvlib.pvlib.cache_clear()
    with told("pip install 'lidarscene[sun]'", LidarSceneError):
        sun_of(tmp_path, "place = [48.0, 11.0], time = 2026-06-21T12:00:00Z")
    assert sun_of(tmp_path, "azimuth_deg = 30").elevation_rad == pytest.approx(math.pi / 4)
    monkeypatch.undo()
    pvlib.pvlib.cache_clear()
