"""The command `view`: clouds and scenes in the browser.

The page is served on this machine, or saved as one file that needs no server.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import threading
import webbrowser
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import catalog
from ..errors import InputError
from ..files.inputs import by_numbers
from ..rendering.option_fields import Whole
from ..rendering.render_options import FrameOptions
from .options import CommandOptions, add_options, flag_of, options_from
from .recordings.recording_options import add_recording, with_progress
from .terminal import Answer, explained, print_text
from .words import whole_number

if TYPE_CHECKING:
    from ..view.page_sources import Source

VIEW_HELP = """\
examples:
  lidarscene view car
  lidarscene view car --sensor table1-sipm --set laser.peak_power_w=75
  lidarscene view out/car.ply car
  lidarscene view out/frames --save out/frames.html
  lidarscene view os1.pcap --metadata os1.json --frame 3
"""

COMPILING = "reading and compiling; this takes some seconds"
SCENES = (".toml", ".xml", ".glb", ".gltf", ".obj", ".off", ".stl")


def add_view(commands: Any) -> None:
    """Add `view`."""
    view = commands.add_parser(
        "view",
        help="show clouds or a scene in the browser",
        epilog=VIEW_HELP,
        description="Show clouds in the browser, over a scene if you name one, or a scene alone, which renders live as "
        "you move its controls. The page is served to this machine only, until Ctrl-C, or written to a "
        "file that you can send to others.",
    )
    view.add_argument(
        "paths",
        metavar="CLOUD|DIR|SCENE|REC",
        nargs="+",
        type=Path,
        help="clouds, or a folder of clouds, are shown as frames; a scene alone renders live; a recording of a "
        "real lidar must be alone",
    )
    group = view.add_argument_group("content")
    add_options(group, CommandOptions, sensor="for clouds, the sensor that they name")
    add_options(group, CommandOptions, "overrides")
    add_options(group, FrameOptions, "pose", "seed")
    add_recording(view)
    add = view.add_argument_group("page").add_argument
    add(
        "--save",
        metavar="F.html",
        type=Path,
        help="write the page as one file that needs no server, instead of serving it",
    )
    add(
        "--port",
        metavar="N",
        type=whole_number(Whole(0, 65535)),
        default=0,
        help="port of the page (default: any free port)",
    )
    add("--no-browser", action="store_true", help="print the address of the page, and open no browser")
    view.set_defaults(run=run_view)


def run_view(arguments: argparse.Namespace) -> Answer:
    """Run `view`."""
    from ..view.html_page import save
    from ..view.serve import Server

    if arguments.save is not None:
        _check_save(arguments.save)
        with contextlib.ExitStack() as opened:
            with explained(COMPILING):
                source = _source(arguments, opened)
            save(source, arguments.save)
        return Answer(f"wrote {arguments.save} ({arguments.save.stat().st_size / 1e6:.1f} MB)")
    with contextlib.ExitStack() as opened, Server(arguments.port) as server:
        # The port is opened before the scene is loaded: a busy one is reported at once.
        with explained(COMPILING):
            source = _source(arguments, opened)
        print_text(f"{source.title}: {server.url} (Ctrl-C ends)")
        if not arguments.no_browser:
            # In a thread, because a browser in the terminal would block, waiting for the page before it is served.
            threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            server.serve(source)
    return Answer("ended")


def _source(arguments: argparse.Namespace, opened: contextlib.ExitStack) -> Source:
    """What the page shows; ``opened`` closes a recording."""
    from ..recordings.opening import is_recording
    from ..scene.scene_file import changed_scene
    from ..view.page_sources import Clouds, Live

    recorded = [path for path in arguments.paths if is_recording(path)]
    if recorded:
        return _recording_source(arguments, recorded[0], opened)
    for option in ("frame", "metadata"):
        if getattr(arguments, option) is not None:
            raise InputError(f"--{option}: needs a recording, got {arguments.paths[0]}")
    if arguments.sensor_index:
        raise InputError(f"--sensor-index: needs a recording, got {arguments.paths[0]}")
    scenes = [path for path in arguments.paths if _is_scene(path)]
    if len(scenes) > 1:
        raise InputError(f"view: must be one scene, got {scenes[0]} and {scenes[1]}")
    clouds = list_clouds([path for path in arguments.paths if path not in scenes])
    scene = changed_scene(scenes[0]) if scenes else None
    if scene is not None and not clouds:
        frame = options_from(FrameOptions, arguments)
        name = str(scenes[0])
        return Live(scene, sensor=arguments.sensor, overrides=arguments.overrides, frame=frame, scene_argument=name)
    if arguments.pose is not None:
        raise InputError("--pose: needs a scene that is rendered, got clouds")
    return Clouds(clouds, scene=scene, sensor=arguments.sensor, overrides=arguments.overrides)


def _is_scene(path: Path) -> bool:
    """Whether a path is a scene: by its suffix, or as a bare name; but a folder of clouds, or a PLY file, is clouds."""
    from ..scene.meshes.reading import NOT_READ

    if os.path.isdir(path):
        return path.name in catalog.names("scenes") and catalog.is_bare(str(path)) and not _clouds_of(path)
    return path.suffix.lower() in NOT_READ or path.suffix.lower() in SCENES or not (path.suffix or os.path.exists(path))


def _recording_source(arguments: argparse.Namespace, path: Path, opened: contextlib.ExitStack) -> Source:
    from ..recordings.opening import open_recording
    from ..view.page_sources import RecordingFrames

    if len(arguments.paths) > 1:
        raise InputError(f"view: a recording must come alone, got {len(arguments.paths)} paths with {path}")
    for option in ("sensor", "overrides", "pose"):
        if getattr(arguments, option):
            raise InputError(f"{flag_of(option)}: needs a scene or clouds, got the recording {path}")
    recording = open_recording(path, arguments.metadata, sensor_index=arguments.sensor_index)
    opened.enter_context(recording)
    return RecordingFrames(with_progress(recording) if arguments.save else recording, frame=arguments.frame)


def list_clouds(paths: Sequence[Path]) -> list[Path]:
    """List cloud files in the order given; those of a folder, or of its folders, go by the numbers in their names."""
    from ..formats.registry import readable_suffixes

    files: list[Path] = []
    for path in paths:
        if not os.path.isdir(path):
            files.append(path)
            continue
        inside = _clouds_of(path)
        if not inside:
            expected = ", ".join(sorted(readable_suffixes()))
            raise InputError(f"{path}: must hold files that end in {expected}, got none")
        files += sorted(inside, key=lambda file: (by_numbers(file.parent), by_numbers(file)))
    return files


def _clouds_of(folder: Path) -> list[Path]:
    """Clouds in a folder, else in its folders: a rig, a job or a data set has them there."""
    return _clouds_in(folder.iterdir()) or _clouds_in(folder.rglob("*"))


def _clouds_in(files: Iterable[Path]) -> list[Path]:
    from ..formats.registry import readable_suffixes

    suffixes = readable_suffixes()
    return [file for file in files if file.suffix.lower() in suffixes and file.name[0] != "." and file.is_file()]


def _check_save(path: Path) -> None:
    """Raise an error for a page that could not be written, before any work goes into it."""
    from ..files.atomic import require_writable

    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--save {path}: the name must end in .html")
    require_writable(path)
