"""`make bench`: how fast lidarscene is, as ratios taken in one process, in a Markdown table.

Writes out/benchmarks.md (or --output). docs/benchmarks.md holds a run, and what its rows mean.
"""

import argparse
import datetime
import sys
from pathlib import Path

import chain
import machine
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
            rows = process.start_rows(scenes / "car.toml", rounds=1)
            rows += process.memory_rows(scenes / "car.toml", step_deg=0.5)
            rows += chain.measure(scenes / "car.toml", step_deg=0.5, rounds=3)
        else:
            rows = process.start_rows(scenes / "car.toml", rounds=5)
            rows += process.memory_rows(scenes / "street.toml", step_deg=0.00774)
            rows += chain.measure(scenes / "street.toml", step_deg=0.0548, rounds=9)
    except LidarSceneError as error:
        print(f"benchmarks: {error}", file=sys.stderr)
        return error.exit_code
    text = report(rows, quick=arguments.quick)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(text, encoding="utf-8")
    print(text, end="")
    return 0


def report(rows: list[table.Row], *, quick: bool) -> str:
    command = "python benchmarks/run.py --quick" if quick else "make bench"
    head = [f"Measured {datetime.date.today()} by `{command}`.", *machine.described()]
    sizes = ["Small sizes: these figures say nothing about speed."] if quick else []
    return "".join(f"* {line}\n" for line in head + sizes) + "\n" + table.markdown(rows)


if __name__ == "__main__":
    sys.exit(main())
