"""Trial of a GPU: before its first use, small frames rendered on it are compared with those of the CPU.

What Dr.Jit and Mitsuba do on a GPU depends on its driver, and a fault there may be silent. So before the first use on a
machine both render the same small frames, each in a process of its own, which may even die: with moving bodies, with
glass, and with fog and several rays. Random numbers belong to pulses, so the frames must be the same but for rounding.
BSDFs of a Mitsuba file are code that these frames have not: such a scene is rendered there by a process of its own,
too. Verdicts are kept (`files.cache_folder`) for these versions, this driver, these settings and this scene.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from ..._version import __version__
from ...errors import OutputError
from ...files.atomic import put_text
from ...files.cache_folder import cache_folder
from ...formats.npz import read_npz
from ...maths.arrays import Numbers
from ...physics.optics import radiometry
from ...scene.scene import Scene

Columns = Mapping[str, Numbers]

FRAMES = {
    "drive": ("drive", "--sensor", "vlp-16"),
    "glass": ("glass", "--sensor", "table1-apd", "--set", "scanner.azimuth_step_deg=0.5"),
    "fog": ("fog", "--sensor", "table1-sipm", "--rays", "3", "--set", "scanner.azimuth_step_deg=1"),
}
"""Options of `lidarscene render` for each frame."""

LARGEST_DIFFERING_SHARE = 1e-3
"""Accuracy bought: largest share of points that may differ: exp, log and roots are rounded differently, so that a few
echoes cross the threshold on one side alone."""

LARGEST_SHARE_ONE_STEP_OFF = 5e-3
"""Accuracy bought: largest share of points whose range may be the next step of the sensor's clock, whose intensity that
of its converter, and whose reflectivity that of the next brick or plank: rounding moves a value across a border. On an
H200 0.1 to 0.2 % of ranges, and up to 0.1 % of reflectivities."""

LIMITS = {
    "reflectivity": (1e-4, 0.0),
    "range": (1e-3, 0.0),
    "true_range": (1e-3, 0.0),
    "intensity": (0.0, 1e-3),
    "snr": (0.0, 1e-3),
    "detection_probability": (1e-3, 0.0),
    "status": (0.0, 0.0),
}
"""Accuracy bought: absolute and relative differences of a column that rounding explains: a traced range is good to
0.1 mm at 200 m, an amplitude or an SNR to 1e-4."""

_READ = ("time", "return_number", "body", *LIMITS)
"""Columns of a frame that are read."""

_RENDER_SCENE = "import lidarscene, pickle, sys; lidarscene.render(pickle.load(open(sys.argv[1], 'rb')), 'vlp-16')"
"""Program that renders a pickled scene."""

PATIENCE_S = 600.0
"""Choice: time limit for one frame, whose kernels are compiled for the first time, seconds."""

_DRIVER = Path("/proc/driver/nvidia/version")


@dataclass(frozen=True, slots=True)
class Verdict:
    """Result of the trial of a variant.

    Attributes:
        fault: why its frames cannot be trusted; "" if they are the same
        renders: whether it renders at all
    """

    fault: str = ""
    renders: bool = True


def verdict(variant: str, reference: str, *, render: Callable[[str, str], Columns | str] | None = None) -> Verdict:
    """Compare frames of ``variant`` with those of ``reference``, or read the verdict of an earlier comparison.

    Args:
        render: takes frame and variant; returns the columns of its points, or why there are none
    """
    return _kept(_verdict_file(variant, reference), lambda: _compare(variant, reference, render or _render_in_process))


def scene_verdict(
    scene: Scene, variant: str, reference: str, *, render: Callable[[bytes, str], str] | None = None
) -> Verdict:
    """Render a scene's Mitsuba file on ``variant``, or read the verdict of an earlier time.

    What ``reference`` cannot render either is no fault of ``variant``: then the scene is wrong.

    Args:
        render: takes the pickled scene and a variant; returns why it cannot be rendered, "" if it can
    """
    from ...scene.scene_file import files_of_scene

    assert scene.base is not None
    render = render or _render_scene
    pickled = pickle.dumps(replace(scene, bodies=(), ego=None))
    texts = [path.read_bytes() for path in files_of_scene(scene.base) if path.suffix == ".xml" and path.is_file()]
    digest = hashlib.sha256(b"".join([pickled, *texts])).hexdigest()

    def compare() -> Verdict:
        fault = render(pickled, variant)
        return Verdict(fault, renders=False) if fault and not render(pickled, reference) else Verdict()

    return _kept(_verdict_file(variant, reference, digest), compare)


def _kept(entry: Path | None, compare: Callable[[], Verdict]) -> Verdict:
    """Return the verdict in a file; if there is none, that of a comparison, and write it."""
    if entry is not None:
        with suppress(OSError, ValueError, TypeError):
            return Verdict(**json.loads(entry.read_text(encoding="utf-8")))
    result = compare()
    if entry is not None:
        with suppress(OSError, OutputError):
            put_text(entry, json.dumps(asdict(result)))
    return result


def _compare(variant: str, reference: str, render: Callable[[str, str], Columns | str]) -> Verdict:
    for frame in FRAMES:
        cloud = render(frame, variant)
        if isinstance(cloud, str):
            return Verdict(f"cannot render a small frame ({frame}): {cloud}", renders=False)
        expected = render(frame, reference)
        # Without the other there is nothing to fall back on either.
        unlikeness = "" if isinstance(expected, str) else difference(cloud, expected, step_m=_step_m(FRAMES[frame][2]))
        if unlikeness:
            return Verdict(f"a small frame ({frame}) is not that of {reference}: {unlikeness}")
    return Verdict()


def difference(cloud: Columns, expected: Columns, *, step_m: float = 0.0) -> str:
    """Return how two clouds of the same pulses differ beyond rounding, in words; "" if they do not.

    Points are matched by time and return number.

    Args:
        step_m: step of the sensor's ranges
    """
    keys = [np.stack([columns["time"], columns["return_number"]], axis=1) for columns in (cloud, expected)]
    most = max(len(key) for key in keys)
    all_keys, places = np.unique(np.concatenate(keys), axis=0, return_inverse=True)
    places = places.reshape(-1)
    row = np.full((2, len(all_keys)), -1)
    for number, part in enumerate(np.split(places, [len(keys[0])])):
        row[number, part] = np.arange(len(part))
    in_both = (row >= 0).all(axis=0)

    def where(bodies: Numbers) -> str:
        """Name of the body with the most of these points."""
        names, counts = np.unique(bodies[bodies != ""], return_counts=True)
        return f", {counts.max()} of them on '{names[counts.argmax()]}'" if len(names) else ""

    alone = len(all_keys) - int(in_both.sum())
    if alone > LARGEST_DIFFERING_SHARE * most:
        bodies = np.concatenate(
            [
                columns["body"][side[(side >= 0) & ~in_both]]
                for columns, side in zip((cloud, expected), row, strict=True)
            ]
        )
        return f"{alone} of {most} points have no counterpart{where(bodies)}"
    a, b = row[0, in_both], row[1, in_both]
    for name, (absolute, relative) in LIMITS.items():
        x, y = cloud[name][a].astype(np.float64), expected[name][b].astype(np.float64)
        with np.errstate(invalid="ignore"):  # the same infinity is the same, and so is no surface
            distance, limit = np.abs(x - y), absolute + relative * np.abs(y)
            differs = ~((x == y) | (distance <= limit) | (np.isnan(x) & np.isnan(y)))
        far = differs & ~(distance <= limit + step_m) if name == "range" else differs
        if name in ("reflectivity", "intensity"):
            far = np.zeros_like(differs)  # what does not come of steps is in the SNR, too
        for points, share in ((far, LARGEST_DIFFERING_SHARE), (differs, LARGEST_SHARE_ONE_STEP_OFF)):
            if np.count_nonzero(points) > share * most:
                body = where(expected["body"][b][points])
                return f"{np.count_nonzero(points)} of {most} points differ in {name}{body}"
        if name == "reflectivity":
            a, b = a[~differs], b[~differs]  # the others have another signal, too
    return ""


def _render_in_process(frame: str, variant: str) -> Columns | str:
    """Render a frame in a process of its own; return its columns, or the last line of the error."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.npz"
        options = [*FRAMES[frame], "--seed", "1", "-o", str(path)]
        if problem := _run(["-m", "lidarscene", "render", *options], variant):
            return problem
        with np.load(path, allow_pickle=False) as archive:
            columns = {name: archive[name] for name in _READ}
        names = np.array([*read_npz(path)["body_names"], ""])  # -1 is no body
        return columns | {"body": names[columns["body"]]}


