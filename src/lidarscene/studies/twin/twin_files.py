"""Files of a twin: meshes with reflectivities, sensor, poses, scene, and a record of what they were made from.

The world's axes are the sensor's at the first frame of the twin.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...catalog import sensor_path
from ...errors import InputError, OptionError
from ...figures.report import count_text
from ...files.atomic import atomic_folder, put_text, require_writable
from ...files.json_text import json_text
from ...files.toml import validate
from ...files.toml_edit import put_values
from ...formats.ply import write_columns
from ...maths.arrays import Numbers
from ...maths.pose import Pose
from ...recordings.pcap_reader import metadata_of
from ...recordings.recording import Recording
from ...recordings.sweep import Sweep
from ...recordings.units.ouster_unit import FIRST_CALIBRATED, firmware_version
from ...recordings.units.unit_file import read_unit, with_second_returns, write_unit
from ...scan.spinning import Spinning
from ...scene.tables import SceneFile
from ...sensor.pose_file import angles_deg, to_pose
from ...sensor.sensor_file import load_sensor
from ..held import LIMITS
from .apparent_reflectivity import ReflectivityGauge, is_explained
from .daylight import illuminance_klux
from .frame_poses import place_frames
from .ground import ground_plane
from .matched_pulses import RAYS
from .planes import align_columns, has_grid, select_columns
from .recorded_beams import with_recorded_beams
from .sensor_grid import grid_of, on_grid
from .surfels import BRIGHT, KINDS, Surfels, join_surfels, surfels_of_grid
from .tuning import (
    ASSUMED_KLUX,
    ASSUMED_MEDIAN,
    BORDER,
    BRIGHT_DIFFUSE,
    BRIGHT_STEP,
    BRIGHTEST_KLUX,
    LEAST_RETRO,
    MOST_RETRO,
    RETRO_HALF_ANGLE_DEG,
    SLOPE_DEG,
)

SCENE, SENSOR, POSES, PROVENANCE, MESHES = "scene.toml", "sensor.toml", "poses.csv", "twin.json", "meshes"

COLUMNS = "columns"
"""Value of ``held_out`` for every second column of the only frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinFrames:
    """Frames that build the twin, and the data held out.

    Attributes:
        frames: indices of the frames
        held_out: index of the frame that is not used, `COLUMNS`, or None
    """

    frames: tuple[int, ...]
    held_out: int | str | None = None

    @property
    def judged_frame(self) -> int:
        """Index of the frame that judges the twin, at whose pose the scene's sensor stands."""
        return self.held_out if isinstance(self.held_out, int) else self.frames[0]

    def visible_part(self, sweep: Sweep) -> Sweep:
        """Select the columns of a sweep that build the twin."""
        return select_columns(sweep, slice(0, None, 2)) if self.held_out == COLUMNS else sweep


def choose_frames(recording: Recording, frames: Sequence[int] | None, held_out: int | str | None) -> TwinFrames:
    """Choose the frames that build the twin: ``frames``, or all if None, less the held-out one.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    numbers = tuple(frames) if frames is not None else tuple(range(len(recording)))
    for number in (*numbers, *([held_out] if isinstance(held_out, int) else [])):
        if number >= len(recording):
            raise InputError(f"{recording.path}: frame must be 0 to {len(recording) - 1}, got {number}")
    remaining = tuple(number for number in numbers if number != held_out)
    if not remaining:
        must = "must leave a frame to make the twin of, got a recording of {1}"
        raise OptionError(
            f"{{held_out}} {{0}}: {must}; {{held_out}} {{2}} leaves out every second column",
            held_out,
            len(recording),
            COLUMNS,
        )
    if held_out == COLUMNS and len(remaining) > 1:
        raise OptionError("{held_out} {0}: needs a single frame, got {1} frames", COLUMNS, len(remaining))
    return TwinFrames(frames=remaining, held_out=held_out)


def build_twin(
    recording: Recording,
    choice: TwinFrames,
    folder: Path,
    *,
    metadata: Path | None = None,
    sensor: str | None = None,
    sensor_index: int = 0,
) -> str:
    """Write the files of a twin, all of them or none; returns the text to print.

    Args:
        metadata: the maker's description of the unit, for its sensor file; None: json beside a pcap, or in the OSF
        sensor: catalogue name or sensor file to use instead of the unit's own
        sensor_index: which sensor of an OSF, from 0

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    require_writable(folder / SCENE)
    with atomic_folder(folder) as temporary:
        text = _write_twin(recording, choice, temporary, metadata, sensor, sensor_index)
        return text.replace(str(temporary), str(folder))


