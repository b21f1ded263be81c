"""Studies in one call: names, files or objects in, a `Report` out.

`Report.table` has its numbers, `plot` its figures, `save` writes its page, and a notebook shows it. The commands of the
same names make the same reports.
"""

from __future__ import annotations

import operator
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypedDict, TypeVar, Unpack

from .. import catalog
from ..cloud.point_cloud import PointCloud
from ..errors import InputError, OptionError, one_line
from ..figures.report import Report
from ..files.arguments import checks_arguments, unknown_option
from ..files.atomic import put_text
from ..files.overrides import Overrides, assignments
from ..recordings.opening import open_recording
from ..rendering.render_options import FrameKeywords, FrameOptions, Keywords, key_to_change
from ..scene.scene import Scene
from ..scene.scene_file import SceneChoice, load_scene
from ..sensor.pose_file import Placed, to_pose
from ..sensor.rig_file import Rig
from ..sensor.sensor_file import load_sensor
from ..sensor.sensor_model import Sensor, warn_of_doubts
from .field_of_view.study_options import FieldOfViewStudy
from .ranging.conditions import CONDITIONS, Conditions, SweepOptions
from .ranging.subjects import subject_of, subjects

if TYPE_CHECKING:
    from .budget import Budget

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
File = str | os.PathLike[str]
SensorChoice = str | os.PathLike[str] | Sensor
"""Catalogue name, sensor file or `Sensor`."""

SensorChoices = Annotated[SensorChoice | Sequence[SensorChoice], "names, files or Sensors"]
"""One of them or several."""


class ConditionKeywords(TypedDict, total=False):
    """Keywords for the fields of `Conditions`."""

    probability: float
    distance: float
    illuminance_klux: float
    sun_angle: float
    reflectivity: float
    incidence: float
    transmittance: float | None
    extinction: float | None
    visibility: float | None


class SweepKeywords(ConditionKeywords, total=False):
    """Keywords of `sweep`: fields of `SweepOptions`, and conditions that are not swept."""

    quantity: str | None
    start: float | None
    stop: float | None
    points: int
    aperture_law: str | None
    log: bool | None


class FovKeywords(TypedDict, total=False):
    """Keywords of `fov`: settings of the study, and of the target whose range is mapped."""

    times_s: Sequence[float]
    cell_deg: float
    mask: str
    reflectivity: float
    illuminance_klux: float