def _render_scene(pickled: bytes, variant: str) -> str:
    """Render a scene in a process of its own; return the last line of the error, "" without one."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.pickle"
        path.write_bytes(pickled)
        return _run(["-c", _RENDER_SCENE, str(path)], variant)


def _run(arguments: Sequence[str], variant: str) -> str:
    """Run Python with these arguments and this variant; return the last line of the error, "" without one."""
    try:
        process = subprocess.run(
            [sys.executable, *arguments],
            env=os.environ | {"LIDARSCENE_VARIANT": variant},
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
        )
    except subprocess.TimeoutExpired:
        return f"not done after {PATIENCE_S:g} s"
    if process.returncode == 0:
        return ""
    lines = process.stderr.strip().splitlines() or [f"the process ended with {process.returncode}"]
    return lines[-1].removeprefix("lidarscene: error: ")


def _step_m(sensor: str) -> float:
    """Step of the ranges of a sensor of the catalogue [m]; 0: none."""
    from ...sensor.sensor_file import load_sensor  # only where there is a GPU: it takes a third of a second

    step_s = load_sensor(sensor).tdc.least_significant_bit_s
    return float(radiometry.range_from_time_of_flight_m(time_of_flight_s=step_s))


def _verdict_file(variant: str, reference: str, scene: str = "") -> Path | None:
    """Return the file of the verdict on this machine, and on a scene; None if there is no cache folder."""
    folder = cache_folder("trials")
    if folder is None:
        return None
    driver = _DRIVER.read_text(encoding="utf-8", errors="replace") if _DRIVER.exists() else ""
    about: list[Any] = [
        variant,
        reference,
        scene,
        __version__,
        metadata.version("mitsuba"),
        metadata.version("drjit"),
        driver,
        *(os.environ.get(name) for name in ("CUDA_VISIBLE_DEVICES", "DRJIT_LIBCUDA_PATH", "DRJIT_LIBLLVM_PATH")),
    ]
    return folder / f"{hashlib.sha256(json.dumps(about).encode()).hexdigest()}.json"
