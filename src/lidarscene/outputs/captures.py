"""Captures: the frames of a run, pulse by pulse, into one file of packets for each sensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..files.atomic import named
from ..formats.packets.firings import Firings
from ..formats.packets.packet_encoder import PacketEncoder
from ..formats.packets.pcap import capture, description_path
from ..formats.packets.select_encoder import select_encoder
from ..sensor.model import Sensor


@dataclass(frozen=True, slots=True)
class Capture:
    """One sensor's file, while it is open.

    take           appends a frame
    needs_ambient  whether it has the background of every pulse
    """

    take: Callable[[Firings], None]
    needs_ambient: bool


def makers(sensors: Mapping[str, Sensor], profile: str) -> dict[str, PacketEncoder]:
    """By label. Raises InputError for a sensor without a format of packets."""
    return {label: select_encoder(sensor, profile) for label, sensor in sensors.items()}


def captured_files(path: Path, maker: PacketEncoder) -> dict[str, Path]:
    """What is written beside the packets, by what it is."""
    return {} if maker.description is None else {"metadata": description_path(path, maker.description[1])}


@contextmanager
def captures(paths: Mapping[str, Path], makers: Mapping[str, PacketEncoder]) -> Iterator[Mapping[str, Capture]]:
    """Open a file for each label; they are there when the block ends."""
    with ExitStack() as opened:
        yield {
            label: Capture(named(path, opened.enter_context(capture(path, makers[label]))), makers[label].needs_ambient)
            for label, path in paths.items()
        }
