"""How well a classifier tells recordings from their simulation: balanced accuracy, 0.5 if it cannot, 1 if always.

    python benchmarks/told_apart.py                                  the example os0-32
    python benchmarks/told_apart.py os1.pcap turns/=pandar64         recordings, with the sensor where none is in them

It is the number of `lidarscene certify`, by groups of features, over several seeds of the simulation. "Recorded twice"
is the control: two recorded frames of a sensor at rest, or the even and the odd columns of one frame. Sectors of the
azimuth that are judged were not learned from. Recordings of Ousters are in the tests of ouster-sdk (BSD-3), turns at
rest of a Pandar64 in PJLab-ADG's SensorsCalibration.
"""

import argparse
import sys

import numpy as np

from lidarscene import certify
from lidarscene.figures.report import text_table

GROUPS = ("all", "range texture", "holes", "edges", "intensity")
WHOLE = "told apart by a classifier"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", metavar="REC[=SENSOR]", nargs="*", default=["os0-32"])
    parser.add_argument("--seeds", type=int, default=1, help="simulations of each (default 1)")
    arguments = parser.parse_args()
    print(report(arguments.recordings, arguments.seeds))
    return 0


def report(recordings: list[str], seeds: int) -> str:
    """Table of the accuracies: mean over the seeds, the standard error of the first of all features, the control."""
    rows = []
    for named in recordings:
        recording, _, sensor = named.partition("=")
        runs = [_accuracies(recording, sensor or None, seed) for seed in range(seeds)]
        means = [np.mean([run[group]["value"] for run in runs]) if group in runs[0] else np.nan for group in GROUPS]
        whole = runs[0]["all"]
        control = "" if whole["real"] is None else f"{whole['real']:.2f}"
        rows.append((recording, control, *(f"{mean:.2f}" for mean in means), whole["note"], whole["condition"]))
    return text_table(("recording", "recorded twice", *GROUPS, "error", "of each side"), rows)


def _accuracies(recording: str, sensor: str | None, seed: int) -> dict[str, dict]:
    """Rows of the certificate by group of features."""
    rows = {row["quantity"]: row for row in certify(recording, sensor, seed=seed).numbers["rows"]}
    if rows[WHOLE]["value"] is None:
        raise SystemExit(f"{recording}: cannot be measured: {rows[WHOLE]['note']}")
    names = {group: WHOLE if group == "all" else f"told apart by {group} alone" for group in GROUPS}
    return {group: rows[name] for group, name in names.items() if name in rows}


if __name__ == "__main__":
    sys.exit(main())