def _write_twin(
    recording: Recording, choice: TwinFrames, folder: Path, metadata: Path | None, sensor: str | None, sensor_index: int
) -> str:
    """Write the files of a twin, one after the other; the arguments and the result are those of `build_twin`."""
    sweeps = {number: recording[number] for number in {*choice.frames, choice.judged_frame}}
    if not any(sweeps[number].has_return.any() for number in choice.frames):
        raise InputError(f"{recording.path}: the frames of a twin must have returns, got none")
    if sensor is None:
        notes = [_unit_file(recording, folder / SENSOR, metadata, sensor_index)]
    else:
        notes = [_copy_sensor(sensor, folder / SENSOR, sweeps[choice.judged_frame], recording.path.name)]
    unit = load_sensor(str(folder / SENSOR))
    if sweeps[choice.judged_frame].second is not None:
        if unit.tdc.stops == 1:
            put_text(folder / SENSOR, with_second_returns((folder / SENSOR).read_text(encoding="utf-8")))
            unit = load_sensor(str(folder / SENSOR))
        notes.append(f"second returns take several rays of a pulse: lidarscene render {folder / SCENE} --rays {RAYS}")
    sweeps = {number: on_grid(sweep, unit.scanner) for number, sweep in sweeps.items()}
    places = place_frames(sweeps, choice.frames[0])
    parts, klux, border = [], [], BORDER if choice.held_out == COLUMNS else 0.0
    for number in choice.frames:
        sweep = choice.visible_part(sweeps[number])
        gauge = ReflectivityGauge.from_sweep(sweep, unit)
        sweep = replace(sweep, recorded=sweep.recorded & is_explained(sweep, unit))
        plane = ground_plane(sweep.xyz_m[sweep.has_return])
        parts.append(surfels_of_grid(align_columns(sweep), gauge, plane, border, unit).placed(places[number]))
        klux.append(illuminance_klux(sweep, gauge, unit))
    if gauge is not None and gauge.white_value is not None and unit.intensity is not None:
        text = put_values(
            (folder / SENSOR).read_text(encoding="utf-8"),
            {
                ("intensity", "white_value"): gauge.white_value,
                (
                    "sources",
                    "intensity.white_value",
                ): f"assumed: {recording.path.name} has a median of {ASSUMED_MEDIAN:g}",
            },
        )
        put_text(folder / SENSOR, text)
    quads = join_surfels(parts)
    bodies = _meshes(quads, folder / MESHES)
    _poses_file(folder / POSES, sweeps, places)
    recorded_klux = [value for value in klux if value is not None]
    median_klux = float(np.median(recorded_klux)) if recorded_klux else ASSUMED_KLUX
    text = scene_text(recording.path.stem, bodies, places[choice.judged_frame], median_klux)
    # Nothing is written that `load_scene` would refuse, such as a number that is not finite.
    validate(SceneFile, tomllib.loads(text), SCENE)
    put_text(folder / SCENE, text)
    provenance = {
        "recording": recording.path.name,
        "frames": list(choice.frames),
        "held_out": choice.held_out,
        "judged": choice.judged_frame,
        "illuminance_klux": median_klux,
        "illuminance_assumed": not recorded_klux,
        "quads": {name: int(n) for name, n in zip(KINDS, np.bincount(quads.kind, minlength=len(KINDS)), strict=True)},
        "reflectivity": _reflectivity_note(gauge),
        "places": {str(number): [*place.position_m.tolist(), *angles_deg(place)] for number, place in places.items()},
    }
    put_text(folder / PROVENANCE, json_text(provenance, indent=1) + "\n")
    notes.append(
        f"wrote {folder / SCENE}: {len(quads)} quads of {count_text(len(choice.frames), 'frame')}, "
        f"{median_klux:.3g} klux"
    )
    if median_klux > 1.005 * BRIGHTEST_KLUX:  # a fitted file reaches it by rounding
        notes.append(
            f"{median_klux:.3g} klux is more than the sun gives ({BRIGHTEST_KLUX:g} at most): the sensor file counts "
            f"{median_klux / BRIGHTEST_KLUX:.2g} times too little background or more (PDE, filter, window of NEAR_IR)"
        )
    firmware = firmware_version(recording.metadata.get("firmware", ""))
    if firmware is not None and firmware < FIRST_CALIBRATED:
        notes.append(
            f"firmware {'.'.join(map(str, firmware))} does not calibrate REFLECTIVITY, as it does from "
            f"{'.'.join(map(str, FIRST_CALIBRATED))} on: the scale of the reflectivities is not known"
        )
    return "\n".join([*notes, _reflectivity_note(gauge)])


