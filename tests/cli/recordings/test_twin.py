"""The command `twin`, and `compare --real` with a twin."""

from pathlib import Path

import pytest
from helpers.command_line import Run
from helpers.recordings import OUSTER


def test_a_twin_of_a_recording(run: Run) -> None:
    """One packet of an OS0: 16 of 1024 columns."""
    ran = run("twin", str(OUSTER), "--held-out", "columns", "-o", "twin")
    assert (ran.code, ran.err) == (0, "")
    assert "quads of 1 frame" in ran.out
    assert {path.name for path in Path("twin").iterdir()} == {
        "scene.toml", "sensor.toml", "twin.json", "meshes",
    }  # fmt: skip
    text = Path("twin/sensor.toml").read_text()
    assert "stops = 2" in text  # it recorded two returns


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("twin", "no.pcap", "-o", "twin"), "no.pcap: no such recording"),
        (("twin", "no.pcap", "-o", "twin", "--frames", "0-4"), "--frames: must be numbers with commas"),
        (("twin", "no.pcap", "-o", "twin", "--held-out", "half"), "--held-out: must be the number of a frame"),
        (("twin", str(OUSTER), "-o", "twin", "--held-out", "0"), "--held-out 0: must leave a frame"),
        (("compare", "scene.toml", "--real", str(OUSTER), "-o", "out"), "must be the scene of a twin"),
        (("compare", "a.toml", "--real", str(OUSTER), "-o", "o", "--illuminance", "1"), "--illuminance: goes with"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(run: Run, words: tuple[str, ...], said: str) -> None:
    ran = run(*words)
    assert ran.code == 2
    assert said in ran.err
    assert ran.err.count("\n") == 1
