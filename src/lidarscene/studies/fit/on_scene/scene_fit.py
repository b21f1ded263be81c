"""Fit of a recording with a scene: the twin of a recording, or any scene that the sensor is known to have stood in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ....errors import InputError, OptionError
from ....figures.report import Report, count_text
from ....maths.pose import Pose
from ....maths.special import SIGMA_PER_MAD
from ....maths.trajectory import pose_at
from ....recordings.opening import open_recording
from ....recordings.pcap_reader import metadata_of
from ....recordings.sweep import Sweep
from ....recordings.units.unit_file import with_second_returns
from ....scene.poses import read_poses
from ....scene.scene import Scene
from ....scene.scene_file import load_scene
from ....sensor.sensor_model import Sensor
from ...held import Held, verdict
from ...twin.judge import twin_quantities
from ...twin.matched_pulses import MatchedPulses, simulate_pulses
from ...twin.planes import select_columns
from ...twin.side_figures import side_figures
from ...twin.twin_files import COLUMNS, PROVENANCE, frame_pose, read_provenance
from ..estimates import MOST_EVALUATIONS
from ..fit_report import FITTED, FitReport
from ..sensor_text import base_text, parse_sensor, scaled_text
from ..tuning import LEAST_TEXTURE, REFLECTIVITY_SIGMA
from .known_scene import LEAST_FLOOR_M, PARAMETERS, predict
from .likelihood import ParameterFit, fit_parameters
from .pulses_on_scene import PulsesOnScene, lay_on_scene

Judged = tuple[MatchedPulses, Sequence[Held]]
"""Pulses of a rendered sensor beside the recorded ones, and the quantities that are held to limits."""

ROUNDS = 2
"""Rounds of a fit with a twin; texture and strangers follow from the round before."""

_TWIN_NOTE = (
    "the scene is a twin, whose light and scale of reflectivities are the recording's own: sun and dark counts are "
    "undetermined, and the power follows the scale of the maker's REFLECTIVITY"
)
_SEEN_NOTE = (
    "the twin is made of these frames and has their signals, so power and near field are not tested; make the twin "
    "with a frame or every second column held out"
)
_HELD_OUT_NOTE = "the fitted pulses were held out of the twin"

_OF_SCATTER = ("laser.pulse_fwhm_ns", "detector.jitter_ps", "scatter_floor")
_OF_THRESHOLD = tuple(name for name in PARAMETERS if name.startswith("histogram."))
LEFT_OUT: Mapping[str, tuple[str, ...]] = {
    "all parameters": (),
    "all but those of the scatter": _OF_SCATTER,
    "all but those of the threshold": _OF_THRESHOLD,
    "those of the photons": (*_OF_SCATTER, *_OF_THRESHOLD),
}
"""Parameters that are fitted -> those that then keep the file's values. The first fit is taken with which the file
misses no more limits than before."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneFit:
    """Result of a fit with a scene.

    Attributes:
        pulses: number of fitted pulses, and of those of every fourth block of columns, which were not
        evaluations: number of evaluations of the likelihood, over all rounds
        texture: as in `known_scene.KnownScene`, estimated along with the parameters
        strangers: as in `known_scene.KnownScene`, estimated along with the parameters
    """

    pulses: tuple[int, int]
    parameter_fit: ParameterFit
    evaluations: int
    texture: float
    strangers: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFitInputs:
    """Input files of a fit with a scene.

    Attributes:
        sensor: catalogue name or sensor file; None: the scene's own
        metadata: the maker's description of the unit; None: the json beside the recording or in the OSF, if any
        poses: file of the sensor's poses; None: poses of the twin's frames, else the pose of the scene's sensor
        sensor_index: which sensor of an OSF, from 0
    """

    recordings: Sequence[Path]
    scene: Path
    sensor: str | None = None
    metadata: Path | None = None
    poses: Path | None = None
    sensor_index: int = 0


