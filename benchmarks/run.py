"""`make bench`: how fast lidarscene is, as ratios taken in one process, in Markdown tables.

Writes out/benchmarks.md (or --output); docs/benchmarks.md is such a page.
"""

import argparse
import dataclasses
import datetime
import sys
from pathlib import Path

import chain
import machine
import motion
import process
import table

from lidarscene.errors import LidarSceneError

ROOT = Path(__file__).parents[1]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, not how fast")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "benchmarks.md")
    arguments = parser.parse_args()
    scenes = ROOT / "scenes"
    try:
        if arguments.quick:
            sections = [
                *chain.measure(scenes / "car.toml", step_deg=0.5, rounds=3),
                motion.measure(scenes / "car.toml", step_deg=0.5, rounds=3),
                process.start(scenes / "car.toml", rounds=1, warm_up=False),
                process.memory(scenes / "car.toml", step_deg=0.5),
            ]
        else:
            sections = [
                *chain.measure(scenes / "street.toml", step_deg=0.0548, rounds=9),
                motion.measure(scenes / "street.toml", step_deg=0.0548, rounds=9),
                process.start(scenes / "car.toml", rounds=5),
                process.memory(scenes / "street.toml", step_deg=0.00774),
            ]
    except LidarSceneError as error:
        print(f"benchmarks: {error}", file=sys.stderr)
        return error.exit_code
    text = report(sections, quick=arguments.quick)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(text, encoding="utf-8")
    print(text, end="")
    return 0


def report(sections: list[table.Section], *, quick: bool) -> str:
    head = [f"Measured {datetime.date.today()} by `make bench`, which writes this page to out/benchmarks.md."]
    if quick:
        head = ["Small sizes by `--quick`: these figures say nothing about speed."]
        for section in sections:
            section.rows[:] = [dataclasses.replace(row, goal="") for row in section.rows]
    lines = "".join(f"* {line}\n" for line in [*head, *machine.described()])
    return f"# Benchmarks\n\n{lines}\n{table.markdown(sections)}"


if __name__ == "__main__":
    sys.exit(main())
