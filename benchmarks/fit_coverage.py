"""How often the truth lies within one and two sigma of the fit: five units drawn at random, twenty recordings of each.

    python benchmarks/fit_coverage.py [seeds per unit]

First without a scene: laws are drawn by tests/helpers/drawn_recordings.py, forgotten, and fitted, also the near field
of two lenses. Then with a known one: tests/helpers/drawn_scenes.py renders it by the stages of `render`. Then one unit
in a street, ray by ray, and Pandar64s at rest between walls, four turns a recording, each with numbers of its own
(RESULTS.md has the results).
"""

import math
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
from scipy.stats import binom

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from helpers.drawn_recordings import drawn_sweep, drawn_truth, free_lenses, two_lenses
from helpers.drawn_scenes import REFLECTIVITY_SIGMA, SPOT, drawn_report, drawn_unit, published_sensor, unit_of
from helpers.rendered_recordings import walls
from helpers.turns_at_rest import turns_at_rest

from lidarscene import load_scene
from lidarscene.catalog import sensor_path
from lidarscene.rendering.simulator import Simulator
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.studies.fit.at_rest import LIGHT, fit_at_rest
from lidarscene.studies.fit.near_field import fit_near_field
from lidarscene.studies.fit.on_scene.known_scene import KnownScene, Observations, predict
from lidarscene.studies.fit.on_scene.likelihood import fit_parameters
from lidarscene.studies.fit.pixels_at_rest import pixels_at_rest
from lidarscene.studies.fit.published_fit import POWER
from lidarscene.studies.fit.recorded_pulses import gather_pulses
from lidarscene.studies.fit.recording_fit import fit_pulses
from lidarscene.studies.fit.sensor_text import Changes, at_rest_changes, get_key, parse_sensor, put_changes
from lidarscene.studies.ranging.plane import Target, detection_margin
from lidarscene.studies.twin.sensor_grid import on_grid
from lidarscene.studies.twin.tuning import ASSUMED_KLUX

UNITS = 5
TURNS = 4
AT_REST = {
    "laser.energy_spread": 0.03,
    "tdc.jitter_ps": 80.0,
    "tdc.strong_jitter_ps": 40.0,
    "laser.divergence_mrad": 6.0,
    "tdc.chatter_mhz": 150.0,
}
"""Choice: median numbers of the units at rest, in the units of their keys."""
LIGHTS = ((0.5, 3.0), (0.3, 0.3), (3.0, 3.0))
"""Choice: least and largest power of these units over the file's, in turn."""
STREET = Path(__file__).parents[1] / "scenes" / "drive.toml"


def without_scene(seeds: int) -> None:
    deviations: dict[str, list[float]] = {}
    for unit in range(UNITS):
        truth = drawn_truth(unit)
        for seed in range(seeds):
            pulses = gather_pulses([drawn_sweep(truth, 1000 * unit + seed)])
            fit = fit_pulses(pulses)
            for estimate in fit.estimates:
                deviations.setdefault(estimate.key, []).append(
                    (estimate.value - asdict(truth)[estimate.key]) / estimate.sigma
                )
    print_coverage(deviations)


def with_two_lenses(seeds: int) -> None:
    deviations: dict[str, list[float]] = {}
    sensor = load_sensor("os1-128")
    for unit in range(UNITS):
        truth, curve = two_lenses(unit, sensor)
        for seed in range(seeds):
            near = fit_near_field(gather_pulses([drawn_sweep(truth, 1000 * unit + seed, curve=curve)]), sensor)
            assert near is not None
            for estimate in near.estimates:
                deviations.setdefault(f"{estimate.key}, two lenses", []).append(
                    (estimate.value - asdict(truth)[estimate.key]) / estimate.sigma
                )
    for seed in range(UNITS * seeds):
        lenses, sweep = free_lenses(seed, sensor)
        near = fit_near_field(gather_pulses([sweep]), sensor)
        assert near is not None
        for estimate in near.estimates:
            deviations.setdefault(f"{estimate.key}, free lenses", []).append(
                (estimate.value - lenses[estimate.key]) / estimate.sigma
            )
    print_coverage(deviations)


def with_scene(seeds: int) -> None:
    deviations: dict[str, list[float]] = {}
    evaluations = []
    for unit in range(UNITS):
        truth = drawn_unit(unit)
        sensor = unit_of(truth)
        for seed in range(seeds):
            scene, reported = drawn_report(sensor, 1000 * unit + seed)
            fit = fit_parameters(scene, reported, reflectivity_sigma=REFLECTIVITY_SIGMA)
            evaluations.append(fit.solved.evaluations)
            for estimate in fit.estimates:
                if estimate.key in truth:
                    deviations.setdefault(estimate.key, []).append(
                        (estimate.value - math.exp(truth[estimate.key])) / estimate.sigma
                    )
    print_coverage(deviations)
    print(f"at most {max(evaluations)} evaluations; held: {', '.join(fit.held)}")


