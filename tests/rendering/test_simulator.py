"""A frame handed out chunk by chunk: the points of the whole, in memory that does not grow with it."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers.clouds import assert_same

from lidarscene import load_scene, load_sensor
from lidarscene.cloud.points import PointCloud
from lidarscene.errors import InputError
from lidarscene.formats.registry import FORMATS
from lidarscene.rendering.simulator import Simulator, Summary

CAR = Path(__file__).parents[2] / "scenes" / "car.toml"
CHUNK = 10_000


@pytest.fixture(scope="module")
def simulator() -> Callable[..., Simulator]:
    """Function of the number of rows: the car, seen by 601 pulses in each of them, in one world."""
    scene = load_scene(CAR)
    world = Simulator(scene, load_sensor("table1-apd")).world

    def of(*, rows: int) -> Simulator:
        step = f"scanner.elevation_step_deg={25.0 / (rows - 1)}"
        return Simulator(scene, load_sensor("table1-apd", overrides=[step]), world=world)

    return of


Of = Callable[..., Simulator]


def test_pieces_are_the_whole(simulator: Of) -> None:
    """Also the counts: of chunks and of the cloud itself."""
    sim, pieces = simulator(rows=72), list[PointCloud]()
    streamed, rendered, progress = Summary(), Summary(), list[tuple[int, int]]()
    sim.stream(
        pieces.append, seed=5, chunk=CHUNK, summary=streamed, progress=lambda *told: progress.append(told)
    )
    whole = sim.render(seed=5, summary=rendered)
    assert len(pieces) == 5
    assert_same(PointCloud.concatenate(pieces), whole)
    assert streamed.points == rendered.points == len(whole)
    assert np.array_equal(streamed.statuses, np.bincount(whole.status, minlength=len(streamed.statuses)))
    assert np.array_equal(streamed.outcomes, rendered.outcomes)
    assert progress[-1] == (streamed.beams, sim.sensor.scanner.pulses)
    assert streamed.beams == sim.sensor.scanner.pulses


def test_light_is_that_of_the_render(simulator: Of) -> None:
    """Traced once for studies: the same surfaces at the same ranges, and power only where there is one."""
    sim, seen = simulator(rows=2), list[tuple[np.ndarray, dict[str, np.ndarray]]]()
    sim.render(seed=5, points=lambda pulse, columns: seen.append((pulse, dict(columns))))
    light = sim.light(seed=5)
    powers, ranges = (
        np.stack([np.asarray(getattr(part, name)) for part in light.parts])
        for name in ("peak_power_w", "range_m")
    )
    strongest = powers.argmax(axis=0)
    found, range_m = np.asarray(light.found), ranges[strongest, np.arange(len(strongest))]
    assert found.shape == (sim.sensor.scanner.pulses,)
    assert np.array_equal(powers.max(axis=0) > 0.0, found)
    # The columns are of the pulses that met a surface, which are not those that became points.
    ((_, columns),) = seen
    met = columns["pulse"]
    assert len(met) > 100
    assert np.array_equal(np.flatnonzero(found), np.sort(met))
    np.testing.assert_allclose(range_m[met], columns["true_range_m"], rtol=1e-6)


def test_a_wrong_frame_is_refused_before_anything_is_handed_out(simulator: Of) -> None:
    pieces: list[PointCloud] = []
    with pytest.raises(
        InputError, match=r"^coordinates: must be 'world' or 'vehicle' or 'sensor', got 'moon'$"
    ):
        simulator(rows=2).stream(pieces.append, coordinates="moon")
    assert pieces == []


def peak(task: Callable[[], object]) -> int:
    """Bytes that Python and numpy held at most, after a first time that fills caches."""
    task()
    tracemalloc.start()
    task()
    held = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return held


def test_memory_does_not_grow_with_the_frame(simulator: Of, tmp_path: Path) -> None:
    """Four times the pulses, in chunks of one size, to a file.

    Tolerance: the last chunk of a frame is smaller than the others, and more or less of one is kept: half of what a
    chunk takes. The cloud that `render` returns is there to show that the measure sees it.
    """
    small, large = simulator(rows=40), simulator(rows=160)

    def to_file(sim: Simulator) -> None:
        with FORMATS["ply"].stream(tmp_path / "a.ply") as append:
            sim.stream(append, chunk=CHUNK)

    assert peak(lambda: to_file(large)) < 1.5 * peak(lambda: to_file(small))
    assert peak(lambda: large.render(chunk=CHUNK)) > 3.0 * peak(lambda: small.render(chunk=CHUNK))
