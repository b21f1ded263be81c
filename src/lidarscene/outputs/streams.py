"""Streams: clouds that come in pieces in; a file in a format, or a frame of a data set, out.

Most formats take a cloud piece by piece, a few need all of it. Who hands on the pieces need not know which.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ..cloud.builder import CloudBuilder
from ..cloud.point_cloud import PointCloud
from ..detection.sampled_waveforms import check_pulses
from ..labels.kitti_dataset import frame_stream
from ..scene.scene import Scene
from ..sensor.model import Sensor
from .options import FEW_PULSES, Outputs
from .plan import Plan

Append = Callable[[PointCloud], None]


@contextmanager
def cloud_stream(plan: Plan, path: Path, points: int, *, bag: Append | None = None) -> Iterator[Append]:
    """Write the clouds that are appended in the block as one; together, of so many points at most, where the format
    needs them so.

    bag  takes it, if it is a frame of a file of several
    """
    outputs, chosen = plan.outputs, plan.format
    options = {"ascii": True} if outputs.ascii else {}
    if chosen.stream is not None and outputs.colours is None:
        with chosen.stream(path, **options) as append:
            yield _kept(outputs, append)
        return
    # A format, or a scale of colours, that must know all points before the first is written: gather them.
    builder = CloudBuilder(capacity=points)
    yield _kept(outputs, builder.add)
    whole = PointCloud(**builder.fields())
    if bag is None:
        whole.save(path, format=outputs.format, colour_by=outputs.colours, **options)
    else:
        bag(whole)


@contextmanager
def dataset_stream(outputs: Outputs, label: str, number: int, scene: Scene) -> Iterator[Append]:
    """Write the clouds that are appended in the block as a frame of a data set."""
    if outputs.dataset is None:
        raise ValueError("dataset: must be given, got none")
    # Its labels are made of the truth, and its points have none: `Outputs.truth` changes nothing here.
    with frame_stream(outputs.dataset, outputs.place / label, number, scene) as append:
        yield append


def _kept(outputs: Outputs, append: Append) -> Append:
    """Append what is asked for."""
    return append if outputs.truth else (lambda cloud: append(cloud.without_truth()))


def pulses_of_waveforms(outputs: Outputs, sensor: Sensor) -> Sequence[int]:
    """The pulses that are asked for, or a few. Raises InputError."""
    last = sensor.scanner.pulses - 1
    few = [last * number // (FEW_PULSES - 1) for number in range(FEW_PULSES)]
    chosen = check_pulses(outputs.pulses or few, sensor)
    return [int(pulse) for pulse in chosen]