def with_street() -> None:
    """One unit in a street, with every ray traced: columns of 256, one reflectivity for all, known to 1 %."""
    truth, base, street = drawn_unit(3), published_sensor(columns=256), load_scene(STREET)
    light = Simulator(street, base).light()
    numbers: list[np.ndarray] = []
    cloud = Simulator(street, unit_of(truth, base)).render(seed=1, points=lambda pulse, _: numbers.append(pulse))
    has_surface, pulse = np.asarray(light.has_surface), np.concatenate(numbers).astype(int)
    echo = cloud.status == 0
    values_of = {name: np.full(len(has_surface), np.nan) for name in ("signal", "range_m", "ambient")}
    for name, values in values_of.items():
        chosen = np.ones_like(echo) if name == "ambient" else echo
        values[pulse[chosen]] = getattr(cloud, name)[chosen]
    signal, range_m, ambient = (values[has_surface] for values in values_of.values())
    scene = KnownScene.from_light(light, base, np.zeros(len(has_surface), int), spot_over_field=SPOT)
    # `render` reports no background of lost pulses; theirs at the truth has no effect.
    silent = np.asarray(predict(scene, truth).near_ir)
    reported = Observations(
        has_return=np.isfinite(range_m),
        signal=signal,
        near_ir=np.where(np.isfinite(ambient), ambient, silent),
        range_m=range_m,
    )
    fit = fit_parameters(scene, reported, reflectivity_sigma=0.01)
    for estimate in fit.estimates:
        if estimate.key in truth:
            z_score = (estimate.value - math.exp(truth[estimate.key])) / estimate.sigma
            print(
                f"{estimate.key:<28} {estimate.value:.4f} +/- {estimate.sigma:.4f}, {z_score:+.1f} sigma from the truth"
            )
    print(f"{len(range_m)} pulses, {fit.solved.evaluations} evaluations")


def at_rest(seeds: int, lights: tuple[float, float]) -> None:
    """Fit units with columns of 450 whose numbers, light and walls are drawn anew each time, and forgotten.

    Prints the root of the mean square of the relative errors, and the median of the intervals.

    Args:
        lights: least and largest power over the file's
    """
    changed: Changes = {"scanner.columns_per_turn": (450, ""), "laser.repetition_rate_khz": (288.0, "")}
    base = put_changes(sensor_path("pandar64").read_text("utf-8"), changed)
    found: dict[str, list[tuple[float, float]]] = {}
    for seed in range(seeds):
        random = np.random.default_rng(1000 + seed)
        light = math.exp(random.uniform(*np.log(lights)))
        truth = {key: value * math.exp(0.25 * random.normal()) for key, value in AT_REST.items()}
        scale = math.exp(0.2 * random.normal())
        drawn = {POWER: light * float(get_key(base, POWER)), **truth}
        unit = put_changes(base, at_rest_changes({key: (value, "") for key, value in drawn.items()}))
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "unit.toml").write_text(unit, "utf-8")
            Path(folder, "scene.toml").write_text(walls(scale), "utf-8")
            scene = load_scene(Path(folder, "scene.toml"))
        sensor = parse_sensor(unit, "unit")
        turns = turns_at_rest(scene, sensor, frames=TURNS, seed=seed)
        pixels = pixels_at_rest([on_grid(turn, sensor.scanner) for turn in turns], sensor)
        assert pixels is not None
        # The wider beam of the unit leaves more light outside of its field than the file's.
        target, middle_m = Target(illuminance_klux=ASSUMED_KLUX), np.median(pixels.select(pixels.fitted).mean_m)
        heights = [detection_margin(each, target, middle_m).item() for each in (sensor, parse_sensor(base, "file"))]
        truth[LIGHT] = heights[0] / heights[1]
        for estimate in fit_at_rest(pixels, base, "unit").estimates:
            if estimate.key in truth and estimate.is_known:
                true = truth[estimate.key]
                found.setdefault(estimate.key, []).append((estimate.value / true - 1.0, estimate.sigma / true))
    for key, of_key in found.items():
        error, sigma = np.array(of_key).T
        print(f"{key:<28} error {np.sqrt(np.mean(error**2)):.1%}, interval {np.median(sigma):.1%}")
    print_coverage({key: [error / sigma for error, sigma in of_key] for key, of_key in found.items()})


def print_coverage(deviations: dict[str, list[float]]) -> None:
    """Print how many intervals of one and of two sigma hold the truth, and how many do in 95 % of such benchmarks."""
    for key, far in {**deviations, "all": [z for of_key in deviations.values() for z in of_key]}.items():
        held = [f"{sum(abs(z) < sigmas for z in far)} ({limits_text(len(far), sigmas)})" for sigmas in (1, 2)]
        mean, largest = sum(far) / len(far), max(map(abs, far))
        print(f"{key:<28} of {len(far):3d} {' and '.join(held)}, mean {mean:+.2f} sigma, largest {largest:.1f}")


def limits_text(count: int, sigmas: int) -> str:
    low, high = binom.interval(0.95, count, math.erf(sigmas / math.sqrt(2.0)))
    return f"{low:.0f}-{high:.0f}"


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    without_scene(count)
    with_two_lenses(count)
    with_scene(count)
    with_street()
    for drawn_from in LIGHTS:
        print("at rest, {:g} to {:g} times the power of the file".format(*drawn_from))
        at_rest(count, drawn_from)
