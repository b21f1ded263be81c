"""Certificate of a sensor: a recording beside its simulation, pulse by pulse, a verdict, and what is not covered."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...cloud.shades import FixedColours
from ...figures.pictures import common_scale, perspective_picture
from ...figures.report import PAGE, Report, Table
from ...files.optional import is_installed
from ...maths.arrays import Numbers, map_arrays
from ...recordings.as_cloud import cloud_of
from ...recordings.recording import Recording
from ...recordings.sweep import Sweep
from ...rendering.render_options import FrameOptions
from ...scan.base import Scanner
from ...scan.spinning import Spinning
from ...scene.scene import View
from ...scene.scene_file import load_scene
from ...sensor.sensor_file import load_sensor
from ...sensor.sensor_model import Sensor
from ..held import LIMITS, UNLIMITED, Held, held_data, held_table, passed, verdict
from .frame_poses import is_at_rest
from .judge import disagreement, losses_kept, twin_quantities
from .matched_pulses import MatchedPulses, match_pulses, simulate_pulses, strength_of
from .planes import has_grid, select_columns
from .repeats import Repeats, kept_at_rest
from .sensor_grid import on_grid, rows_of
from .side_figures import REAL, SIMULATED, side_figures
from .surfels import SMOOTH
from .told_apart import EXTRA, PATCH, Image, ToldApart, told_apart
from .tuning import WHOLE_FRAME
from .twin_files import COLUMNS, SCENE, TwinFrames, build_twin, frame_pose, read_provenance

NUMBERS = "certificate.json"
MOST_FRAMES = 4
"""Choice: frames of a sensor at rest that are judged together; 4 tell a scatter of 200 pixels to 3 %."""

ON_SMOOTH = "told apart on smooth surfaces"
"""Row of the classifier that is held to a limit."""

_VIEW = View(eye_m=(-9.0, 0.0, 6.0), target_m=(6.0, 0.0, 0.0), fov_deg=70.0)
"""View of the pictures, from behind and above the sensor."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Judged:
    """Judged frames and their simulation.

    Attributes:
        full_sweep: first frame with all of its columns
        frames: matched pulses of each
        cloud: simulated cloud of the first
        scanner: that of the twin
        is_list: whether a list of points was recorded, which the grid was made of
        repeats: the same of a sensor at rest; None: it was not, or one frame was judged
        was_kept: (n,) mask of the pulses of all frames that returned in the frame the twin is made of, at rest
        control: two sides of recorded images that a classifier cannot tell apart; None: there are none
    """

    full_sweep: Sweep
    frames: Sequence[MatchedPulses]
    cloud: PointCloud
    scanner: Scanner
    is_list: bool
    repeats: Repeats | None = None
    was_kept: Numbers | None = None
    control: tuple[Sequence[Image], Sequence[Image]] | None = None

    @property
    def pulses(self) -> MatchedPulses:
        """Pulses of all frames."""
        return map_arrays(lambda *values: np.concatenate(values), *self.frames)