def _reflectivity_note(gauge: ReflectivityGauge | None) -> str:
    if gauge is None:
        return "reflectivities: not recorded, so all are 0.2"
    guess = ", scaled to a median of 0.2, since its unit is not known" if gauge.assumed else ""
    scale = ", over the photons that the sensor file has of a white target" if gauge.by_sensor else guess
    note = f"reflectivities: by the recording's {gauge.field}{scale}"
    if LIMITS["signal ratio"].include(gauge.over_recorded):
        return note
    return f"{note}, {gauge.over_recorded:.2g} times the recorded: fit finds the unit's photons"


def _copy_sensor(sensor: str, path: Path, sweep: Sweep, recording: str) -> str:
    """Copy a catalogue sensor or a sensor file, with the beams of a list of points; returns the text to print."""
    source = sensor_path(sensor)
    if not source.is_file():
        raise OptionError("{sensor} {0}: no such file", sensor)
    scanner, text, note = load_sensor(str(source)).scanner, source.read_text(encoding="utf-8"), ""
    if has_grid(sweep):
        on_grid(sweep, scanner)  # refuses too few channels
    elif isinstance(scanner, Spinning):
        text, note = with_recorded_beams(text, grid_of(sweep, scanner), recording)
    put_text(path, text)
    return f"wrote {path}: as {sensor}" + (f"; {note}" if note else "")


def _unit_file(recording: Recording, path: Path, metadata: Path | None, sensor_index: int) -> str:
    """Write the unit's own sensor file; returns the text to print."""
    described = metadata_of(recording.path, metadata)
    if described is None or not described.is_file():
        must = "must have the unit's metadata as {metadata} F, or a catalogue sensor as {sensor} NAME"
        raise OptionError(f"{{0}}: {must}", recording.path)
    return write_unit(read_unit(described, sensor_index=sensor_index), described, path)


def _meshes(quads: Surfels, folder: Path) -> list[tuple[str, str, float | None]]:
    """Write a mesh for each kind; returns the name, kind and, if bright, apparent reflectivity of each body."""
    bodies: list[tuple[str, str, float | None]] = []
    for kind, name in enumerate(KINDS):
        mask = quads.kind == kind
        if not mask.any():
            continue
        if kind != BRIGHT:
            _mesh(folder / f"{name}.ply", quads.corners_m[mask], quads.reflectivity[mask])
            bodies.append((name, name, None))
            continue
        levels = np.rint(np.log(quads.reflectivity[mask]) / math.log(BRIGHT_STEP)).astype(int)
        for level in np.unique(levels):
            body = f"{name}{level - levels.min()}"
            of_level = levels == level
            _mesh(folder / f"{body}.ply", quads.corners_m[mask][of_level], None)
            bodies.append((body, name, float(np.median(quads.reflectivity[mask][of_level]))))
    return bodies