@checks_arguments
def max_range(sensors: SensorChoices, *, overrides: Overrides = (), **conditions: Unpack[ConditionKeywords]) -> Report:
    """Range of sensors on a flat target, with SNR and detection probability at a distance.

    Args:
        sensors: catalogue names, sensor files or `Sensor`s, one or several; several are put on equal terms too
        overrides: changes to values of the files, of all or, as "vlp-16:laser.peak_power_w=60", of one

    Keyword Args:
        probability: detection probability at the range, 0.9 by default; another is named in the column: range_pd50_m
        distance: of SNR and detection probability [m], 100 by default
        illuminance_klux: of the sun on the target [klux], 100 by default
        sun_angle: between sun and surface normal [degrees], 60 by default
        reflectivity: of the target, 0.1 by default
        incidence: of the beam on it [degrees], 0 by default
        transmittance: of the air, one way, fixed; else extinction [1/m] or visibility [km]; without any 0.98

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    from .ranging.range_summary import range_report

    _refuse_unknown(conditions, ConditionKeywords.__annotations__, "sensors", "overrides")
    return range_report(_named(sensors, overrides), Conditions(**conditions))


@checks_arguments
def sweep(sensors: SensorChoices, over: str, *, overrides: Overrides = (), **options: Unpack[SweepKeywords]) -> Report:
    """SNR, range or detection probability over an axis, with crossings and limits.

    Args:
        sensors: catalogue names, sensor files or `Sensor`s, one or several
        over: "distance", "illuminance_klux", "elevation", "azimuth", "reflectivity", "incidence", or a key such as
            "detector.gain"
        overrides: changes to values of the files, of all or, as "vlp-16:laser.peak_power_w=60", of one

    Keyword Args:
        quantity: "snr", "range" or "pd"; by default the SNR over distance, and the range over all else
        start: start of the axis, in its unit
        stop: end of the axis, in its unit
        points: on the axis, 200 by default
        aperture_law: of the receiver off its axis, over elevation or azimuth: "scanner", "constant", "cosine" or
            "mirror"
        log: logarithmic steps, or even ones

    Raises:
        InputError: if a file, a key or a value cannot be understood

    The other arguments are the conditions of `max_range` that are held.
    """
    from .ranging.sweep_report import sweep_report

    _refuse_unknown(options, {**SweepKeywords.__annotations__, **ConditionKeywords.__annotations__}, "sensors", "over")
    names = [field.name for field in fields(SweepOptions)]
    axis: dict[str, Any] = {name: value for name, value in options.items() if name in names}
    held: dict[str, Any] = {name: value for name, value in options.items() if name not in names}
    sweep_options = SweepOptions(over=over, **axis)
    sweep_options.require_sense(held)
    conditions = Conditions(**held)
    return sweep_report([subject_of(*named) for named in _named(sensors, overrides)], sweep_options, conditions)


@checks_arguments
def sensitivities(
    sensors: SensorChoices, *, overrides: Overrides = (), **conditions: Unpack[ConditionKeywords]
) -> Report:
    """Effect of each number of sensors, target and air on the range, and on the detection probability.

    Args:
        sensors: catalogue names, sensor files or `Sensor`s, one or several
        overrides: changes to values of the files, of all or of one

    Keyword Args:
        distance: of the detection probability [m]; by default each sensor's range

    Raises:
        InputError: if a file, a key or a value cannot be understood

    The other arguments are the other conditions of `max_range`.
    """
    from .ranging.sensitivities import sensitivity_report

    _refuse_unknown(conditions, ConditionKeywords.__annotations__, "sensors", "overrides")
    named, distance_m = _named(sensors, overrides), conditions.get("distance")
    return sensitivity_report(named, Conditions(**conditions), distance_m=distance_m)


@checks_arguments
def budget(cloud: PointCloud, scene: SceneChoice, sensor: SensorChoice) -> Budget:
    """Compute the light and the electronics of each point of a cloud that was rendered here.

    ``budget(cloud[:1], "car", "apd-905")`` is that of one point. Echo powers fit the points' SNR; the background is
    that of Lambertian surfaces.

    Args:
        cloud: with its truth
        scene: a name, a file or a `Scene`, with the light in which the cloud was made
        sensor: catalogue name, sensor file or `Sensor` that made it

    Raises:
        InputError: if a file, a key or a value cannot be understood, and for a cloud without truth
    """
    from ..rendering.stages import ambient_of
    from .budget import budget_of

    chosen = load_sensor(sensor)
    return budget_of(cloud, chosen, ambient_of(load_scene(scene), chosen))


@checks_arguments
def eye_safety(sensors: SensorChoices, *, overrides: Overrides = ()) -> Report:
    """Every criterion of class 1 of IEC 60825-1:2014, with the beam scanning and standing still; no certification.

    ``passed`` says whether the scanning beams are of class 1; None: a pulse energy is a guess, so nothing is judged.

    Args:
        sensors: catalogue names, sensor files or `Sensor`s, one or several
        overrides: changes to values of the files, of all or of one

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    from .eye_safety.eye_safety_report import class_1_report

    return class_1_report([sensor for _, sensor in _named(sensors, overrides)])


