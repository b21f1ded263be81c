"""Options check themselves, say what is wrong in one line, and are declared once."""

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.mistakes import calls

from lidarscene.batch.job_file import JobFile
from lidarscene.cli import terminal
from lidarscene.errors import OptionError
from lidarscene.outputs.output_options import Outputs
from lidarscene.rendering import render_options
from lidarscene.rendering.render_options import FrameOptions, Keywords, Observers, TraceOptions
from lidarscene.studies.ranging.conditions import Conditions

SEEDS, COUNTS = "seed | whole number | 0 | 4294967295", "whole number | 1 | 1024"

test_wrong_values = calls(
    (lambda: FrameOptions(seed=-1), f"{SEEDS} | -1"),
    (lambda: FrameOptions(seed=2**32), f"{SEEDS} | 4294967296"),
    (lambda: FrameOptions(seed=1.0), f"{SEEDS} | 1.0"),
    (lambda: FrameOptions(seed=True), f"{SEEDS} | True"),
    (lambda: FrameOptions(number=-1), "number: | whole number | 0 | 2147483647 | -1"),
    (lambda: FrameOptions(chunk=0), "chunk | whole number | 1 | 2147483647 | 0"),
    (lambda: FrameOptions(begin_s=float("nan")), "begin_s | finite number | seconds | nan"),
    (lambda: FrameOptions(begin_s="1"), "begin_s | finite number | seconds | '1'"),
    (lambda: FrameOptions(pose=(1, 2)), "pose | Pose | x, y, z in metres | yaw, pitch, roll in degrees | (1, 2)"),
    (lambda: FrameOptions(coordinates="car"), "coordinates | 'world' | 'vehicle' | 'sensor' | 'car'"),
    (lambda: TraceOptions(rays=0), f"rays | {COUNTS} | 0"),
    (lambda: TraceOptions(rays=None), f"rays | {COUNTS} | None"),
    (lambda: TraceOptions(interactions=-1), "interactions | whole number | 0 | 8 | -1"),
    (lambda: TraceOptions(interactions=9), "interactions | whole number | 0 | 8 | 9"),
    (lambda: TraceOptions(background_rays=0), f"background_rays | {COUNTS} | 0"),
    (lambda: TraceOptions(vectors=1), "vectors | True or False | 1"),
    (lambda: TraceOptions(vectors="normal"), "vectors | True or False | 'normal'"),
    (lambda: Keywords({"frame": "sensor"}).take(FrameOptions), "frame | FrameOptions | 'sensor' | coordinates"),
    (lambda: Observers(missed=3), "missed | a function | 3"),
)
test_outputs_that_do_not_go_together = calls(
    (lambda: Outputs("a.ply", format="docx"), "format: | ply, pcd | 'docx'"),
    (lambda: Outputs("a.ply", labels="boxes"), "labels | kitti, nuscenes, semantickitti, osi | 'boxes'"),
    (lambda: Outputs("a.ply", dataset="waymo"), "dataset | kitti, semantickitti | 'waymo'"),
    (lambda: Outputs("a.ply", dataset="kitti", labels="osi"), "labels | data set | dataset"),
    (lambda: Outputs("a.ply", dataset="kitti", format="ply"), "format | data set | dataset"),
    (lambda: Outputs("a.ply", dataset="kitti", merge=True), "dataset | merge"),
    (lambda: Outputs("a.ply", dataset="kitti", ascii=True), "dataset | ascii"),
    (lambda: Outputs("a.ply", merge=True, missed="m.npz"), "missed | single sensors | merge"),
    (lambda: Outputs("a.ply", picture="p.gif"), "picture p.gif | .png | .svg"),
    (lambda: Outputs("a.ply", missed="{0}.csv"), "missed {0}.csv | .npz"),
    (lambda: Outputs("a.ply", pulses=[3]), "pulses | waveforms"),
    (lambda: Outputs("a.ply", ascii="no"), "ascii | True or False | 'no'"),
)


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


def test_numbers_of_numpy_are_those_of_python() -> None:
    """Rationale: one of few bytes overflowed in number x pulses of a frame."""
    options = FrameOptions(seed=np.uint32(3), number=np.uint8(200), begin_s=np.float32(0.5), chunk=np.int16(7))
    found = [options.seed, options.number, options.begin_s, options.chunk, TraceOptions(rays=np.uint8(4)).rays]
    assert list(map(repr, found)) == ["3", "200", "0.5", "7", "4"]
    assert repr(Conditions(illuminance_klux=np.float16(100.0)).illuminance_klux) == "100.0"


def test_a_job_has_the_defaults_of_the_library() -> None:
    job = JobFile(scenes=("a.toml",))
    assert job.trace_options() == TraceOptions()
    job_frame, default_frame = job.frame_options(0, 0), FrameOptions()
    assert dataclasses.astuple(job_frame) == dataclasses.astuple(default_frame)
