"""How often the truth lies within two sigma of the fit: five units drawn at random, twenty recordings of each.

    python benchmarks/fit_coverage.py [seeds per unit]

The laws are drawn by tests/helpers/drawn_recordings.py, forgotten, and fitted (docs/fit.md has the result).
"""

import sys
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from helpers.drawn_recordings import drawn_sweep, drawn_truth

from lidarscene.studies.fit.pulses import pulses_of
from lidarscene.studies.fit.study import fit_pulses

UNITS = 5


def main(seeds: int) -> None:
    within: dict[str, list[float]] = {}
    held = 0
    for unit in range(UNITS):
        truth = drawn_truth(unit)
        for seed in range(seeds):
            fit = fit_pulses(
                pulses_of([drawn_sweep(truth, 1000 * unit + seed)]), recording="drawn", sensor="drawn"
            )
            held += fit.passed
            for one in fit.estimates:
                within.setdefault(one.key, []).append((one.value - asdict(truth)[one.key]) / one.sigma)
    total = UNITS * seeds
    for key, off in within.items():
        inside = sum(abs(x) < 2.0 for x in off)
        mean = sum(off) / len(off)
        print(
            f"{key:<18} {inside:3d} of {total} within 2 sigma, mean {mean:+.2f} sigma, largest {max(map(abs, off)):.1f}"
        )
    print(f"{held} of {total} pass on what was not fitted")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