@checks_arguments
def design(study: File, folder: File) -> Report:
    """Search the designs of a study; the report has the designs that no other beats, and their sensor files.

    Args:
        study: name of a shipped study, or a study file
        folder: for all evaluations, with which a search that was broken off goes on; ``save(folder)`` adds the page

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    from .design.design_study import run_study

    return run_study(study_path(study), Path(folder))


def study_path(study: File) -> Path:
    """File of a design study, by its path or its name in the catalogue.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    name = os.fspath(study)
    return Path(name) if name.endswith(".toml") else catalog.path_of("designs", name)


@checks_arguments
def fov(
    sensors: SensorChoice | Rig | Sequence[SensorChoice],
    *,
    scene: File | Scene | None = None,
    pose: Placed | None = None,
    overrides: Overrides = (),
    **settings: Unpack[FovKeywords],
) -> Report:
    """Study what scan patterns cover: how densely, how soon, how far.

    Args:
        sensors: catalogue names, sensor files or `Sensor`s, one or several; or a `Rig`
        scene: scene on whose bodies points are counted too
        pose: where the sensors' vehicle stands in it; None: the scene's sensor pose, of a rig the origin
        overrides: changes to values of the files, of all or, as "vlp-16:laser.peak_power_w=60", of one

    Keyword Args:
        times_s: times of the coverage
        cell_deg: size of the cells
        mask: the field of view: "outline", the pattern's convex outline, or "reached", cells ever reached
        reflectivity: of the target on which the range is mapped
        illuminance_klux: of the sun on it; klux

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    from .field_of_view.field_of_view_study import field_of_view_study

    if pose is not None and scene is None:
        raise InputError("pose: needs scene")
    _refuse_unknown(settings, FovKeywords.__annotations__, "sensors", "scene", "pose", "overrides")
    lit = {name: settings[name] for name in ("reflectivity", "illuminance_klux") if name in settings}
    scanned: dict[str, Any] = {name: value for name, value in settings.items() if name not in lit}
    study = FieldOfViewStudy(**scanned, target=Conditions(**lit).target())
    vehicle = None if pose is None else to_pose(pose)
    if isinstance(sensors, Rig):
        if assignments(overrides):
            raise InputError("overrides: must be given to load_rig, got a Rig")
        named = [(mounted.label, mounted.placed) for mounted in sensors.sensors]
        vehicle = vehicle or to_pose((0.0, 0.0, 0.0))
    else:
        named = _named(sensors, overrides)
    return field_of_view_study(named, study, scene=None if scene is None else load_scene(scene), vehicle=vehicle)


@checks_arguments
def compare(
    scene: File | Scene | PointCloud | Sequence[File | PointCloud],
    sensors: SensorChoices | None = None,
    *,
    overrides: Overrides = (),
    same_beams: bool = False,
    illuminance_klux: Sequence[float] | None = None,
    **options: Unpack[FrameKeywords],
) -> Report:
    """Compare sensors in a scene, or clouds with each other.

    Args:
        scene: scene that all ``sensors`` see; without them two clouds or more, or files of them
        sensors: catalogue names, sensor files or `Sensor`s; the first is compared with each other
        overrides: changes to values of the sensor files, of all or of one
        same_beams: all run with the first sensor's scanner and mounting
        illuminance_klux: sweep over these, and find where sensors overtake each other
        options: fields of `FrameOptions`: ``seed=1``

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    from .compare.bench import Bench
    from .compare.comparison_study import compare_clouds, compare_sensors

    keywords = Keywords(dict(options))
    frame = keywords.take(FrameOptions)
    keywords.end("scene", "sensors", "overrides", "same_beams", "illuminance_klux")
    listed = [scene] if isinstance(scene, str | os.PathLike | Scene | PointCloud) else list(scene)
    alone = [name for name in listed if isinstance(name, str) and name in catalog.names("sensors")]
    if alone:
        raise InputError(
            f"compare: must have a scene before its sensors, as compare('car', ['{alone[0]}', ...]), got sensors "
            f"alone; max_range(['{alone[0]}', ...]) compares their ranges"
        )
    if sensors is None:
        clouds = [cloud for cloud in listed if not isinstance(cloud, Scene)]
        if len(clouds) < 2:
            raise InputError("compare: must have sensors for a scene, or two clouds or more, got neither")
        return compare_clouds(clouds)
    if not isinstance(scene, str | os.PathLike | Scene):
        raise InputError("sensors: needs one scene, got clouds")
    named = _named(sensors, overrides)
    if len(named) < 2:
        raise InputError(f"sensors: must be two or more, got {len(named)}")
    swept = tuple(illuminance_klux if illuminance_klux is not None else ())
    for value in swept:
        CONDITIONS["illuminance_klux"].check("illuminance_klux", value)
        CONDITIONS["illuminance_klux"].warn_of_unit("illuminance_klux", value)
    if illuminance_klux is not None and not (swept and swept[0] > 0.0 and all(map(operator.lt, swept, swept[1:]))):
        raise InputError(f"illuminance_klux: must be positive and rise, such as (10, 50, 100), got {one_line(swept)}")
    bench = Bench(load_scene(scene), frame)
    return compare_sensors(bench, named, same_beams=same_beams, illuminances_klux=swept)