def certify_sensor(
    recording: Recording,
    sensor: str | None = None,
    *,
    frame: int | None = None,
    metadata: Path | None = None,
    sensor_index: int = 0,
    options: FrameOptions | None = None,
) -> Report:
    """Make a twin of a recording, which is not kept, and certify its sensor in it.

    The twin of a sensor at rest is made of the frame beside the judged one, else of every second column.

    Args:
        sensor: catalogue name or sensor file; None: the unit's own, by its maker's metadata
        frame: index of the judged frame; None: the second at rest, else the first
        metadata: the maker's description of the unit; None: the json beside the recording or in the OSF, if any
        sensor_index: which sensor of an OSF, from 0
        options: seed and chunk of the rendering

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    choice = _choose(recording, frame, sensor)
    with tempfile.TemporaryDirectory() as folder:
        build_twin(recording, choice, Path(folder), metadata=metadata, sensor=sensor, sensor_index=sensor_index)
        return certify_in_twin(Path(folder) / SCENE, recording, name=sensor, options=options)


def _choose(recording: Recording, frame: int | None, sensor: str | None) -> TwinFrames:
    """Frames of the twin and the judged one."""
    number = min(1, len(recording) - 1) if frame is None else frame
    sweeps = {number: recording[number]}
    sweeps |= {index: recording[index] for index in (number - 1, number + 1) if 0 <= index < len(recording)}
    if sensor is not None:
        scanner = load_sensor(sensor).scanner
        sweeps = {index: on_grid(sweep, scanner) for index, sweep in sweeps.items()}
    at_rest = [index for index in sweeps if index != number and is_at_rest(sweeps[index], sweeps[number])]
    if at_rest:
        fullest = max(at_rest, key=lambda index: int(sweeps[index].recorded.sum()))
        return TwinFrames(frames=(fullest,), held_out=number)
    return TwinFrames(frames=(0 if frame is None else frame,), held_out=COLUMNS)


def certify_in_twin(
    scene_file: Path,
    recording: Recording,
    sensor: Sensor | None = None,
    *,
    frame: int | None = None,
    name: str | None = None,
    options: FrameOptions | None = None,
) -> Report:
    """Render a twin at a frame's pose and hold the simulation to that frame of the recording.

    Args:
        sensor: sensor in place of the twin's
        frame: index of the frame; None: the held-out one, or the first
        name: name of the sensor on the page; None: that of its file
        options: seed and chunk of the rendering

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    provenance = read_provenance(scene_file)
    number = provenance["judged"] if frame is None else frame
    judged, rows = judge_in_twin(scene_file, recording, sensor, frame=frame, options=options)
    accuracies = _told_apart(judged)
    rows += [*_elevations(judged, name), *_accuracy_rows(accuracies)]
    shown = [row for row in rows if row.is_shown]
    title = f"{recording.path.name}, frame {number}: is it {name or judged.cloud.metadata['sensor']}?"
    meets = passed(shown) and any(row.verdict for row in shown)
    numbers: dict[str, Any] = {
        "verdict": f"{'Pass' if meets else 'Fail'}: {verdict(shown, 'the simulated sensor')}",
        "passed": meets,
        "recording": recording.path.name,
        "frame": number,
        "frames_judged": len(judged.frames),
        "twin": provenance,
        "seen": held_out_note(provenance, number),
        "rows": [row.as_dict(reference="real", note="note") | {"source": row.limits.source} for row in shown],
        "not_measured": [row.quantity for row in shown if row.is_limited and row.value is None],
        "not_covered": dict(_not_covered(judged, provenance)),
    }
    report = Report(
        title,
        numbers=numbers,
        main_table=held_data(shown, reference="real"),
        passed=meets,
        pages=(PAGE, NUMBERS),
        columns=True,
    )
    report.add_paragraph(numbers["verdict"])
    report.add_paragraph(numbers["seen"])
    report.add_table(*held_table([row for row in shown if row.is_limited], reference="real"))
    report.summary = report.as_text()
    report.add_heading("Measured without a limit")
    report.add_table(*held_table([row for row in shown if not row.is_limited], reference="real"))
    report.add_paragraph(_NOTE)
    report.add_heading("Losses and noise")
    for figure in side_figures(judged.pulses, judged.repeats, judged.was_kept):
        report.add_figure(figure)
    clouds = {REAL: cloud_of(judged.full_sweep), SIMULATED: judged.cloud.in_sensor_frame()}
    draw = partial(
        perspective_picture,
        colour_by="range",
        view=_VIEW,
        highlight_false_alarms=False,
        size_px=(1280, 720),
        colours=FixedColours(limits=common_scale(list(clouds.values()), "range")),
    )
    captions = {REAL: "Recorded, by range.", SIMULATED: "Simulated in the twin, by range."}
    report.add_pictures([(side, captions[side], partial(draw, cloud)) for side, cloud in clouds.items()])
    report.add_heading("Not covered")
    report.add_table(("what", "since"), list(numbers["not_covered"].items()))
    report.add_heading("Where the limits come from")
    report.add_table(*_sources(shown))
    return report