def fit_on_scene(inputs: SceneFitInputs) -> tuple[str, Report]:
    """Fit with a scene; returns the text of the unit's sensor file, and the report.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    world = load_scene(inputs.scene)
    sensor_name = world.sensor_name if inputs.sensor is None else inputs.sensor
    where = f"sensor {sensor_name}"
    base = base_text(sensor_name, metadata_of(inputs.recordings[0], inputs.metadata), sensor_index=inputs.sensor_index)
    sensor = parse_sensor(base, where)
    if sensor.histogram is None:
        raise InputError(f"{where}: must count photons, with [histogram], to be fitted with a scene")
    provenance = read_provenance(inputs.scene) if (inputs.scene.parent / PROVENANCE).is_file() else None
    frames, notes = _frames_with_poses(inputs, provenance)
    recording = ", ".join(path.name for path in inputs.recordings)
    if provenance is not None:
        notes += (_TWIN_NOTE,)
    try:
        pulses = lay_on_scene(world, sensor, frames, twin=provenance is not None)
    except ValueError as error:
        raise InputError(f"{recording}: {error}") from None
    if any(sweep.second is not None for sweep, _ in frames):
        base = with_second_returns(base)
    scene = inputs.scene.parent.name if provenance is not None else inputs.scene.stem
    is_of_frame = provenance is not None and provenance["held_out"] is None

    def judge(text: str) -> Judged:
        return _judge(world, parse_sensor(text, FITTED), frames[0], is_of_frame)

    given = judge(base)
    for words, absent in LEFT_OUT.items():
        fit = fit_pulses_on_scene(pulses, sensor, twin=provenance is not None, absent=absent)
        estimates = {estimate.key: estimate for estimate in fit.parameter_fit.estimates}
        text, text_notes = scaled_text(base, estimates, f"{recording} on {scene}", where)
        judged = judge(text)
        misses = sum(row.verdict is False for row in judged[1])
        if misses <= sum(row.verdict is False for row in given[1]):
            break
        notes += (f"with {words} fitted the file misses {misses} limits, more than before, and is not written",)
    else:
        text, text_notes, judged = base, ("the numbers of the file stay as they were",), given
    notes += (f"before the fit, by the same pulses: {verdict(given[1], 'the given file')[:-1]}",)
    names = recording, scene, sensor_name if inputs.sensor is not None else sensor.name
    return text, _report(fit, judged, names, len(frames), (*notes, *text_notes)).report()


def _judge(world: Scene, sensor: Sensor, frame: tuple[Sweep, Pose | None], is_of_frame: bool) -> Judged:
    """Render a sensor in the scene, and hold it to a recorded frame."""
    sweep, pose = frame
    pulses, _ = simulate_pulses(world, sensor, sweep, pose=pose)
    return pulses, [row for row in twin_quantities(pulses, is_of_frame=is_of_frame) if row.is_limited]


def fit_pulses_on_scene(pulses: PulsesOnScene, sensor: Sensor, *, twin: bool, absent: Sequence[str] = ()) -> SceneFit:
    """Maximise the likelihood of three of four blocks of columns.

    Args:
        twin: True: estimate texture, strangers and the scatter of the twin's surfaces, too
        absent: parameters that keep the sensor's values
    """
    fitted_pulses = pulses.select(pulses.fitted)
    group = np.unique(fitted_pulses.scene.group, return_inverse=True)[1]
    fitted_pulses = replace(fitted_pulses, scene=replace(fitted_pulses.scene, group=group))
    names = [name for name in PARAMETERS if name not in {*absent, *_absent(pulses, sensor)}]
    evaluations = 0
    if twin:
        fitted_pulses = replace(fitted_pulses, scene=replace(fitted_pulses.scene, floor_m=_floor_m(fitted_pulses)))
    texture, strangers = (0.3, 0.02) if twin else (0.0, 0.0)
    parameter_fit: ParameterFit | None = None
    rounds = ROUNDS if twin else 1
    for _ in range(rounds):
        scene = replace(fitted_pulses.scene, texture=texture, strangers=strangers)
        parameter_fit = fit_parameters(
            scene,
            fitted_pulses.reported,
            names,
            reflectivity_sigma=REFLECTIVITY_SIGMA,
            start=parameter_fit,
            max_evaluations=MOST_EVALUATIONS // rounds,
        )
        evaluations += parameter_fit.solved.evaluations
        if twin:
            texture, strangers = _texture_and_strangers(replace(fitted_pulses, scene=scene), parameter_fit)
    assert parameter_fit is not None
    return SceneFit(
        pulses=(len(fitted_pulses.block), int(np.sum(~pulses.fitted))),
        parameter_fit=parameter_fit,
        evaluations=evaluations,
        texture=texture,
        strangers=strangers,
    )


def _absent(pulses: PulsesOnScene, sensor: Sensor) -> set[str]:
    """Names of parameters that the sensor does not have, or that the scene was made from."""
    names = set()
    if pulses.scene.spot_over_field is None:
        names.add("spot_over_field")
    if sensor.optics.overlap is None:
        names.add("near_field_m")
    if not np.isfinite(pulses.reported.near_ir).any():
        # The background is that of NEAR_IR, whatever the sun and the PDE.
        names |= {"optics.sun_irradiance_w_m2", "detector.dark_count_rate_hz", "detector.pde"}
    return names


def _floor_m(pulses: PulsesOnScene) -> float:
    """Scatter of the strongest quarter of the returns about the twin's surfaces [m]: the start for `scatter_floor`."""
    signal = pulses.reported.signal
    with np.errstate(invalid="ignore"):
        strong_mask = signal > np.nanquantile(signal, 0.75)
    off_m = (pulses.reported.range_m - pulses.scene.range_m)[strong_mask]
    return max(SIGMA_PER_MAD * float(np.median(np.abs(off_m))), LEAST_FLOOR_M) if strong_mask.any() else LEAST_FLOOR_M