def _mesh(path: Path, corners_m: Numbers, reflectivity: Numbers | None) -> None:
    """Write a binary PLY of quads as two triangles each, with the reflectivity of their corners."""
    columns = dict(zip("xyz", corners_m.reshape(-1, 3).T, strict=True))
    strength = np.zeros(len(corners_m)) if reflectivity is None else reflectivity
    columns["reflectivity"] = np.repeat(strength, 4).astype(np.float32)
    faces = (4 * np.arange(len(corners_m))[:, None] + [0, 1, 2, 0, 2, 3]).reshape(-1, 3)
    write_columns(path, columns, comments=("lidarscene twin",), faces=faces)


def scene_text(name: str, bodies: Sequence[tuple[str, str, float | None]], pose: Pose, klux: float) -> str:
    """Text of the scene file."""
    yaw, pitch, roll = angles_deg(pose)
    place = ", ".join(f"{x:.6f}" for x in pose.position_m)
    lines = [
        f'name = "{_plain_text(name)}"',
        'description = "Twin of a recording, by lidarscene twin"',
        "",
        "# Where the sun stood is not recorded: its light comes from all of the sky.",
        "[sun]",
        "elevation_deg = -90.0",
        f"illuminance_klux = {klux:.6g}",
        "",
        "[sky]",
        "diffuse_share = 1.0",
        "",
        "[sensor]",
        f'name = "{SENSOR}"',
        f"position_m = [{place}]",
        f"yaw_deg = {yaw:.6f}",
        f"pitch_deg = {pitch:.6f}",
        f"roll_deg = {roll:.6f}",
        "",
        "# Reflectivities are those of the meshes.",
        "[materials.measured]",
        'bsdf = "diffuse"',
        "reflectivity = 0.2",
        f"facet_slope_deg = {SLOPE_DEG:g}",
        "",
    ]
    for body, _, apparent in bodies:
        if apparent is not None:
            retro = min(max((apparent - BRIGHT_DIFFUSE) / math.pi, LEAST_RETRO), MOST_RETRO)
            lines += [
                f"[materials.{body}]",
                'bsdf = "retroreflector"',
                f"reflectivity = {BRIGHT_DIFFUSE}",
                f"retro_coefficient_cd_per_lx_m2 = {retro:.6g}",
                f"retro_half_angle_deg = {RETRO_HALF_ANGLE_DEG:g}",
                "",
            ]
    for body, kind, apparent in bodies:
        lines += ["[[bodies]]", f'name = "{body}"', f'class = "{kind}"', f'mesh = "{MESHES}/{body}.ply"']
        lines += (
            ['material = "measured"', 'pattern = "reflectivity"', ""]
            if apparent is None
            else [f'material = "{body}"', ""]
        )
    return "\n".join(lines)


def _plain_text(text: str) -> str:
    return re.sub(r'["\\\x00-\x1f]', " ", text)


def _poses_file(path: Path, sweeps: dict[int, Sweep], places: dict[int, Pose]) -> None:
    """Write time and pose of each frame, as scene files take them; nothing for one frame or frames without times."""
    times_s = [sweeps[number].start_s for number in sorted(sweeps)]
    if len(times_s) < 2 or min(np.diff(times_s)) <= 0.0:
        return
    start_s = times_s[0]
    rows = ["time_s,x_m,y_m,z_m,yaw_deg,pitch_deg,roll_deg"]
    for number in sorted(sweeps):
        numbers = (sweeps[number].start_s - start_s, *places[number].position_m, *angles_deg(places[number]))
        rows.append(",".join(f"{float(x):.9g}" for x in numbers))
    put_text(path, "\n".join(rows) + "\n")


def read_provenance(scene: Path) -> dict[str, Any]:
    """Read what a twin was made from, by its scene file.

    Raises:
        InputError: if the scene is not a twin's
    """
    path = scene.parent / PROVENANCE
    if not path.is_file():
        raise InputError(f"{scene}: must be the scene of a twin, with {PROVENANCE} beside it, or a cloud")
    provenance: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return provenance


def frame_pose(provenance: dict[str, Any], number: int, scene: Path) -> Pose:
    """Pose of a frame of the twin.

    Raises:
        InputError: for other frames
    """
    pose = provenance["places"].get(str(number))
    if pose is None:
        raise OptionError(
            "{frame} {0}: must be one of {1}, the frames of {2}", number, ", ".join(provenance["places"]), scene
        )
    return to_pose(pose)
