"""Streams: context managers that write what a frame yields chunk by chunk: clouds, data sets, missed pulses, packets.

Most formats take a cloud piece by piece, a few need all of it; the caller hands on the pieces in either case.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..cloud.builder import CloudBuilder
from ..cloud.pixels import images
from ..cloud.point_cloud import PointCloud
from ..detection.outcomes import OUTCOME_TEXT
from ..detection.sampled_waveforms import check_pulses
from ..files.atomic import atomic_output, name_path_in_errors
from ..files.spool import Spool
from ..formats.cloud_columns import sensor_positions_m
from ..formats.packets.firings import Firings
from ..formats.packets.packet_encoder import PacketEncoder
from ..formats.packets.pcap import description_path, pcap_stream
from ..formats.packets.select_encoder import select_encoder
from ..labels.boxes import GatheredBoxes
from ..labels.kitti_dataset import frame_stream
from ..labels.osi_truth import gathered_truth
from ..labels.point_rows import OF_ROWS, DeviceRows
from ..maths.arrays import Numbers
from ..rendering.render_options import FrameOptions
from ..rendering.simulator import Simulator
from ..scene.scene import Scene
from ..sensor.sensor_model import Sensor
from .output_options import FEW_PULSES, Outputs
from .plan import Plan

Append = Callable[[PointCloud], None]


@contextmanager
def cloud_stream(plan: Plan, path: Path, points: int, *, bag: Append | None = None) -> Iterator[Append]:
    """Write the clouds that are appended in the block as one cloud.

    Args:
        points: upper bound of the points, for formats that need all of them before the first is written
        bag: function that appends the cloud to a file of several frames, or None
    """
    outputs, chosen = plan.outputs, plan.format
    options = {"ascii": True} if outputs.ascii else {}
    if chosen.stream is not None and outputs.colours is None:
        with chosen.stream(path, **options) as append:
            yield _truth_filter(outputs, append)
        return
    # The format, or the scale of colours, needs all points before the first is written: gather them.
    builder = CloudBuilder(capacity=points)
    yield _truth_filter(outputs, builder.add)
    whole = PointCloud(**builder.fields())
    if bag is None:
        whole.save(path, format=outputs.format, colour_by=outputs.colours, **options)
    else:
        bag(whole)


@contextmanager
def trace_stream(plan: Plan, path: Path, scene: Scene, append: Callable[..., None]) -> Iterator[Append]:
    """Gather the clouds that are appended in the block, with their boxes, for one message of an OSI trace.

    Args:
        append: function that appends a cloud and its ground truth to the trace
    """
    builder = CloudBuilder()
    with GatheredBoxes(path.parent, scene, whole=True) as gathered:

        def gather(cloud: PointCloud) -> None:
            gathered.append(cloud)
            _truth_filter(plan.outputs, lambda piece: builder.add(piece))(cloud)

        yield gather
        append(PointCloud(**builder.fields()), truth=gathered_truth(gathered, scene))


@contextmanager
def rerun_stream(outputs: Outputs, folder: Path, scene: Scene, append: Callable[..., None]) -> Iterator[Append]:
    """Gather the clouds that are appended in the block, with their boxes and range images, for one frame of a log.

    Args:
        folder: where points wait for their boxes
        append: function that appends a cloud to the log
    """
    builder = CloudBuilder()
    with GatheredBoxes(folder, scene) as gathered:

        def gather(cloud: PointCloud) -> None:
            gathered.append(cloud)
            _truth_filter(outputs, builder.add)(cloud)

        yield gather
        cloud, ring_images = PointCloud(**builder.fields()), {}
        # Beams of several sensors share no image.
        if len(cloud) and len(sensor_positions_m(cloud.metadata)) == 1:
            ring_images = {name: image for name, image in images(cloud).items() if name in LOGGED_IMAGES}
        append(cloud, boxes=gathered.boxes(), images=ring_images)


LOGGED_IMAGES = ("range", "intensity", "ambient")
"""Range images that a log of Rerun shows."""


@contextmanager
def dataset_stream(
    outputs: Outputs, label: str, number: int, scene: Scene, *, in_turn: Callable[[], object]
) -> Iterator[Append]:
    """Write the clouds that are appended in the block as a frame of a data set; ``in_turn`` as of `frame_stream`."""
    if outputs.dataset is None:
        raise ValueError("dataset: must be given, got none")
    # Labels are made of the ground truth, and the points of a data set have none: `Outputs.truth` changes nothing here.
    stream = partial(frame_stream, outputs.dataset, outputs.place / label, number, scene)
    with stream(all_around=outputs.all_around, in_turn=in_turn) as append:
        yield append


def row_reader(
    simulator: Simulator, frame: FrameOptions, dataset: str | None, *, deskew: bool, own_car: bool
) -> DeviceRows | None:
    """Reader of the rows of a frame's points, for data sets whose files need no more of them; None: clouds are read."""
    if dataset not in OF_ROWS:
        return None
    deskewing = simulator.deskewing(frame) if deskew else None
    return DeviceRows(simulator.scene, simulator.class_names, deskewing, dataset=dataset, own_car=own_car)


