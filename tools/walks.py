#!/usr/bin/env python3
"""Six users' first hours, as commands in empty folders: each goes on with what the one before it wrote.

`tools/environments.py wheel` runs them from the wheel. Sensors have few pulses. `tools/walks.py DIR` runs them in DIR
with the lidarscene of this Python, one process for each user.
"""

import contextlib
import importlib.util
import io
import itertools
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

COARSE = "--set scanner.azimuth_step_deg=4 --set scanner.elevation_step_deg=4"
FEW = "--set scanner.columns_per_turn=64 --set laser.repetition_rate_khz=81.92"
FEW_OF_RIG = "--set roof:scanner.columns_per_turn=64 --set roof:laser.repetition_rate_khz=81.92"
FEW_OF_RIG += " --set left:laser.repetition_rate_khz=24 --set right:laser.repetition_rate_khz=24"

WALKS = {
    "newcomer": f"""
        doctor
        catalog scenes
        render car -o out/car.ply --picture out/car.png {COARSE}
        view out/car.ply car --save out/car.html
        render car -o "out/zweite Fahrt/Straße.ply" {COARSE}
        compare out/car.ply "out/zweite Fahrt/Straße.ply" -o "out/zweite Fahrt/Vergleich"
        range VLP16 --distance 40
        range velodyne                    # error: did you mean hdl-32e or hdl-64e or vlp-16
        rendr car -o out/a.ply            # error: did you mean render
        help render""",
    "designer": """
        catalog sensors apd-905           > mine.toml
        check mine.toml
        range mine.toml sipm-905 --set power=50     # error: did you mean laser.peak_power_w
        range mine.toml sipm-905 --set mine.toml:laser.peak_power_w=12 --json    > ranges.json
        range mine.toml sipm-905 --over illuminance_klux --n 5 --plot out/lux.png --csv out/lux.csv
        range mine.toml --over illuminance_klux --to 100000      # error: did you mean 100
        range mine.toml --sensitivities --plot out/worth.svg
        range mine.toml --eye-safety
        design gain -o out/gain --json    > gain.json
        range out/gain/designs/001.toml mine.toml""",
    "trainer of perception": f"""
        street -o out/street --length-m 200
        render out/street/street.toml -o out/frames --frames 2 --sensor os1-128 --labels kitti {FEW} --no-truth -q
        render out/street/street.toml -o out/one.npz --sensor os1-128 --range-image out/one.range.npz {FEW}
        view out/frames --save out/frames.html
        render tree -o out/tree.bin --format kitti {COARSE}""",
    "owner of a real sensor": """
        view os0-32 --save out/recorded.html
        sensor --from os0-32 -o my-os0.toml
        twin os0-32 --held-out columns -o out/twin
        certify os0-32 --scene out/twin/scene.toml --sensor os0-128 -o out/other      # error: must have 32 channels""",
    "researcher": f"""
        range table1-apd table1-sipm --over illuminance_klux --n 7
        range table1-apd table1-sipm --over distance --quantity pd --illuminance-klux 20 --n 5 --json    > pd.json
        compare car --sensors apd-905,sipm-905 --same-beams -o out/compare {COARSE}
        compare garage --sensors apd-905,sipm-905 --illuminance-klux 0.05,100 -o out/dark {COARSE}
        fov apd-905 vlp-16 --time 0.02 --cell 8 -o out/fov --json    > fov.json""",
    "integrator": f"""
        check rig
        render drive --rig rig -o out/drive.mcap --frames 2 {FEW_OF_RIG}
        view out/drive.mcap --save out/drive.html
        render drive -o out/bag --format rosbag2 --sensor os1-128 {FEW}
        view out/bag --frame 0 --save out/bag.html
        render car -o out/car.pcap --sensor vlp-16
        view out/car.pcap --save out/no.html        # error: lidarscene[velodyne]""",
}
"""User -> commands. `> FILE` keeps what a command prints; `# error: TEXT` is part of the line with which it fails."""

WRITTEN = ("-o", "--picture", "--save", "--plot", "--csv", "--range-image")
"""Options that name a file or a folder to be written."""


class Step(NamedTuple):
    """One command of a walk, the file that keeps its text, and the error that it ends with; "" without."""

    words: list[str]
    kept_in: str
    error: str


def steps(user: str) -> Iterator[Step]:
    """Steps of a user's walk."""
    for line in filter(None, map(str.strip, WALKS[user].splitlines())):
        command, _, error = line.partition("# error: ")
        command, _, file = command.partition(" > ")
        if error == "lidarscene[velodyne]" and importlib.util.find_spec("velodyne_decoder"):
            error = ""
        yield Step(shlex.split(command), file.strip(), error)


def walk(user: str) -> None:
    """Walk in the current folder.

    Raises:
        SystemExit: with the command that did not end as it must
    """
    from lidarscene.cli.main import main

    began = time.monotonic()
    for step in steps(user):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(step.words)
        if mistake := outcome(step, code, out.getvalue(), err.getvalue()):
            raise SystemExit(f"walks: {user}: lidarscene {shlex.join(step.words)}: {mistake}")
        if step.kept_in:
            Path(step.kept_in).write_text(out.getvalue(), encoding="utf-8")
    print(f"walks: {user}: {time.monotonic() - began:.0f} s")


def outcome(step: Step, code: int, out: str, err: str) -> str:
    """What is wrong with how a command ended; "" if nothing is."""
    if step.error:
        # A slow machine prints what it waits for in a line before.
        as_expected = code > 0 and not out and step.error in err.splitlines()[-1] and "Traceback" not in err
        return "" if as_expected else f"must fail with a line that has '{step.error}', got {code}, {out}{err}"
    if code:
        return f"ended with {code}: {err}"
    written = [Path(name) for option, name in itertools.pairwise(step.words) if option in WRITTEN]
    for path in written:
        if not path.exists() or not (any(path.iterdir()) if path.is_dir() else path.stat().st_size):
            return f"{path} was not written"
    hidden = [str(path) for path in Path().rglob(".*")]
    return f"half-written files remain: {', '.join(hidden)}" if hidden else ""


def main() -> None:
    """Walk alone as the user that is named, or start a process for each."""
    folder, *users = sys.argv[1:]
    if users:
        os.chdir(folder)
        walk(users[0])
        return
    for user in WALKS:
        place = Path(folder) / user
        place.mkdir(parents=True)
        ran = subprocess.run([sys.executable, __file__, str(place), user], capture_output=True, text=True, check=False)
        print(ran.stdout, end="")
        if ran.returncode:
            raise SystemExit(ran.stderr)


if __name__ == "__main__":
    main()
