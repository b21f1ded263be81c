"""Sensors of every kind rendered one after another in one process: a kernel or table of an earlier one must not serve.

Dr.Jit finds compiled kernels by their text. What is not in the text, such as the size of local memory, a recording or a
table on the device, could come from another sensor. So each frame is rendered twice, with others in between, in another
order: the bits must be the same, and every number must be finite.
"""

import os
import random

import numpy as np
import pytest
from helpers.run_seed import run_seed

from lidarscene import InputError, Simulator, load_scene, load_sensor

SENSORS = int(os.environ.get("FUZZ_SENSORS", "2"))
SEED = int(os.environ.get("FUZZ_SEED") or run_seed())

COARSE_RASTER = ("scanner.azimuth_step_deg=2", "scanner.elevation_step_deg=2")
COARSE_HEAD = ("scanner.columns_per_turn=128",)
QUICK_TURN = ("scanner.rotation_hz=-100",)
KINDS = {
    "table1-apd": COARSE_RASTER,
    "table1-sipm": COARSE_RASTER,
    "os0-128": COARSE_HEAD,
    "os1-128": COARSE_HEAD,
    "os2-128": COARSE_HEAD,
    "sony-spad-189x600": ("scanner.columns=50", "scanner.rows=21"),
    "vlp-16": QUICK_TURN,
    "hdl-64e": QUICK_TURN,
    "livox-horizon": ("laser.repetition_rate_khz=24",),
}
"""Sensors with a few thousand pulses a frame."""
SCENES = ("car", "glass", "retro", "edges")


def drawn(rng: random.Random) -> tuple[str, tuple[str, ...], tuple[str, ...], dict[str, int]]:
    """Scene, changes of the scene, name and changes of a sensor, options of tracing."""
    name = rng.choice(list(KINDS))
    sensor = load_sensor(name)
    changes = [f"laser.peak_power_w={float(sensor.laser.peak_power_w) * 10.0 ** rng.uniform(-2, 2):.6g}"]
    changes += [f"optics.focal_length_mm={1e3 * float(sensor.optics.focal_length_m) * 10.0 ** rng.uniform(-1, 1):.6g}"]
    if sensor.histogram is not None:
        spads = rng.choice([1, 4, 64, 1000])
        changes += [f"detector.spads={spads}", f"histogram.stops={rng.choice([1, 2, 5])}"]
        changes += [f"detector.dead_time_ns={rng.choice([4, 10, 40])}"]
        changes += [
            f'detector.stamps="{rng.choice(["all", "first"])}"',
            f"detector.coincidence={min(rng.choice([1, 1, 2, 3, 8]), spads)}",
        ]
        changes += [f"histogram.threshold_floor={rng.choice([0.03, 3, 30])}"]
    else:
        changes += [f'tdc.keep="{rng.choice(["first", "last", "strongest", "all"])}"']
    if name == "table1-sipm":
        changes += [f"detector.cells={rng.choice([10, 400, 10000])}"]
        changes += [f'detector.statistics="{rng.choice(["published", "time_domain"])}"']
    if sensor.tdc.keep and rng.random() < 0.3 and name.startswith("table1"):
        changes += [f'tdc.timing="{rng.choice(["constant_fraction", "peak", "matched_filter"])}"']
    weather = ()
    if rng.random() < 0.4:
        weather = (rng.choice(["weather.fog_visibility_km=0.2", "weather.rain_mm_h=20", "weather.snow_mm_h=3"]),)
    weather += (f"sun.illuminance_klux={rng.choice([0, 1, 100])}",)
    options = {"rays": rng.choice([1, 1, 1, 4, 16]), "interactions": rng.choice([0, 3])}
    return name, (*KINDS[name], *changes), weather, options


def rendered(which: tuple[str, tuple[str, ...], tuple[str, ...], dict[str, int]], scene: str) -> bytes | str:
    """All columns of the frame as bytes, or the line of a sensor that cannot be."""
    name, changes, scene_changes, options = which
    try:
        described = load_scene(f"scenes/{scene}.toml", overrides=list(scene_changes))
        cloud = Simulator(described, load_sensor(name, overrides=list(changes)), **options).render(seed=3)
    except InputError as error:
        return str(error)
    for column in cloud.columns:
        if column.dtype.startswith("float") and column.name != "true_range":
            assert np.isfinite(cloud.column(column.name)).all(), (which, scene, column.name)
    return b"".join(np.ascontiguousarray(getattr(cloud, column.attribute)).tobytes() for column in cloud.columns)


def test_each_sensor_renders_the_same_among_others(mi: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))))
    rng = random.Random(SEED)
    chosen = [(drawn(rng), rng.choice(SCENES)) for _ in range(SENSORS)]
    first = [rendered(*choice) for choice in chosen]
    order = rng.sample(range(SENSORS), SENSORS)
    for number in order:
        assert rendered(*chosen[number]) == first[number], chosen[number]
    assert any(isinstance(answer, bytes) for answer in first)
