"""`lidarscene fov`: everything it promises is there, and what it refuses."""

import csv
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.command_line import BEAMS, COARSE, WALL, Run
from helpers.in_this_process import draw_roughly
from helpers.walls import rig_text

from lidarscene.cli import main
from lidarscene.figures.report import Report
from lidarscene.studies.field_of_view import field_of_view_figures as figures
from lidarscene.studies.field_of_view import field_of_view_study as study

SCENES = Path(__file__).parents[2] / "scenes"
FAST = (*COARSE, "--time", "0.001,0.01", "--cell", "2")
RISEN = "--set=table1-sipm:mounting.position_m=[0.0,0.0,1.9]"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The command run once; `test_points_on_bodies` draws the charts whole."""
    output_folder = tmp_path_factory.mktemp("fov") / "new" / "out"
    with pytest.MonkeyPatch.context() as patch:
        draw_roughly(patch)
        assert main.main(["fov", "table1-apd", "table1-sipm", "-o", str(output_folder), *FAST, RISEN]) == 0
    return output_folder


_MAPS = [
    f"{sensor}-{map_}"
    for sensor in ("table1-apd", "table1-sipm")
    for map_ in ("pattern", "density", "revisit", "range")
]
_STEMS = ("patterns", "coverage", "spacing", "ground", *_MAPS)
NAMES = ["index.html", "index.md", *(f"{stem}.{suffix}" for stem in _STEMS for suffix in ("png", "csv"))]


def test_all_files_are_there_and_nothing_else(folder: Path) -> None:
    assert sorted(path.name for path in folder.iterdir()) == sorted(NAMES)


@pytest.mark.parametrize("name", [name for name in NAMES if name.endswith((".png", ".csv"))])
def test_pictures_and_tables(folder: Path, name: str) -> None:
    if name.endswith(".png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
        return
    with (folder / name).open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert len(rows) > 10
    assert {len(row) for row in rows} == {len(rows[0])}
    sensor_columns = {"sensor", "sensors"} & set(rows[0][:1])
    for row in rows[1:]:
        if sensor_columns:
            assert row.pop(0) in ("table1-apd", "table1-sipm")
        assert all(cell == "nan" or float(cell) >= -180.0 for cell in row)


def test_patterns_of_all_sensors_and_their_azimuths(folder: Path) -> None:
    """The coarse raster is 40 degrees wide and 20 high."""
    with (folder / "patterns.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["sensor"] for row in rows} == {"table1-apd", "table1-sipm"}
    assert len(rows) == 2 * BEAMS
    page = (folder / "index.md").read_text("utf-8")
    assert page.count("-20.00 to 20.00°") == 2
    assert page.index("patterns.png") < page.index("coverage.png")
    assert '<div class="row"><figure>' in (folder / "index.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("azimuth", "arc", "text"),
    [
        ([-60.0, 0.0, 60.0], (-60.0, 60.0), "-60.00 to 60.00°"),
        ([150.0, 179.0, -179.0, -150.0], (150.0, 210.0), "150.00 to 210.00°"),
        ([-170.0, -120.0], (-170.0, -120.0), "-170.00 to -120.00°"),
        (list(range(-180, 180, 4)), (-180.0, 180.0), "all around"),
        ([5.0], (5.0, 5.0), "5.00 to 5.00°"),
    ],
)
def test_the_shortest_arc(azimuth: list[float], arc: tuple[float, float], text: str) -> None:
    """Also of a sensor that looks back, whose azimuths jump from 180 to -180."""
    azimuth_deg = np.array(azimuth)
    assert figures.azimuth_arc_deg(azimuth_deg) == pytest.approx(arc)
    assert figures.azimuth_text(azimuth_deg) == text


def test_pages_show_everything(folder: Path) -> None:
    pictures = {name for name in NAMES if name.endswith(".png")}
    page = (folder / "index.html").read_text("utf-8")
    assert set(re.findall(r'src="([^"]+)"', page)) == pictures
    targets = set(re.findall(r'(?:src|href)="([^"]+)"', page))
    assert targets == {name for name in NAMES if not name.startswith("index")}
    assert "http" not in page
    links = re.findall(r"\]\(([^)]+)\)", (folder / "index.md").read_text("utf-8"))
    assert set(links) == targets
    assert "Cells are 2 degrees high" in page


def test_the_same_again_and_as_json(folder: Path, run: Run, rough_charts: None) -> None:
    printed = run.well("fov", "table1-apd", "table1-sipm", "-o", "again", *FAST, RISEN, "--json")
    numbers = json.loads(printed)
    assert numbers["sensors"]["table1-apd"]["coverage"]["0.01"] == 1.0
    assert numbers["sensors"]["table1-apd"]["points_per_s"] == pytest.approx(50e3)
    for name in NAMES:
        assert Path("again", name).read_bytes() == (folder / name).read_bytes(), name


LABELLED = WALL.replace('"wall"', '"wall"\nclass = "building"', 1)


def bodies_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "bodies.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_points_on_bodies(mi, run: Run, tmp_path: Path) -> None:
    """The wall of 4 m at 10 m: 11.3 degrees to each side, so 11 by 11 beams of 2 degrees."""
    (tmp_path / "wall.toml").write_text(LABELLED)
    run.well("fov", "table1-apd", "-o", "out", *FAST, "--scene", "wall.toml")
    assert "No view from above" in (tmp_path / "out" / "index.md").read_text("utf-8")
    (row,) = bodies_of(tmp_path / "out")
    assert (row["sensor"], row["body"], row["class"]) == ("table1-apd", "wall", "building")
    assert int(row["points"]) == pytest.approx(11 * 11, abs=4)
    assert 10.0 <= float(row["distance_m"]) < 10.4


def test_each_sensor_stands_at_its_own_mounting(mi, run: Run, no_charts: None, tmp_path: Path) -> None:
    """5 m nearer: half the distance, 21.8 degrees to each side, so all 21 by 11 beams of the coarse raster."""
    (tmp_path / "wall.toml").write_text(LABELLED)
    near = "--set=table1-sipm:mounting.position_m=[5.0,0.0,0.0]"
    run.well("fov", "table1-apd", "table1-sipm", "-o", "out", *FAST, near, "--scene", "wall.toml")
    rows = {row["sensor"]: row for row in bodies_of(tmp_path / "out")}
    assert float(rows["table1-apd"]["distance_m"]) == pytest.approx(10.2, abs=0.2)
    assert float(rows["table1-sipm"]["distance_m"]) == pytest.approx(5.2, abs=0.2)
    assert int(rows["table1-sipm"]["points"]) == pytest.approx(21 * 11, abs=4)


RIG = rig_text(
    ("front", "table1-apd", "position_m = [2, 0, 1.9]"),
    ("back", "table1-apd", "position_m = [-2, 0, 1.9]", "yaw_deg = 180"),
)


def test_a_rig(mi, run: Run, no_charts: None, tmp_path: Path) -> None:
    """Each looks its own way from its own place: on the ground, and on walls 10 m before and behind the vehicle."""
    (tmp_path / "walls.toml").write_text(
        LABELLED + LABELLED.replace('name = "wall"', 'name = "behind"').replace("[10, 0, 1.8]", "[-10, 0, 1.8]")
    )
    (tmp_path / "rig.toml").write_text(RIG)
    out = run.well("fov", "--rig", "rig.toml", "-o", "out", *FAST, "--scene", "walls.toml", "--pose=0,0,-1.9", "--json")
    assert set(json.loads(out)["sensors"]) == {"front", "back"}
    rows = {row["sensor"]: row for row in bodies_of(tmp_path / "out")}
    assert {name: row["body"] for name, row in rows.items()} == {"front": "wall", "back": "behind"}
    assert all(8.0 <= float(row["distance_m"]) < 8.6 for row in rows.values())
    with (tmp_path / "out" / "ground.csv").open(newline="", encoding="utf-8") as file:
        ground = list(csv.DictReader(file))
    reach = {name: [float(cell["x_m"]) for cell in ground if cell[name] == "1"] for name in ("front", "back")}
    # Blind to 1.9 m / tan 10 degrees before each, with the cells of 2 degrees; none sees the other's side.
    nearest, farthest = (2.0 + 1.9 / math.tan(math.radians(degrees)) for degrees in (12.0, 10.0))
    assert nearest < min(reach["front"]) < farthest
    assert max(reach["back"]) == pytest.approx(-min(reach["front"]), abs=0.6)


def test_equal_names_get_files_of_their_own() -> None:
    assert study.slugs(["a b", "a-b", "A B", "ü"]) == ["a-b", "a-b-2", "a-b-3", "sensor"]
    assert study.slugs(["a-3", "a", "A"]) == ["a-3", "a", "a-4"]  # "a-3" is given away already


@pytest.mark.parametrize(("pose", "x_m"), [((), 0.0), (("--pose", "5,0,0"), 5.0)])
def test_a_rigs_vehicle_stands_at_the_origin(
    run: Run, monkeypatch: pytest.MonkeyPatch, pose: tuple[str, ...], x_m: float
) -> None:
    """Rationale: a rig's places are on its vehicle; the scene's own sensor stands 2 m above it, or elsewhere."""
    vehicles: list[Any] = []
    monkeypatch.setattr(
        study, "field_of_view_study", lambda *_, vehicle, **__: vehicles.append(vehicle) or Report("Fields of view")
    )
    run.well("fov", "--rig", "rig", "--scene", str(SCENES / "car.toml"), "-o", "out", *pose)
    assert vehicles[0].position_m.tolist() == [x_m, 0.0, 0.0]


@pytest.mark.parametrize(("cell", "code"), [("0.02", 0), ("10", 0), ("0.019", 2), ("10.1", 2)])
def test_the_smallest_and_the_largest_cell(run: Run, monkeypatch: pytest.MonkeyPatch, cell: str, code: int) -> None:
    monkeypatch.setattr(study, "field_of_view_study", lambda *_, **__: Report("Fields of view"))
    assert run("fov", "table1-apd", "-o", "out", "--cell", cell).code == code
