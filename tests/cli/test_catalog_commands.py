"""`lidarscene check`: every mistake of a file at once, and none in ours."""

from pathlib import Path

import pytest
from helpers.command_line import Run

from lidarscene import catalog

BAD = """
nam = "x"

[sun]
azimut_deg = 3
elevation_deg = 100

[[bodies]]
name = "a"
primitive = "plane"
size_m = [3]
material = "concrete"
"""

MISSING = """
[[bodies]]
name = "a"
mesh = "nowhere.glb"

[[bodies]]
name = "fine"
primitive = "plane"
size_m = [3, 3]
material = "concrete"

[[bodies]]
name = "c"
primitive = "plane"
size_m = [3, 3]
material = "concret"
"""


def test_all_mistakes_of_the_tables(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(BAD)
    ran = run("check", str(path))
    assert (ran.code, ran.err) == (2, "")
    mistakes = [line.removeprefix(f"{path}: ").partition("; all")[0] for line in ran.out.splitlines()]
    assert sorted(line.partition("?")[0] for line in mistakes) == [
        'bodies[0 "a"]: size_m of a plane must have 2 numbers, got 1',
        "sun.elevation_deg: must be <= 90, got 100",
        "unknown key 'nam'; did you mean name",
        "unknown key 'sun.azimut_deg'; did you mean azimuth_deg",
    ]


def test_all_mistakes_of_what_it_names(run: Run, tmp_path: Path) -> None:
    """Missing files and materials show when bodies are read: each body is tried."""
    path = tmp_path / "missing.toml"
    path.write_text(MISSING)
    lines = run("check", str(path)).out.splitlines()
    assert [line.partition(": ")[2].partition(" in the")[0] for line in lines] == [
        f'bodies[0 "a"].mesh: {tmp_path / "nowhere.glb"}: no such file',
        "bodies[2 \"c\"].material: no material 'concret'",
    ]


def test_files_of_every_kind_are_known_by_their_tables(run: Run, tmp_path: Path) -> None:
    scenes = Path(__file__).parents[2] / "scenes"
    files = [
        scenes / "edges.toml",
        catalog.path_of("examples", "job"),
        catalog.path_of("examples", "rig"),
        catalog.path_of("sensors", "vlp-16"),
        catalog.path_of("materials", "leaf"),
    ]
    ran = run("check", *map(str, files), "edges")
    assert ran.code == 0
    assert ran.out.splitlines() == [f"{checked}: no mistake found" for checked in [*files, "edges"]]


@pytest.mark.parametrize(("content", "message"), [(None, "no such file"), ("a =", "not valid TOML")])
def test_what_cannot_be_read(run: Run, tmp_path: Path, content: str | None, message: str) -> None:
    path = tmp_path / "a.toml"
    if content is not None:
        path.write_text(content)
    ran = run("check", str(path))
    assert ran.code == 2
    assert message in ran.out
    assert ran.out.count("\n") == 1