def _truth_filter(outputs: Outputs, append: Append) -> Append:
    """Wrap ``append`` so that it drops the ground truth, unless the outputs include it."""
    return append if outputs.truth else (lambda cloud: append(cloud.without_truth()))


def waveform_pulses(outputs: Outputs, sensor: Sensor) -> Sequence[int]:
    """Pulse numbers whose waveforms are written: `Outputs.pulses`, or FEW_PULSES evenly spaced.

    Raises:
        InputError: if a file, a key or a value cannot be understood
    """
    last = sensor.scanner.pulses - 1
    few = [last * number // (FEW_PULSES - 1) for number in range(FEW_PULSES)]
    chosen = check_pulses(outputs.pulses or few, sensor)
    return [int(pulse) for pulse in chosen]


@contextmanager
def missed_stream(path: str | os.PathLike[str], sensor: Sensor) -> Iterator[Callable[[Numbers, Numbers], None]]:
    """Write pulse numbers of one frame and their `Outcome`, appended in the block, as `numpy.savez` would.

    The file has pulse, reason, time_s (since the start of the frame), channel, azimuth_rad and elevation_rad, and
    reason_names by value.
    """
    with (
        atomic_output(path) as temporary,
        Spool(temporary.parent, [("pulse", np.int64), ("reason", np.uint8)]) as spool,
    ):
        # An archive needs the length of an array before its data: so number and reason are spooled to disk while the
        # frame runs. Most of its pulses may be missed.
        yield lambda pulse, reason: spool.append(pulse=pulse, reason=reason)
        with zipfile.ZipFile(temporary, "w") as archive:
            for name, of_rows in _arrays(sensor, _begin_s(sensor, spool)).items():
                _write_array(archive, name, len(spool), map(of_rows, spool.blocks()), of_rows(_none(spool)))
            names = np.array(["kept", *OUTCOME_TEXT.values()])
            _write_array(archive, "reason_names", len(names), [names], names)


def _arrays(sensor: Sensor, begin_s: float) -> dict[str, Callable[[Numbers], Numbers]]:
    """Name of an array in the file -> function of the spooled rows that computes it."""
    return {
        "pulse": lambda rows: rows["pulse"],
        "reason": lambda rows: rows["reason"],
        "time_s": lambda rows: sensor.scanner.time_s(rows["pulse"]) - begin_s,
        "channel": lambda rows: sensor.scanner.channel(rows["pulse"]),
        "azimuth_rad": lambda rows: sensor.scanner.angles(rows["pulse"])[0],
        "elevation_rad": lambda rows: sensor.scanner.angles(rows["pulse"])[1],
    }


def _none(spool: Spool) -> Numbers:
    return np.zeros(0, spool.dtype)


def _begin_s(sensor: Sensor, spool: Spool) -> float:
    """Time at which the frame of these pulses began, by the scanner's clock [s]."""
    # Pulse numbers go on from frame to frame: the first pulse of this frame is a multiple of a frame's.
    first = next(spool.blocks(), _none(spool))["pulse"][:1] // sensor.scanner.pulses * sensor.scanner.pulses
    return float(sensor.scanner.time_s(first).sum())


def _write_array(archive: zipfile.ZipFile, name: str, rows: int, blocks: Any, like: Numbers) -> None:
    """Write an array of this many rows to an archive, block by block; ``like`` has its type."""
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        # The head of a .npy needs the number of rows before they are written, which np.savez would gather first.
        head = {"descr": np.lib.format.dtype_to_descr(like.dtype), "fortran_order": False, "shape": (rows,)}
        np.lib.format.write_array_header_1_0(file, head)
        for block in blocks:
            file.write(np.ascontiguousarray(block).view(np.uint8).data)


@dataclass(frozen=True, slots=True)
class Capture:
    """Open file of one sensor's packets.

    Attributes:
        take: function that appends a frame
        needs_ambient: whether packets hold the background of every pulse
    """

    take: Callable[[Firings], None]
    needs_ambient: bool


def packet_encoders(sensors: Mapping[str, Sensor], profile: str) -> dict[str, PacketEncoder]:
    """Label -> encoder of the sensor's packets.

    Raises:
        InputError: for a sensor without a packet format
    """
    return {label: select_encoder(sensor, profile) for label, sensor in sensors.items()}


def description_files(path: Path, encoder: PacketEncoder) -> dict[str, Path]:
    """Key -> file that describes the packets, such as an Ouster's JSON; empty where the format has none."""
    return {} if encoder.description is None else {"metadata": description_path(path, encoder.description[1])}


@contextmanager
def captures(paths: Mapping[str, Path], encoders: Mapping[str, PacketEncoder]) -> Iterator[Mapping[str, Capture]]:
    """Open a file of packets for each label; the files are complete when the block ends."""
    with ExitStack() as opened:
        yield {
            label: Capture(
                name_path_in_errors(path, opened.enter_context(pcap_stream(path, encoders[label]))),
                encoders[label].needs_ambient,
            )
            for label, path in paths.items()
        }
