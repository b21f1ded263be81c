"""Arguments are made of the fields that declare options, and options of arguments."""

import argparse
import dataclasses
from pathlib import Path

import pytest

from lidarscene.cli import main
from lidarscene.cli.options import CommandOptions, StudyOptions, add_options, flag_of, options_from
from lidarscene.outputs.output_options import Outputs
from lidarscene.rendering.option_fields import options_of
from lidarscene.rendering.render_options import FrameOptions, TraceOptions
from lidarscene.studies.ranging.conditions import Conditions

COMMANDS = ("render", "stream", "batch", "range", "paper", "fov", "compare", "view", "catalog", "fit", "twin", "sensor")
KINDS = (TraceOptions, FrameOptions, Outputs, Conditions, StudyOptions)


def arguments_of(command: str) -> list[argparse.Action]:
    (chosen,) = [a for a in main._parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return list(chosen.choices[command]._actions)


def parse(*words: str) -> argparse.Namespace:
    return main._parser().parse_args(words)


@pytest.mark.parametrize("command", COMMANDS)
def test_one_flag_has_one_help(command: str) -> None:
    """Up to a remark at its end; an option of another meaning takes another value: `compare --illuminance-klux`."""
    flags = {flag_of(name): entry for kind in KINDS for name, (_, entry) in options_of(kind).items()}
    if command in ("render", "stream", "view"):
        flags["--set"] = options_of(CommandOptions)["overrides"][1]
    for action in arguments_of(command):
        for flag in set(action.option_strings) & set(flags) - {"--format"}:  # of packets alone in `stream`
            if action.metavar == flags[flag].metavar:
                assert (action.help or "").startswith((flags[flag].help, f"without {flags[flag].help}")), flag


def test_without_arguments_the_options_have_their_defaults() -> None:
    arguments = parse("render", "car", "-o", "a.ply")
    assert options_from(TraceOptions, arguments) == TraceOptions()
    assert options_from(Outputs, arguments) == Outputs(Path("a.ply"))
    for command in ("render car -o a.ply", "compare car -o out", "stream car --udp localhost:1", "view car"):
        frame = options_from(FrameOptions, parse(*command.split()))
        assert dataclasses.astuple(frame) == dataclasses.astuple(FrameOptions()), command


def test_arguments_become_fields() -> None:
    words = "--no-truth --deskew --keep-missed m.npz --waveforms w.npz --pulses 0,3-4 --begin 2.5 --chunk 64 --rays 4"
    arguments = parse("render", "car", "-o", "a.ply", *words.split(), "--frame", "sensor", "--pose", "1,2,3")
    assert options_from(Outputs, arguments) == Outputs(
        Path("a.ply"), truth=False, deskew=True, missed=Path("m.npz"), waveforms=Path("w.npz"), pulses=(0, 3, 4)
    )
    frame = options_from(FrameOptions, arguments)
    assert (frame.begin_s, frame.chunk, frame.coordinates) == (2.5, 64, "sensor")
    assert frame.pose is not None
    assert frame.pose.position_m.tolist() == [1.0, 2.0, 3.0]
    assert options_from(TraceOptions, arguments) == TraceOptions(rays=4)


@pytest.mark.parametrize("command", ["render car -o a.ply", "compare car -o out"])
def test_a_chunk_counts_rays_in_every_command(command: str) -> None:
    assert options_from(FrameOptions, parse(*command.split(), "--chunk", "700")).chunk == 700
    (chunk,) = [action for action in arguments_of(command.split()[0]) if "--chunk" in action.option_strings]
    assert (chunk.help or "").startswith("rays per batch; limits memory, not the result")


def test_a_remark_ends_the_help() -> None:
    parser = argparse.ArgumentParser()
    add_options(parser, FrameOptions, "chunk", seed="of a live scene")
    helps = {action.dest: action.help for action in parser._actions}
    assert helps["chunk"] == options_of(FrameOptions)["chunk"][1].help
    assert helps["seed"] == options_of(FrameOptions)["seed"][1].help + "; of a live scene"