def judge_in_twin(
    scene_file: Path,
    recording: Recording,
    sensor: Sensor | None = None,
    *,
    frame: int | None = None,
    options: FrameOptions | None = None,
) -> tuple[_Judged, list[Held]]:
    """Simulate the judged frames in a twin, and compare; returns both sides and the rows.

    Arguments as of `certify_in_twin`.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    provenance, scene, options = read_provenance(scene_file), load_scene(scene_file), options or FrameOptions()
    number = provenance["judged"] if frame is None else frame
    pose = frame_pose(provenance, number, scene_file)
    sensor = sensor or load_sensor(scene.sensor_name)
    scanner = sensor.scanner

    def read(index: int) -> Sweep:
        return on_grid(recording[index], scanner)

    recorded_sweep, next_number = recording[number], (number + 1) % len(recording)
    full_sweep = on_grid(recorded_sweep, scanner)
    sweeps, other_columns, twin_sweep = [full_sweep], None, None
    if provenance["held_out"] == COLUMNS:
        sweeps[0], other_columns = (select_columns(full_sweep, slice(first, None, 2)) for first in (1, 0))
    elif number not in provenance["frames"]:
        twin_sweep = read(provenance["frames"][0])
        twin_sweep = twin_sweep if is_at_rest(twin_sweep, full_sweep) else None
    if twin_sweep is not None:
        numbers = (*range(number + 1, len(recording)), *range(number - 1, -1, -1))
        others = (index for index in numbers if index not in provenance["frames"])
        whole = WHOLE_FRAME * full_sweep.recorded.sum()
        at_rest = itertools.takewhile(lambda sweep: is_at_rest(sweep, full_sweep), map(read, others))
        sweeps += itertools.islice((sweep for sweep in at_rest if sweep.recorded.sum() >= whole), MOST_FRAMES - 1)
        recorded = np.logical_and.reduce([sweep.recorded for sweep in (twin_sweep, *sweeps)])
        sweeps = [
            replace(sweep, recorded=recorded, range_m=np.where(recorded, sweep.range_m, np.nan)) for sweep in sweeps
        ]
    simulated = [
        simulate_pulses(scene, sensor, sweep, pose=pose, options=replace(options, seed=options.seed + index))
        for index, sweep in enumerate(sweeps)
    ]
    frames, cloud = [pulses for pulses, _ in simulated], simulated[0][1]
    rows = twin_quantities(
        frames[0],
        between=None if next_number == number else disagreement(full_sweep, read(next_number)),
        again=None if other_columns is None else _beside(frames[0], other_columns),
        source=twin_sweep if other_columns is None else other_columns,
        is_of_frame=other_columns is None and number in provenance["frames"],
    )
    judged = _Judged(
        full_sweep=full_sweep, frames=frames, cloud=cloud, scanner=scanner, is_list=not has_grid(recorded_sweep)
    )
    if other_columns is not None:
        return replace(judged, control=([_image(sweeps[0])], [_image(other_columns)])), rows
    if twin_sweep is None:
        return judged, rows
    images = [_image(sweep) for sweep in (twin_sweep, *sweeps)]
    judged = replace(judged, control=(images[::2], images[1::2]))
    if len(sweeps) == 1:
        return judged, rows
    repeats = Repeats.from_frames(frames, scanner.pulses)
    returned = np.zeros(scanner.pulses, bool)
    returned[match_pulses(sensor, twin_sweep)[0][twin_sweep.has_return]] = True
    pulses = judged.pulses
    was_kept, losses = returned[pulses.pulse], losses_kept(pulses, repeats.kept_again(pulses))
    # A pixel beside itself tells its noise; along a ring surfaces that are not smooth enter.
    rows = [row for row in rows if row.quantity not in {"range, scatter", losses.quantity}]
    rows += [losses, kept_at_rest(pulses, was_kept), *repeats.quantities()]
    return replace(judged, repeats=repeats, was_kept=was_kept), rows


def _beside(pulses: MatchedPulses, other_columns: Sweep) -> Numbers:
    """(n,) recorded share of each pulse's two neighbours among the other columns that returns."""
    column = (pulses.column + np.array([[0], [1]])) % other_columns.shape[1]
    return np.asarray(other_columns.has_return[pulses.ring, column].mean(axis=0))


def _image(sweep: Sweep) -> Image:
    return Image(sweep.range_m, strength_of(sweep))


def _images(frames: Sequence[MatchedPulses], side: str, *, smooth_only: bool) -> list[Image]:
    """Range images of one side, "" or "simulated_"; of all pulses, or of those that met a smooth surface."""

    def image(frame: MatchedPulses, name: str) -> Any:
        values = getattr(frame, f"{side}{name}")
        if values is None:
            return None
        pixels = np.full((frame.ring.max() + 1, frame.column.max() + 1), np.nan)
        pixels[frame.ring, frame.column] = np.where(smooth_only & (frame.kind != SMOOTH), np.nan, values)
        return pixels

    return [Image(image(frame, "range_m"), image(frame, "strength")) for frame in frames]


def _told_apart(judged: _Judged) -> dict[str, tuple[ToldApart, ToldApart | None]]:
    """Accuracy by group of features, of both sides and of two recorded ones; empty where it is not measured."""
    if not is_installed("sklearn"):
        return {}
    accuracies, smooth = (
        told_apart(*(_images(judged.frames, side, smooth_only=only) for side in ("", "simulated_")))
        for only in (False, True)
    )
    controls = told_apart(*judged.control) if judged.control is not None else {}
    every = accuracies | ({ON_SMOOTH: smooth["all"]} if smooth else {})
    return {name: (accuracy, controls.get(name)) for name, accuracy in every.items()}


