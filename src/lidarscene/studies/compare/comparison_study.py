"""Entry points of a comparison: `compare_sensors` simulates a scene, `compare_clouds` takes clouds.

Both return a report. The command `compare` and Python users call them.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...cloud.point_cloud import PointCloud
from ...detection.outcomes import Status
from ...figures.report import Report
from ...scene.scene import Scene
from ...sensor.sensor_model import Sensor
from ..field_of_view.field_of_view_study import ProgressCallback
from ..ranging.equal_terms import equal_terms, verdict
from ..ranging.plane import Target
from ..ranging.sweep_report import unambiguous_m
from . import cloud_matching
from .bench import Bench, NamedSensor, fires_alike, with_beams_of
from .comparison_files import comparison_page
from .comparison_report import Comparison
from .illuminance_sweep import sweep_illuminance
from .observations import Observation, groupings

_INTERVALS = (
    "Intervals are 95 %: by Wilson for rates, and by Agresti and Min for the difference of two rates of the same "
    "pulses. They assume independent pulses."
)


def compare_sensors(
    bench: Bench,
    sensors: Sequence[NamedSensor],
    *,
    same_beams: bool = False,
    illuminances_klux: Sequence[float] | None = None,
    progress: ProgressCallback = lambda done, total: None,
) -> Report:
    """Render the bench's scene with each sensor and compare what they report.

    Args:
        same_beams: all sensors get the first one's scanner and mounting
        progress: called with (done, total) at the start and after each frame

    Raises:
        InputError: if a file, a key or a value cannot be understood
        BackendError: if Mitsuba has no back end that works on this machine
    """
    scene, first = bench.scene, sensors[0][1]
    if same_beams:
        sensors = [(name, with_beams_of(first, sensor)) for name, sensor in sensors]
    matched = all(fires_alike(first, sensor) for _, sensor in sensors[1:])
    names = [name for name, _ in sensors]
    total = len(sensors) * (1 + len(illuminances_klux or ()))
    progress(0, total)
    observed = []
    for name, sensor in sensors:
        observed.append(bench.observe(name, sensor))
        progress(len(observed), total)
    observations = tuple(observed)
    if not matched:
        observations = tuple(replace(observation, pulse=None) for observation in observations)
    plane = Target(illuminance_klux=scene.sun.illuminance_klux)
    comparison = Comparison(
        title=f"{', '.join(names)} in the scene {scene.name}",
        observations=observations,
        sensors=tuple(sensor for _, sensor in sensors),
        groups=groupings(observations),
        matched=matched,
        population="the pulses that hit a surface",
        notes=(_beams_note(scene, bench.frame.seed, matched=matched, same_beams=same_beams), _RATES_NOTE, _INTERVALS),
        aliasing_notes=aliasing_notes(observations, [sensor for _, sensor in sensors]),
        equal_terms=verdict(equal_terms(sensors, plane), plane),
        seed=bench.frame.seed,
        sweep=sweep_illuminance(
            bench, sensors, illuminances_klux, progress=lambda rendered: progress(len(sensors) + rendered, total)
        )
        if illuminances_klux
        else None,
    )
    # The scene's camera is set for the scene's own sensor pose.
    return comparison_page(comparison, scene.camera if bench.frame.pose is None else None)


def aliasing_notes(observations: Sequence[Observation], sensors: Sequence[Sensor]) -> tuple[str, ...]:
    """Sentence for each sensor with echoes from beyond its unambiguous range."""
    counts = [int(np.count_nonzero(observation.cloud.status == Status.ALIASED)) for observation in observations]
    return tuple(
        f"{observation.name}: {count:,} echoes from beyond {unambiguous_m(sensor):.1f} m are reported too near by that "
        "range, status 4"
        for observation, sensor, count in zip(observations, sensors, counts, strict=True)
        if count
    )


def compare_clouds(clouds: Sequence[str | os.PathLike[str] | PointCloud]) -> Report:
    """Compare clouds, or files of them.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    observations = tuple(cloud_matching.read_clouds(clouds))
    matched = all(observation.surfaces is not None for observation in observations)
    names = [observation.name for observation in observations]
    notes = [_MATCHED_CLOUDS if matched else _UNMATCHED_CLOUDS, _INTERVALS]
    for observation in observations[1:] if matched else ():
        share = cloud_matching.disagreeing_share(observations[0], observation)
        if share > 0.01:
            notes.append(
                f"{100.0 * share:.1f} % of the pulses that {names[0]} and {observation.name} both detected hit "
                "surfaces at different true ranges: the two clouds are not of the same scene from the same place."
            )
    comparison = Comparison(
        title=f"{', '.join(names)}",
        observations=observations,
        sensors=(None,) * len(observations),
        groups=groupings(observations),
        matched=matched,
        population="the pulses with which any of the clouds has an echo",
        notes=tuple(notes),
    )
    return comparison_page(comparison)


_RATES_NOTE = (
    "A pulse is detected if at least one of its points is an echo. Expected is the mean of the computed detection "
    "probabilities of the same pulses. Detected minus expected compares all echoes that tripped the comparator, even "
    "if out of the window or hidden, with the sum of the probabilities, in standard deviations of independent draws."
)
_MATCHED_CLOUDS = (
    "These clouds are files. Points belong to one pulse if time, channel, azimuth and elevation agree to the last bit. "
    "Files do not contain missed pulses, so rates refer to the pulses with an echo in at least one cloud, and there is "
    "no expected rate. The truth is that of the first cloud that has it."
)
_UNMATCHED_CLOUDS = (
    "These clouds are files that share no pulses: time, channel, azimuth and elevation of their points do not agree. "
    "Pulses cannot be matched, and files do not contain missed pulses, so echoes are counted instead of rates."
)


def _beams_note(scene: Scene, seed: int, *, matched: bool, same_beams: bool) -> str:
    light = f"The scene {scene.name} under {scene.sun.illuminance_klux:g} klux, seed {seed} for all sensors. "
    if matched:
        how = "All have the scanner and mounting of the first: the" if same_beams else "The"
        return (
            f"{light}{how} sensors fire the same pulses, which are matched by number. The random numbers of a "
            "pulse are the same for all sensors."
        )
    return (
        f"{light}The sensors do not fire the same pulses, because their scanners or mountings differ. Pulses are "
        "therefore not matched, and rates are compared by bin and body. With the same-beams option all "
        "sensors get the scanner and mounting of the first."
    )
