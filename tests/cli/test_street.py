"""`lidarscene street`: the folder it writes, what it prints, and what is refused."""

import re
from pathlib import Path

import pytest
from helpers.command_line import Run

from lidarscene.scene.scene_file import scene_model
from lidarscene.scene.street.street_file import StreetFile
from lidarscene.scene.street.street_tables import street_tables


def test_a_street_is_written(run: Run, tmp_path: Path) -> None:
    printed = run.well("street", "--length-m", "80", "--seed", "5", "--set", "lanes=2", "-o", "out/street")
    written = re.match(r"wrote out/street/street\.toml: ([0-9.]+) m of driving in ", printed)
    # The lane is longer outside of bends, and shorter inside.
    assert written is not None
    assert float(written[1]) == pytest.approx(80.0, abs=4.0)
    folder = tmp_path / "out" / "street"
    assert {path.name for path in folder.iterdir()} == {"street.toml", "meshes", "motions"}
    model = scene_model(folder / "street.toml")
    tables = street_tables(StreetFile(seed=5, length_m=80.0, lanes=2))
    assert [body.name for body in model.bodies] == [body["name"] for body in tables["bodies"]]
    first_line = (folder / "street.toml").read_text().partition("\n")[0]
    assert all(key in first_line for key in ("seed = 5,", "length_m = 80.0,", "lanes = 2,"))
