"""The command `stream`: a sensor's packets over UDP while the scene moves, as the real sensor sends them."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..formats.registry import PACKETS
from ..rendering.render_options import FrameOptions, TraceOptions
from .options import CommandOptions, add_options, options_from, scene_changes
from .terminal import Answer, is_quiet, print_text, tell
from .words import number

STREAM_HELP = """\
examples:
  lidarscene stream drive --sensor vlp-16 --udp 127.0.0.1:2368
  lidarscene stream drive --sensor os1-128 --udp 127.0.0.1:7502 --metadata os1.json --rate 2 --frames 20
"""


def add_stream(commands: Any) -> None:
    """Add `stream`."""
    stream = commands.add_parser(
        "stream",
        help="send the packets of a sensor over UDP in real time",
        epilog=STREAM_HELP,
        description="Simulate a lidar and send packets in the maker's format while the scene moves, until Ctrl-C. "
        "Drivers, viewers and recorders of the real sensor can read them. Late frames are reported and "
        "sent at up to twice the normal pace.",
    )
    stream.add_argument("scene", metavar="SCENE", type=Path, help="scene file, mesh or name of a scene, as for render")
    group = stream.add_argument_group("simulation")
    add_options(group, CommandOptions, "sensor", "overrides", "scene_overrides", "ego_mesh")
    add_options(group, FrameOptions, "pose", "begin_s", "seed")
    add_options(group, TraceOptions, "rays", "interactions")
    group = stream.add_argument_group("packets")
    add = group.add_argument
    add(
        "--udp",
        metavar="HOST:PORT",
        type=_address,
        required=True,
        help="destination; drivers of Velodyne listen at port 2368, and those of Ouster at 7502",
    )
    add(
        "--rate",
        metavar="HZ",
        type=_rate,
        help="frames per second (default: that of the sensor, which is real time); a lower rate is slow motion",
    )
    add_options(group, CommandOptions, frames="the stream then ends (default: until Ctrl-C)")
    add(
        "--format",
        choices=PACKETS,
        default="pcap",
        metavar="NAME",
        help=f"profile of an Ouster's packets, as in render: {', '.join(PACKETS)}",
    )
    add("--metadata", metavar="F.json", type=Path, help="write the metadata that readers of an Ouster need")
    stream.set_defaults(run=run_stream)


def run_stream(arguments: argparse.Namespace) -> Answer:
    """Run `stream`."""
    from ..files.atomic import put_text
    from ..formats.packets.select_encoder import select_encoder
    from ..outputs.live.sending import render_firings, send_frames, udp
    from ..rendering.simulator import Simulator
    from ..rendering.surroundings import simulator_surroundings, warn_of_surroundings
    from ..scene.scene_file import changed_scene
    from ..sensor.sensor_file import load_sensor

    host, port = arguments.udp
    frame, trace = options_from(FrameOptions, arguments), options_from(TraceOptions, arguments)
    with udp(host, port) as send:
        scene = changed_scene(arguments.scene, scene_changes(arguments))
        sensor = load_sensor(arguments.sensor or scene.sensor_name, overrides=arguments.overrides)
        encoder = select_encoder(sensor, PACKETS[arguments.format].profile or "")
        if arguments.metadata is not None:
            if encoder.description is None:
                raise InputError(f"--metadata: sensor '{sensor.name}' has none; an Ouster has")
            ports = {"udp_port_lidar": port, "udp_port_imu": port + 1}
            put_text(arguments.metadata, json.dumps(json.loads(encoder.description[0]) | ports, indent=1))
        simulator = Simulator(scene, sensor, trace, pose=frame.pose)
        warn_of_surroundings([simulator_surroundings(simulator, frame, arguments.frames)])
        if arguments.frames is not None:
            simulator.check_frames(range(arguments.frames), begin_s=frame.begin_s)
        if not arguments.json and not is_quiet():
            print_text(f"{sensor.name} in {scene.name} to {host}:{port} (Ctrl-C ends)")
        frames = render_firings(simulator, frame, needs_ambient=encoder.needs_ambient, frames=arguments.frames)
        frame_s = sensor.scanner.frame_s
        sent = send_frames(frames, encoder, send, frame_s=frame_s, rate_hz=arguments.rate, report=_print_line)
        return Answer(sent.as_text(), numbers=asdict(sent))


def _print_line(line: str) -> None:
    if not is_quiet():
        tell(f"lidarscene: {line}")


def _address(text: str) -> tuple[str, int]:
    """Parse a host and a port (an argparse type)."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise argparse.ArgumentTypeError(f"must be a host and a port, such as 127.0.0.1:2368, got {text}")
    return host.strip("[]"), int(port)


def _rate(text: str) -> float:
    """Parse a number of frames in a second (an argparse type)."""
    value = number(text)
    if not 1e-3 <= value <= 1e3:
        raise argparse.ArgumentTypeError(f"must be from 0.001 to 1000 frames in a second, got {text}")
    return value
