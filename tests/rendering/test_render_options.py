"""Options check themselves, say what is wrong in one line, and are declared once."""

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lidarscene.batch.job_file import JobFile
from lidarscene.cli import terminal
from lidarscene.errors import InputError, OptionError
from lidarscene.maths.pose import Pose
from lidarscene.outputs.output_options import Outputs
from lidarscene.rendering import render_options
from lidarscene.rendering.render_options import FrameOptions, Keywords, Observers, TraceOptions

POSE = "a Pose, or x, y, z in metres with or without yaw, pitch, roll in degrees"


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (FrameOptions, {"seed": -1}, "seed: must be a whole number from 0 to 4294967295, got -1"),
        (FrameOptions, {"seed": 1.0}, "seed: must be a whole number from 0 to 4294967295, got 1.0"),
        (FrameOptions, {"seed": True}, "seed: must be a whole number from 0 to 4294967295, got True"),
        (FrameOptions, {"number": -1}, "number: must be a whole number from 0 to 2147483647, got -1"),
        (FrameOptions, {"chunk": 0}, "chunk: must be a whole number from 1 to 2147483647, got 0"),
        (FrameOptions, {"begin_s": float("nan")}, "begin_s: must be a finite number of seconds, got nan"),
        (FrameOptions, {"begin_s": "1"}, "begin_s: must be a finite number of seconds, got '1'"),
        (FrameOptions, {"pose": (1, 2)}, f"pose: must be {POSE}, got (1, 2)"),
        (FrameOptions, {"coordinates": "car"}, "coordinates: must be 'world' or 'vehicle' or 'sensor', got 'car'"),
        (TraceOptions, {"rays": 0}, "rays: must be a whole number from 1 to 1024, got 0"),
        (TraceOptions, {"interactions": 9}, "interactions: must be a whole number from 0 to 8, got 9"),
        (TraceOptions, {"background_rays": 0}, "background_rays: must be a whole number from 1 to 1024, got 0"),
        (TraceOptions, {"rays": None}, "rays: must be a whole number from 1 to 1024, got None"),
        (TraceOptions, {"vectors": 1}, "vectors: must be True or False, got 1"),
        (Observers, {"missed": 3}, "missed: must be a function, got 3"),
    ],
)
def test_a_wrong_value_is_one_line(kind: Any, values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        kind(**values)
    assert str(caught.value) == message


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"format": "docx"}, "format: must be one of ply, pcd, "),
        ({"labels": "boxes"}, "labels: must be one of kitti, nuscenes, semantickitti, osi, got 'boxes'"),
        ({"dataset": "waymo"}, "dataset: must be one of kitti, semantickitti, got 'waymo'"),
        ({"dataset": "kitti", "labels": "osi"}, "labels: a data set has its own, leave it out with dataset"),
        ({"dataset": "kitti", "format": "ply"}, "format: a data set has its own, leave it out with dataset"),
        ({"dataset": "kitti", "merge": True}, "dataset: goes without merge"),
        ({"dataset": "kitti", "ascii": True}, "dataset: goes without ascii"),
        ({"merge": True, "missed": "m.npz"}, "missed: goes with the clouds of single sensors, not with merge"),
        ({"picture": "p.gif"}, "picture p.gif: the name must end in .png or .svg"),
        ({"missed": "{0}.csv"}, "missed {0}.csv: the name must end in .npz"),
        ({"pulses": [3]}, "pulses goes with waveforms"),
        ({"ascii": "no"}, "ascii: must be True or False, got 'no'"),
    ],
)
def test_outputs_that_do_not_go_together(files: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        Outputs("a.ply", **files)
    assert str(caught.value).startswith(message)


def test_the_command_line_names_its_own_options() -> None:
    """Also where a value looks like the name of an option."""
    error = OptionError("{path} {0}: must be a folder with {begin_s} and {no_such}", Path("{seed}.ply"))
    assert str(error) == "path {seed}.ply: must be a folder with begin_s and no_such"
    assert terminal.error_text(error) == "--output {seed}.ply: must be a folder with --begin and --no-such"
    unpickled = pickle.loads(pickle.dumps(error))
    assert (str(unpickled), terminal.error_text(unpickled)) == (str(error), terminal.error_text(error))


@pytest.mark.parametrize(
    ("kind", "keywords"),
    [
        (TraceOptions, render_options.TraceKeywords),
        (FrameOptions, render_options.FrameKeywords),
        (Observers, render_options.ObserverKeywords),
    ],
)
def test_keywords_are_the_fields(kind: Any, keywords: Any) -> None:
    """Rationale: a TypedDict cannot be made of a dataclass, so that type checkers need the names twice.

    A pose is given as a `Pose` or as numbers, and kept as a `Pose`.
    """
    kept_as = {"Pose | None": "Placed | None"}
    fields = {field.name: kept_as.get(field.type, field.type) for field in dataclasses.fields(kind)}
    assert fields == {name: annotation.__forward_arg__ for name, annotation in keywords.__annotations__.items()}


def test_loose_keywords_change_what_is_given() -> None:
    keywords = Keywords({"seed": 3, "rays": 2, "frame": FrameOptions(seed=1, number=4)})
    frame, trace = keywords.take(FrameOptions), keywords.take(TraceOptions, TraceOptions(interactions=0))
    keywords.end()
    assert (frame.seed, frame.number) == (3, 4)
    assert trace == TraceOptions(rays=2, interactions=0)


def test_an_unknown_keyword_is_one_line() -> None:
    keywords = Keywords({"sed": 3})
    keywords.take(TraceOptions)
    with pytest.raises(
        InputError, match=r"^unknown option 'sed'; known here: rays, interactions, background_rays, vectors$"
    ):
        keywords.end()


def test_a_coordinate_system_is_no_frame() -> None:
    with pytest.raises(InputError, match=r"^frame: must be FrameOptions, got 'sensor'; the coordinate system is coo"):
        Keywords({"frame": "sensor"}).take(FrameOptions)


def test_whole_numbers_of_numpy_are_whole_numbers() -> None:
    assert FrameOptions(seed=np.uint32(3), begin_s=np.float64(0.5)).seed == 3
    assert FrameOptions(begin_s=1, pose=Pose()).begin_s == 1


def test_a_job_has_the_defaults_of_the_library() -> None:
    job = JobFile(scenes=("a.toml",))
    assert job.trace_options() == TraceOptions()
    job_frame, default_frame = job.frame_options(0, 0), FrameOptions()
    assert dataclasses.astuple(job_frame) == dataclasses.astuple(default_frame)
