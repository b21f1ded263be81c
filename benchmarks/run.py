"""`make bench`: how fast lidarscene is, as ratios taken in one process, in Markdown tables.

Writes out/benchmarks.md (or --output); RESULTS.md beside this file is such a page.
"""

import argparse
import dataclasses
import datetime
import os
import sys
from collections.abc import Callable
from pathlib import Path

import bare
import batch
import chain
import gpu
import machine
import motion
import peers
import process
import rays
import receivers
import sensors
import table

from lidarscene.errors import LidarSceneError

ROOT = Path(__file__).parents[1]
STREET_DEG = 0.0548  # a million beams
SIZES = {"65k": 0.2145, "262k": 0.1072, "1M": STREET_DEG}
BARE_SIZES = {"30k": 0.316, "65k": 0.2145, "131k": 0.1515, "1M": STREET_DEG}
LARGER = {"10M": 0.0173}
SYNTHETIC = (1_000_000, 10_000_000)

Parts = dict[str, Callable[[], list[table.Section]]]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small sizes: shows that it works, not how fast")
    parser.add_argument(
        "--only", metavar="PART", nargs="+", choices=PARTS, default=PARTS, help=f"of {', '.join(PARTS)}"
    )
    parser.add_argument("--large", action="store_true", help="10 million beams against the peers too")
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "out" / "benchmarks.md")
    arguments = parser.parse_args()
    parts = quick_parts() if arguments.quick else full_parts(large=arguments.large)
    try:
        sections = [section for name in PARTS if name in arguments.only for section in parts[name]()]
    except LidarSceneError as error:
        print(f"benchmarks: {error}", file=sys.stderr)
        return error.exit_code
    text = report(sections, quick=arguments.quick)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(text, encoding="utf-8")
    print(text, end="")
    return 0


PARTS = ("sensors", "chain", "bare", "receivers", "peers", "rays", "motion", "start", "memory", "batch", "gpu")


def full_parts(*, large: bool) -> Parts:
    """Each part of the page by name."""
    street, car = ROOT / "scenes" / "street.toml", ROOT / "scenes" / "car.toml"
    sizes = SIZES | (LARGER if large else {})
    return {
        "sensors": lambda: [sensors.measure(street, rounds=7)],
        "chain": lambda: chain.measure(street, step_deg=STREET_DEG, rounds=9),
        "bare": lambda: [
            bare.measure(street, sizes=BARE_SIZES, triangles=SYNTHETIC[-1], middle="131k", city=True, rounds=9)
        ],
        "receivers": lambda: [receivers.measure(street, step_deg=STREET_DEG, rounds=9)],
        "peers": lambda: [peers.measure(street, sizes=sizes, synthetic=SYNTHETIC, middle="262k", rounds=3)],
        "rays": lambda: [rays.measure(street, single_deg=STREET_DEG, many_deg=4 * STREET_DEG, rays=16, rounds=5)],
        "motion": lambda: [motion.measure(street, step_deg=STREET_DEG, rounds=9)],
        "start": lambda: [process.start([car, ROOT / "scenes" / "town.toml"], rounds=5)],
        "memory": lambda: [process.memory(street, step_deg=0.00774)],
        "batch": lambda: [batch.measure(street, frames=40, step_deg=0.1, rounds=4)],
        "gpu": lambda: gpu.measure(street, variant=gpu.VARIANTS["cuda"], rounds=15, frames=1000),
    }


def quick_parts() -> Parts:
    """The same in small."""
    car = ROOT / "scenes" / "car.toml"
    return {
        "sensors": lambda: [sensors.measure(car, sensors=("vlp-16",), rounds=2)],
        "chain": lambda: chain.measure(car, step_deg=0.5, rounds=3),
        "bare": lambda: [bare.measure(car, sizes={"12k": 0.5}, triangles=2_000, middle="12k", city=False, rounds=2)],
        "receivers": lambda: [receivers.measure(car, step_deg=0.5, rounds=2)],
        "peers": lambda: [peers.measure(car, sizes={"12k": 0.5}, synthetic=(2_000,), middle="12k", rounds=2)],
        "rays": lambda: [rays.measure(car, single_deg=0.5, many_deg=2.0, rays=16, rounds=2)],
        "motion": lambda: [motion.measure(car, step_deg=0.5, rounds=3)],
        "start": lambda: [process.start([car], rounds=1, warm_up=False)],
        "memory": lambda: [process.memory(car, step_deg=0.5)],
        "batch": lambda: [batch.measure(car, frames=4, step_deg=0.5, rounds=1)],
        "gpu": lambda: gpu.measure(
            car, sensors=("vlp-16",), moving=(), variant=gpu.VARIANTS["llvm"], rounds=2, frames=2
        ),
    }


def report(sections: list[table.Section], *, quick: bool) -> str:
    head = [f"Measured {datetime.date.today()} by `make bench`, which writes this page to out/benchmarks.md."]
    if quick:
        head = ["Small sizes by `--quick`: these figures say nothing about speed."]
        for section in sections:
            if not section.columns:
                section.rows[:] = [dataclasses.replace(row, goal="") for row in section.rows]
    if hasattr(os, "getloadavg"):
        head.append(f"Load average of the last 15 minutes at its end: {os.getloadavg()[2]:.1f}, this run included.")
    lines = "".join(f"* {line}\n" for line in [*head, *machine.description_lines()])
    return f"# Benchmarks\n\n{lines}\n{table.markdown(sections)}"


if __name__ == "__main__":
    sys.exit(main())
