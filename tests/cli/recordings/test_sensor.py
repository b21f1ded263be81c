"""The command `sensor`."""

import shutil
from pathlib import Path

from helpers.command_line import Run
from helpers.recordings import OUSTER

from lidarscene.sensor.catalogue import load_sensor


def test_a_unit_of_an_ouster(run: Run) -> None:
    shutil.copy(OUSTER.with_suffix(".json"), "unit.json")
    ran = run("sensor", "--from", "unit.json", "--mode", "512x10", "-o", "mine.toml")
    assert (ran.code, ran.err) == (0, "")
    assert ran.out == "wrote mine.toml: OS-0-32-U1 992137000142, 32 beams, else as os0-128\n"
    assert load_sensor("mine.toml").scanner.pulses == 512 * 32


def test_mistakes_are_told_in_one_line(run: Run) -> None:
    shutil.copy(OUSTER.with_suffix(".json"), "unit.json")
    for arguments, told in (
        (("unit.json", "-o", "mine.txt"), "--output mine.txt: the name must end in .toml"),
        (("nothing.json", "-o", "a.toml"), "nothing.json: no such file"),
        (
            ("unit.json", "--like", "table1-apd", "-o", "a.toml"),
            "--like table1-apd: must be a sensor that spins",
        ),
        (("unit.json", "--like", "os9", "-o", "a.toml"), "os9"),
    ):
        ran = run("sensor", "--from", *arguments)
        assert (ran.code, ran.err.count("\n")) == (2, 1)
        assert told in ran.err
        assert not Path("a.toml").exists()
