"""A recording file of a simulated Ouster, in a scene of walls: what `fit --scene` must find the sensor of again."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lidarscene.recordings.opening import open_recording
from lidarscene.recordings.units.unit_file import read_unit, write_unit
from lidarscene.rendering.simulator import Simulator
from lidarscene.scene.scene_file import load_scene
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.fit.estimates import Estimate
from lidarscene.studies.fit.sensor_text import scaled_text
from lidarscene.studies.twin.matched_pulses import match_pulses

from .recordings import OUSTER

COLUMNS = slice(100, 420)
"""Of 1024, that are recorded: from the right over the front to the left, some."""

SCENE = """
name = "walls"
[sun]
elevation_deg = 40.0
azimuth_deg = 200.0
illuminance_klux = 60.0
[sensor]
name = "unit.toml"
position_m = [0.0, 0.0, 1.8]
yaw_deg = 30.0
[materials]
"""


def walls(scale: float = 1.0) -> str:
    """A road, and walls along it whose distance grows from 2 to 60 m; ``scale`` of all reflectivities below 0.98."""
    materials = "".join(
        f'{name} = {{ bsdf = "diffuse", reflectivity = {min(value * scale, 0.98):.4f} }}\n'
        for name, value in {"road": 0.12, "grey": 0.3, "white": 0.85}.items()
    )
    text = SCENE + materials + _body("road", "road", (200.0, 200.0), (0.0, 0.0, 0.0))
    for number, away_m in enumerate(np.geomspace(2.0, 60.0, 12)):
        azimuth = np.radians(-150.0 + 25.0 * number)
        place = away_m * np.cos(azimuth), away_m * np.sin(azimuth), 0.4 * away_m
        size = (0.9 * away_m, 0.46 * away_m)
        turned = f"yaw_deg = {np.degrees(azimuth):.6f}\npitch_deg = 90.0\n"
        text += _body(f"wall{number}", ("grey", "white")[number % 2], size, place) + turned
    return text


def _body(name: str, material: str, size_m: tuple[float, float], place_m: tuple[float, ...]) -> str:
    numbers = ", ".join(f"{x:.6f}" for x in place_m)
    return (
        f'[[bodies]]\nname = "{name}"\nclass = "{name}"\nprimitive = "plane"\nmaterial = "{material}"\n'
        f"size_m = [{size_m[0]:.6f}, {size_m[1]:.6f}]\nposition_m = [{numbers}]\n"
    )


def scene_and_units(folder: Path, truth: Mapping[str, float]) -> tuple[Path, Sensor]:
    """The scene's file, with the published unit beside it, and the unit whose numbers are so many times those."""
    path, unit = folder / "scene.toml", folder / "unit.toml"
    described = OUSTER.with_suffix(".json")
    write_unit(read_unit(described), described, unit)
    path.write_text(walls(), encoding="utf-8")
    drawn = {
        key: Estimate(key=key, value=value, unit="times", fisher=0.01, bootstrap=0.01) for key, value in truth.items()
    }
    text, notes = scaled_text(unit.read_text(encoding="utf-8"), drawn, "drawn", "unit.toml")
    assert not notes
    (folder / "truth.toml").write_text(text, encoding="utf-8")
    return path, load_sensor(str(folder / "truth.toml"))


def record(path: Path, scene: Path, sensor: Sensor, core: Any, osf: Any, *, seed: int = 0) -> Path:
    """Render a frame and write it as the maker's library does, with what lost pulses have of background."""
    pulses: list[Any] = []
    ambient = np.full(sensor.scanner.pulses, np.nan)
    cloud = Simulator(load_scene(scene), sensor).render(
        seed=seed,
        points=lambda pulse, _: pulses.append(pulse),
        ambient=lambda pulse, counts: ambient.__setitem__(np.asarray(pulse, int), counts),
    )
    columns = {name: np.zeros(sensor.scanner.pulses) for name in ("range_m", "signal")}
    for name, values in columns.items():
        values[np.concatenate(pulses).astype(int)] = getattr(cloud, name)
    info = core.SensorInfo(OUSTER.with_suffix(".json").read_text())
    frame = core.LidarFrame(info)
    frame.status[COLUMNS] = 1
    frame.timestamp[:] = 10**9 + np.arange(1024) * 97_656
    frame.measurement_id[:] = np.arange(1024)
    numbers = _numbers(path.with_name("empty.osf"), frame, info, sensor, osf)
    # The maker counts the range from behind the exit.
    behind_m = 1e-3 * float(info.lidar_origin_to_beam_origin_mm)
    range_m = np.where(columns["range_m"] > 0.0, columns["range_m"] + behind_m, 0.0)
    frame.field("RANGE")[:] = np.rint(1e3 * range_m[numbers])
    frame.field("SIGNAL")[:] = np.rint(columns["signal"][numbers])
    frame.field("NEAR_IR")[:] = np.rint(ambient[numbers])
    _write(path, frame, info, osf)
    return path


def _numbers(path: Path, frame: Any, info: Any, sensor: Sensor, osf: Any) -> np.ndarray:
    """Pulse of each pixel."""
    _write(path, frame, info, osf)
    with open_recording(path) as recording:
        return match_pulses(sensor, recording[0])[0]


def _write(path: Path, frame: Any, info: Any, osf: Any) -> None:
    writer = osf.Writer(str(path), info)
    writer.save(0, frame)
    writer.close()