def _accuracy_rows(accuracies: dict[str, tuple[ToldApart, ToldApart | None]]) -> Iterator[Held]:
    if ON_SMOOTH not in accuracies:
        lacks = f"pip install 'lidarscene[{EXTRA}]'" if not is_installed("sklearn") else "too few pulses"
        yield Held(quantity=ON_SMOOTH, limits=LIMITS["told apart"], note=lacks)
    names = {"all": "told apart by a classifier", ON_SMOOTH: ON_SMOOTH}
    for name, (accuracy, control) in accuracies.items():
        yield Held(
            quantity=names.get(name, f"told apart by {name} alone"),
            condition=f"{accuracy.patches} patches of {PATCH[0]} x {PATCH[1]}" if name in names else "",
            reference=None if control is None else control.accuracy,
            value=accuracy.accuracy,
            limits=LIMITS["told apart"] if name == ON_SMOOTH else UNLIMITED,
            note=f"+/- {accuracy.sigma:.2g}",
        )


def _elevations(judged: _Judged, name: str | None) -> Iterator[Held]:
    """Elevations of the named sensor beside those that a list of points has, which its twin takes over."""
    scanner = None if name is None else load_sensor(name).scanner
    if judged.is_list and isinstance(scanner, Spinning) and isinstance(judged.scanner, Spinning):
        off_rad = rows_of(judged.scanner).elevation_rad - rows_of(scanner).elevation_rad
        yield Held(
            quantity="elevations",
            condition="rms, from the sensor's file",
            value=float(np.degrees(np.sqrt(np.mean(off_rad**2)))),
            limits=LIMITS["elevations"],
            unit="deg",
        )


def held_out_note(provenance: dict[str, Any], number: int) -> str:
    """Sentence on whether the twin was made from the judged frame."""
    if provenance["held_out"] == COLUMNS:
        return "Judged by every second column; the twin is made of the others."
    if number in provenance["frames"]:
        return "The twin is made of this frame: surfaces and reflectivities are its own, only the sensor is judged."
    return f"Held out: the twin is made of frames {', '.join(map(str, provenance['frames']))}."


def _not_covered(judged: _Judged, provenance: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """What the certificate says nothing of, and why."""
    sweep = judged.full_sweep
    range_m = sweep.range_m[sweep.has_return]
    near_m, far_m = np.percentile(range_m, (0.1, 99.9)) if len(range_m) else (0.0, 0.0)
    yield f"ranges below {near_m:.3g} m and above {far_m:.3g} m", "none were recorded"
    yield "power, aperture and scale of reflectivity", str(provenance["reflectivity"])
    if judged.repeats is None:
        yield "noise and losses of one pixel", "they take three frames or more of a sensor at rest"
    if sweep.signal is None:
        yield "photons", "SIGNAL is not recorded"
    if sweep.second is None:
        yield "second returns", "none are recorded"
    if provenance["illuminance_assumed"]:
        light = f"NEAR_IR is not recorded, {provenance['illuminance_klux']:.3g} klux are assumed"
        yield "background light", light
    if judged.is_list or not sweep.includes_lost:
        yield "directions of lost pulses", "they are not recorded"
    yield "other light and weather", "one recording has one: sun, fog, rain and snow follow from the equations alone"
    yield "motion", "bodies and sensor stand still in a twin"
    yield "other units, temperatures and ages", "one unit was recorded, once"
    yield "other lidars", "interference is not in a recording that does not name it"


def _sources(rows: Sequence[Held]) -> Table:
    """Limits and their sources, each once."""
    limited = {(row.quantity, str(row.limits), row.limits.source): None for row in rows if row.is_limited}
    return ("quantity", "limit", "source"), list(limited)


_NOTE = (
    "The recorded pulses beside the same pulses of the simulation. The value is a difference in the unit of the "
    "quantity, a ratio (scatter, pixels at rest), a relative difference (points, signals, ground) or a share. Ranges "
    "count from the beam's exit. Nearer than recorded is nearer than the pixel, its neighbour on that side and its "
    "plane. Range bias is that of smooth surfaces; scatter is that of second differences along the ring there, or, of "
    "a sensor at rest, of a pixel from frame to frame, on both sides. "
    "The double validation metric is the "
    "difference of the means (bias) and the area between both distributions without it (scatter). Losses on smooth "
    "surfaces are lost pulses that meet one in the twin, beside those of the same pulses in other turns or of their "
    "neighbours in the row; those with a reflectivity and without a range are left out and "
    "counted by themselves. Told apart is the balanced accuracy of trees that learn from patches of both range images "
    "and judge sectors that they have not seen; 0.5 is chance, and real is that of two recorded sides. On smooth "
    "surfaces only the sensor can tell; leaves and edges are finer than the twin's quads, whatever the sensor."
)