@checks_arguments
def certify(
    recording: File,
    sensor: str | None = None,
    *,
    scene: File | None = None,
    frame: int | None = None,
    metadata: File | None = None,
    sensor_index: int = 0,
    seed: int = 0,
) -> Report:
    """Hold a simulated sensor to a recording of the real one, pulse by pulse.

    ``passed`` of the report says whether all limits are met that could be measured.

    Args:
        sensor: catalogue name or sensor file; None: the unit's own, by its maker's metadata, or the scene's
        scene: scene file of the recording's twin; None: one is made, and not kept
        frame: frame of the recording that is judged, from 0; None: a held-out one
        metadata: the maker's description of the unit; None: the json beside the recording or in the OSF, if any
        sensor_index: which sensor of an OSF, from 0
        seed: of the simulation

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    from .twin.certificate import certify_in_twin, certify_sensor

    described, options = None if metadata is None else Path(metadata), FrameOptions(seed=seed)
    with open_recording(recording, described, sensor_index=sensor_index) as opened:
        if scene is None:
            return certify_sensor(
                opened, sensor, frame=frame, metadata=described, sensor_index=sensor_index, options=options
            )
        other = None if sensor is None else load_sensor(sensor)
        return certify_in_twin(Path(scene), opened, other, frame=frame, name=sensor, options=options)


@checks_arguments
def fit(
    recordings: File | Sequence[File],
    sensor: str | None = None,
    *,
    scene: File | None = None,
    poses: File | None = None,
    frames: Sequence[int] | None = None,
    metadata: File | None = None,
    sensor_index: int = 0,
) -> Report:
    """Fit numbers of a sensor to recordings of one unit; the report's files have its ``sensor.toml``.

    Args:
        sensor: catalogue name or sensor file of its kind, for what the recording leaves open; None: the scene's
        scene: scene file of the recording's twin, or of the scene it was recorded in
        poses: with ``scene``, file of the sensor's poses at each frame
        frames: without ``scene``, frames of each recording, from 0; None: all
        metadata: the maker's description of the unit; None: the json beside the recording or in the OSF, if any
        sensor_index: which sensor of an OSF, from 0

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    text, report = fit_sensor(
        recordings, sensor, scene=scene, poses=poses, frames=frames, metadata=metadata, sensor_index=sensor_index
    )
    report.add_file("sensor.toml", partial(put_text, text=text))
    return report