def _texture_and_strangers(pulses: PulsesOnScene, parameter_fit: ParameterFit) -> tuple[float, float]:
    """Estimate texture, the excess scatter of the signals, and strangers, twice the lost share on bright surfaces."""
    prediction = predict(
        replace(pulses.scene, texture=0.0, strangers=0.0),
        parameter_fit.values,
        parameter_fit.reflectivity[pulses.scene.group],
    )
    bright = np.asarray(prediction.chance) > 0.999
    mask = bright & np.isfinite(pulses.reported.signal)
    if mask.sum() < 100:
        return pulses.scene.texture, pulses.scene.strangers
    relative = (pulses.reported.signal / np.asarray(prediction.signal))[mask] - 1.0
    spread = SIGMA_PER_MAD * float(np.median(np.abs(relative - np.median(relative))))
    photons = float(np.median(np.asarray(prediction.variance)[mask] / np.asarray(prediction.signal)[mask] ** 2))
    texture = float(np.sqrt(max(spread**2 - photons, LEAST_TEXTURE**2)))
    # A stranger is kept as often as lost (`KnownScene.strangers`), so twice as many met one as were lost.
    return texture, min(2.0 * float(np.mean(~pulses.reported.has_return[bright])), 0.5)


def _frames_with_poses(
    inputs: SceneFitInputs, provenance: dict[str, object] | None
) -> tuple[list[tuple[Sweep, Pose | None]], tuple[str, ...]]:
    """Read the frames to fit with their poses; returns them and the notes on what the twin saw of them."""
    frames: list[tuple[Sweep, Pose | None]] = []
    for path in inputs.recordings:
        with open_recording(path, inputs.metadata, sensor_index=inputs.sensor_index) as recording:
            if provenance is None:
                frames += [(sweep, None) for sweep in recording]
                continue
            held_out, twin_numbers = provenance["held_out"], sorted(int(number) for number in provenance["places"])  # type: ignore[attr-defined]
            numbers = [held_out] if isinstance(held_out, int) else twin_numbers
            for number in numbers:
                sweep = recording[int(number)]
                if held_out == COLUMNS:
                    sweep = select_columns(sweep, slice(1, None, 2))
                frames.append((sweep, frame_pose(provenance, int(number), inputs.scene)))
    if inputs.poses is not None:
        frames = _place_frames(frames, inputs.poses)
    if provenance is None:
        return frames, ()
    if provenance["held_out"] is None:
        return frames, (_SEEN_NOTE,)
    return frames, (_HELD_OUT_NOTE,)


def _place_frames(frames: list[tuple[Sweep, Pose | None]], path: Path) -> list[tuple[Sweep, Pose | None]]:
    """Place frames at the poses of a file, whose times are the recording's, or count from its first frame.

    Raises:
        InputError: if the poses do not reach from the first frame to the last
    """
    motion = read_poses(path)
    first, last = motion.span_s
    start_s = frames[0][0].start_s
    offset_s = 0.0 if first <= start_s <= last else start_s
    placed: list[tuple[Sweep, Pose | None]] = []
    for number, (sweep, _) in enumerate(frames):
        time_s = sweep.start_s - offset_s
        if not first - 1e-3 <= time_s <= last + 1e-3:
            must = f"must reach from the first to the last frame, got {first:g} to {last:g} s"
            raise OptionError(f"{{poses}} {{0}}: {must} and frame {number} at {time_s:g} s", path)
        placed.append((sweep, pose_at(motion, time_s)))
    return placed


def _report(fit: SceneFit, judged: Judged, names: tuple[str, str, str], frames: int, notes: Sequence[str]) -> FitReport:
    """Report of a fit; ``names`` are those of the recording, the scene and the sensor."""
    recording, scene, sensor = names
    parameter_fit, (matched, rows) = fit.parameter_fit, judged
    return FitReport(
        title=f"{recording} on {scene}: what they say of {sensor}",
        summary=f"{recording} on {scene}: {fit.pulses[0]:,} pulses of {count_text(frames, 'frame')} were fitted, but "
        f"for {fit.pulses[1]:,} of every fourth block of columns. The written file is rendered in the scene, and held "
        "to all pulses of the first frame. The light of the scene was traced once for the fit, "
        f"the likelihood of what was kept, of signals and ranges evaluated {fit.evaluations} times. Reflectivities are "
        f"free, patch by patch, within {REFLECTIVITY_SIGMA:.0%} of the scene's. Signals scatter by {fit.texture:.0%} "
        "more than photons do: texture of the surfaces, and what the scene has wrong. "
        f"{fit.strangers:.1%} of the pulses met something that is not in the scene.",
        checks=rows,
        estimates=parameter_fit.estimates,
        notes=notes,
        null=parameter_fit.null,
        held=parameter_fit.held,
        products={},
        solutions={"parameters": (parameter_fit.names, parameter_fit.solved)},
        figures=list(side_figures(matched)),
        numbers={
            "recording": recording,
            "scene": scene,
            "sensor": sensor,
            "frames": frames,
            "pulses": {"fitted": fit.pulses[0], "not fitted": fit.pulses[1]},
            "evaluations": fit.evaluations,
            "texture": fit.texture,
            "strangers": fit.strangers,
        },
    )
