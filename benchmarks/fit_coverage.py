"""How often the truth lies within two sigma of the fit: five units drawn at random, twenty recordings of each.

    python benchmarks/fit_coverage.py [seeds per unit]

First without a scene: laws are drawn by tests/helpers/drawn_recordings.py, forgotten, and fitted. Then with a known
one: tests/helpers/drawn_scenes.py renders it by the stages of `render` (docs/fit.md has the results).
"""

import math
import sys
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from helpers.drawn_recordings import drawn_sweep, drawn_truth
from helpers.drawn_scenes import REFLECTIVITY_SIGMA, drawn_report, drawn_unit, unit_of

from lidarscene.studies.fit.likelihood import fit_known
from lidarscene.studies.fit.pulses import pulses_of
from lidarscene.studies.fit.study import fit_pulses

UNITS = 5


def without_scene(seeds: int) -> None:
    off: dict[str, list[float]] = {}
    held = 0
    for unit in range(UNITS):
        truth = drawn_truth(unit)
        for seed in range(seeds):
            pulses = pulses_of([drawn_sweep(truth, 1000 * unit + seed)])
            fit = fit_pulses(pulses, recording="drawn", sensor="drawn")
            held += fit.passed
            for one in fit.estimates:
                off.setdefault(one.key, []).append((one.value - asdict(truth)[one.key]) / one.sigma)
    told(off)
    print(f"{held} of {UNITS * seeds} pass on what was not fitted")


def with_scene(seeds: int) -> None:
    off: dict[str, list[float]] = {}
    evaluations = []
    for unit in range(UNITS):
        truth = drawn_unit(unit)
        sensor = unit_of(truth)
        for seed in range(seeds):
            scene, reported = drawn_report(sensor, 1000 * unit + seed)
            fit = fit_known(scene, reported, reflectivity_sigma=REFLECTIVITY_SIGMA)
            evaluations.append(fit.solved.evaluations)
            for one in fit.estimates:
                if one.key in truth:
                    off.setdefault(one.key, []).append((one.value - math.exp(truth[one.key])) / one.sigma)
    told(off)
    print(f"at most {max(evaluations)} evaluations; held: {', '.join(fit.held)}")


def told(off: dict[str, list[float]]) -> None:
    for key, far in off.items():
        inside, mean = sum(abs(x) < 2.0 for x in far), sum(far) / len(far)
        largest = max(map(abs, far))
        print(
            f"{key:<28} {inside:3d} of {len(far)} within 2 sigma, mean {mean:+.2f} sigma, largest {largest:.1f}"
        )


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    without_scene(count)
    with_scene(count)
