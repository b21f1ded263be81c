"""Page of a twin beside its recording: the table of `judge`, pictures of both clouds, and the table as JSON."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from ...cloud.point_cloud import PointCloud
from ...figures.pictures import common_scale, perspective_picture
from ...figures.report import PAGE, Report
from ...recordings.as_cloud import cloud_of
from ...recordings.recording import Recording
from ...rendering.render_options import FrameOptions
from ...scene.scene import View
from ...scene.scene_file import load_scene
from ...sensor.sensor_file import load_sensor
from ..held import held_data, held_table, passed, verdict
from .judge import disagreement, twin_quantities
from .matched_pulses import simulate_pulses
from .planes import select_columns
from .sensor_grid import on_grid
from .twin_files import COLUMNS, frame_pose, read_provenance

NUMBERS = "twin.json"
REAL, SIMULATED = "recorded", "simulated"
"""Names of the two pictures."""

_VIEW = View(eye_m=(-9.0, 0.0, 6.0), target_m=(6.0, 0.0, 0.0), fov_deg=70.0)
"""View of the pictures, from behind and above the sensor."""


def compare_twin(
    scene_file: Path, recording: Recording, *, frame: int | None = None, options: FrameOptions | None = None
) -> Report:
    """Render a twin at a frame's pose and compare it with that frame of the recording.

    Args:
        frame: index of the frame; None: the held-out one, or the first
        options: seed and chunk of the rendering

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    provenance = read_provenance(scene_file)
    number = provenance["judged"] if frame is None else frame
    pose = frame_pose(provenance, number, scene_file)
    scene = load_scene(scene_file)
    sensor = load_sensor(scene.sensor_name)
    next_number = (number + 1) % len(recording)
    full_sweep, next_sweep = (on_grid(recording[index], sensor.scanner) for index in (number, next_number))
    sweep, other_columns = full_sweep, None
    if provenance["held_out"] == COLUMNS:
        sweep, other_columns = (select_columns(full_sweep, slice(first, None, 2)) for first in (1, 0))
    pulses, cloud = simulate_pulses(scene, sensor, sweep, pose=pose, options=options)
    real_disagreement = disagreement(full_sweep, next_sweep) if next_number != number else None
    quantities = twin_quantities(
        pulses,
        sweep,
        cloud,
        between=real_disagreement,
        other_columns=other_columns,
        is_of_frame=other_columns is None and number in provenance["frames"],
    )
    rows = [row for row in quantities if row.is_shown]
    numbers: dict[str, Any] = {
        "verdict": verdict(rows, "The twin"),
        "recording": recording.path.name,
        "frame": number,
        "twin": provenance,
        "seen": held_out_note(provenance, number),
        "rows": [row.as_dict(reference="real") for row in rows],
    }
    report = Report(
        f"{numbers['recording']}, frame {number}, and its twin",
        numbers=numbers,
        main_table=held_data(rows, reference="real"),
        passed=passed(rows),
        pages=(PAGE, NUMBERS),
    )
    report.add_paragraph(numbers["verdict"])
    report.add_table(*held_table(rows, reference="real"))
    report.add_paragraph(numbers["seen"])
    report.summary = report.as_text()
    report.add_paragraph(_NOTE)
    clouds = {REAL: cloud_of(full_sweep), SIMULATED: cloud.in_sensor_frame()}
    scale = common_scale(list(clouds.values()), "range")
    captions = {REAL: "Recorded, by range.", SIMULATED: "Simulated in the twin, by range."}
    report.add_pictures(
        [(name, captions[name], partial(picture, shown, scale=scale)) for name, shown in clouds.items()]
    )
    return report


def held_out_note(provenance: dict[str, Any], number: int) -> str:
    """Sentence on whether the twin was made from the judged frame."""
    if provenance["held_out"] == COLUMNS:
        return "Judged by every second column; the twin is made of the others."
    if number in provenance["frames"]:
        return "The twin is made of this frame: surfaces and reflectivities are its own, only the sensor is judged."
    return f"Held out: the twin is made of frames {', '.join(map(str, provenance['frames']))}."


def picture(cloud: PointCloud, path: Path, *, scale: tuple[float, float]) -> None:
    """Draw a cloud in the sensor's frame, seen from behind and above the sensor.

    Raises:
        OutputError: if a result cannot be written
    """
    perspective_picture(
        cloud, path, colour_by="range", view=_VIEW, highlight_false_alarms=False, size_px=(1280, 720), scale=scale
    )


_NOTE = (
    "The recorded pulses beside the same pulses of the simulation. The value is a difference in the unit of the "
    "quantity, a ratio (scatter), a relative difference (points, signals, ground) or a share. Ranges count from the "
    "beam's exit. Nearer than recorded is nearer than the pixel, its neighbour on that side and its plane. Range bias "
    "is that of smooth surfaces; scatter is that of second differences along the ring there, on both sides. "
    "The double validation metric is the "
    "difference of the means (bias) and the area between both distributions without it (scatter). Losses on surfaces "
    "are lost pulses that meet a surface of the twin; those with a reflectivity and without a range are left out and "
    "counted by themselves."
)