def fit_sensor(
    recordings: File | Sequence[File],
    sensor: str | None,
    *,
    scene: File | None,
    poses: File | None,
    frames: Sequence[int] | None,
    metadata: File | None,
    sensor_index: int,
) -> tuple[str, Report]:
    """Choose the fit with a scene or without, and run it; returns the text of the sensor file, and the report.

    Arguments as of `fit`.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    from .fit.on_scene.scene_fit import SceneFitInputs, fit_on_scene
    from .fit.recording_fit import fit_recordings

    paths = [Path(path) for path in ([recordings] if isinstance(recordings, str | os.PathLike) else recordings)]
    if not paths or not all(path.name for path in paths):
        raise InputError("recordings: must be one file or more, got none")
    described = None if metadata is None else Path(metadata)
    if scene is not None:
        if frames is not None:
            raise OptionError("{frames}: cannot be combined with {scene}, whose twin says which frames are fitted")
        inputs = SceneFitInputs(
            recordings=paths,
            scene=Path(scene),
            sensor=sensor,
            metadata=described,
            poses=None if poses is None else Path(poses),
            sensor_index=sensor_index,
        )
        return fit_on_scene(inputs)
    if poses is not None:
        raise OptionError("{poses}: needs {scene}")
    if sensor is None:
        raise OptionError("{sensor}: must name the sensor of the recording, or {scene} one that has it, got neither")
    return fit_recordings(paths, sensor, metadata=described, sensor_index=sensor_index, frames=frames)


@checks_arguments
def twin(
    recording: File,
    folder: File,
    *,
    frames: Sequence[int] | None = None,
    held_out: int | str | None = None,
    metadata: File | None = None,
    sensor: str | None = None,
    sensor_index: int = 0,
) -> Path:
    """Make the scene of a recording and write it into a folder; returns the scene file, for `render` and `certify`.

    Args:
        frames: frames that it is made of, from 0; None: all
        held_out: frame that is left out, or "columns" for every second column of the only frame, to judge the twin by
        metadata: the maker's description of the unit; None: the json beside the recording or in the OSF, if any
        sensor: catalogue name or sensor file, in place of the unit's own
        sensor_index: which sensor of an OSF, from 0

    Raises:
        InputError: if a file, a key or a value cannot be understood
        OutputError: if a result cannot be written
    """
    from .twin.twin_files import SCENE, build_twin, choose_frames

    described = None if metadata is None else Path(metadata)
    with open_recording(recording, described, sensor_index=sensor_index) as opened:
        choice = choose_frames(opened, frames, held_out)
        build_twin(opened, choice, Path(folder), metadata=described, sensor=sensor, sensor_index=sensor_index)
    return Path(folder) / SCENE


def _refuse_unknown(keywords: Mapping[str, object], known: Collection[str], *parameters: str) -> None:
    """Raise InputError for a keyword that is not known; ``parameters`` are the call's others."""
    options = [*known, *parameters]
    for word in keywords:
        if word not in options:
            raise unknown_option(word, options, meant=key_to_change(word, options))


def _named(sensors: SensorChoice | Sequence[SensorChoice], overrides: Overrides) -> list[tuple[str, Sensor]]:
    """Names, made unique, and sensors. Warns of doubts about them.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    choices = [sensors] if isinstance(sensors, str | os.PathLike | Sensor) else list(sensors)
    if not choices:
        raise InputError("sensors: must be at least one, got none")
    changes = assignments(overrides)
    if changes and any(isinstance(choice, Sensor) for choice in choices):
        raise InputError("overrides: needs names or files of sensors, got a Sensor; see Sensor.replace")
    read = iter(subjects([os.fspath(choice) for choice in choices if not isinstance(choice, Sensor)], changes))
    named: list[tuple[str, Sensor]] = []
    for choice in choices:
        if isinstance(choice, Sensor):
            name, sensor = choice.name, choice
        else:
            subject = next(read)
            name, sensor = subject.name, subject.sensor()
        count = sum(taken == name or taken.startswith(f"{name} (") for taken, _ in named)
        named.append((name if not count else f"{name} ({count + 1})", sensor))
    warn_of_doubts(sensor for _, sensor in named)
    return named
