"""The command `stream`: a sensor's packets over UDP while the scene moves, as the real sensor sends them."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..formats.registry import PACKETS
from ..outputs.output_options import FRAMES
from ..rendering.render_options import MEETINGS, RAYS, SEEDS, FrameOptions, TraceOptions
from .words import number as seconds
from .words import pose, whole_number

STREAM_HELP = """\
examples:
  lidarscene stream drive --sensor vlp-16 --udp 127.0.0.1:2368
  lidarscene stream drive --sensor os1-128 --udp 127.0.0.1:7502 --metadata os1.json --rate 2 --frames 20
"""

TRACE, FRAME = TraceOptions(), FrameOptions()


def add_stream(commands: Any) -> None:
    """Add `stream`."""
    stream = commands.add_parser(
        "stream",
        help="packets over UDP in real time, as the sensor itself sends them",
        epilog=STREAM_HELP,
        description="Simulate a lidar and send its maker's packets while the scene moves, until Ctrl-C. Drivers, "
        "viewers and recorders of the real sensor read them. Late frames are reported, and go at up to twice the "
        "pace.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    stream.add_argument("scene", metavar="SCENE", type=Path, help="scene file, mesh or a scene's name, as for render")
    add = stream.add_argument_group("what is simulated").add_argument
    add("--sensor", metavar="NAME|FILE", help="catalogue name or sensor file (default: the scene's)")
    add(
        "--set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="overrides",
        help="change a value of the sensor file, such as scanner.rotation_hz=-20; may be repeated",
    )
    add(
        "--scene-set",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        dest="scene_overrides",
        help="change a value of the scene file",
    )
    add("--pose", type=pose, metavar="X,Y,Z[,YAW,PITCH,ROLL]", help="where the sensor stands, metres and degrees")
    add(
        "--begin",
        metavar="S",
        type=seconds,
        default=FRAME.begin_s,
        help="when the first frame begins, by the clock of the scene's motions (default 0)",
    )
    add("--seed", metavar="N", type=whole_number(SEEDS), default=FRAME.seed, help="of the noise (default 0)")
    add("--rays", metavar="N", type=whole_number(RAYS), default=TRACE.rays, help="of each pulse (default 1)")
    add(
        "--interactions",
        metavar="N",
        type=whole_number(MEETINGS),
        default=TRACE.interactions,
        help="panes, mirrors and gaps that a beam may meet (default 3)",
    )
    add = stream.add_argument_group("what is sent").add_argument
    add(
        "--udp",
        metavar="HOST:PORT",
        type=_address,
        required=True,
        help="where to; drivers of Velodyne listen at port 2368, of Ouster at 7502",
    )
    add(
        "--rate",
        metavar="HZ",
        type=_rate,
        help="frames in a second (default: as many as the sensor turns, real time); less is slow motion",
    )
    add("--frames", metavar="N", type=whole_number(FRAMES), help="end after so many (default: Ctrl-C ends)")
    add(
        "--format",
        choices=PACKETS,
        default="pcap",
        metavar="NAME",
        help=f"profile of an Ouster's packets, as render has them: {', '.join(PACKETS)}",
    )
    add("--metadata", metavar="F.json", type=Path, help="write what an Ouster's readers need beside the packets")
    stream.set_defaults(run=stream_text)


def stream_text(arguments: argparse.Namespace) -> str:
    """Run `stream`; returns the text to print at its end."""
    from ..files.atomic import put_text
    from ..formats.packets.select_encoder import select_encoder
    from ..outputs.live.sending import render_firings, send_frames, udp
    from ..rendering.simulator import Simulator
    from ..scene.scene_file import load_scene
    from ..sensor.sensor_file import load_sensor

    host, port = arguments.udp
    frame = FrameOptions(seed=arguments.seed, begin_s=arguments.begin, pose=arguments.pose)
    trace = TraceOptions(rays=arguments.rays, interactions=arguments.interactions)
    with udp(host, port) as send:
        scene = load_scene(arguments.scene, overrides=arguments.scene_overrides)
        sensor = load_sensor(arguments.sensor or scene.sensor_name, overrides=arguments.overrides)
        encoder = select_encoder(sensor, PACKETS[arguments.format].profile or "")
        if arguments.metadata is not None:
            if encoder.description is None:
                raise InputError(f"--metadata: sensor '{sensor.name}' has none; an Ouster has")
            ports = {"udp_port_lidar": port, "udp_port_imu": port + 1}
            put_text(arguments.metadata, json.dumps(json.loads(encoder.description[0]) | ports, indent=1))
        simulator = Simulator(scene, sensor, trace, pose=arguments.pose)
        if arguments.frames is not None:
            simulator.check_frames(range(arguments.frames), begin_s=arguments.begin)
        sys.stdout.write(f"{sensor.name} in {scene.name} to {host}:{port} (Ctrl-C ends)\n")
        sys.stdout.flush()
        frames = render_firings(simulator, frame, needs_ambient=encoder.needs_ambient, frames=arguments.frames)
        frame_s = sensor.scanner.frame_s
        return send_frames(frames, encoder, send, frame_s=frame_s, rate_hz=arguments.rate, report=_print_line).as_text()


def _print_line(line: str) -> None:
    sys.stderr.write(f"lidarscene: {line}\n")
    sys.stderr.flush()


def _address(text: str) -> tuple[str, int]:
    """Parse a host and a port (an argparse type)."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise argparse.ArgumentTypeError(f"must be a host and a port, such as 127.0.0.1:2368, got {text}")
    return host.strip("[]"), int(port)


def _rate(text: str) -> float:
    """Parse a number of frames in a second (an argparse type)."""
    value = seconds(text)
    if not 1e-3 <= value <= 1e3:
        raise argparse.ArgumentTypeError(f"must be from 0.001 to 1000 frames in a second, got {text}")
    return value
