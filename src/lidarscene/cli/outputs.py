"""The options of `render` that choose formats.

The formats are asked from their registry: a new one is an option without a line here.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..formats.registry import DATASETS, FORMATS, LABELS, PACKETS
from ..outputs.output_options import FEW_PULSES
from .words import pulses


def add_output_options(add: Callable[..., Any]) -> None:
    """Add the options that choose formats."""
    add(
        "--format",
        choices=FORMATS | PACKETS,
        metavar="NAME",
        help=f"format of the cloud, where its name does not say it: {', '.join(FORMATS)}; or the sensor's own packets: "
        f"{', '.join(PACKETS)}",
    )
    add(
        "--labels",
        choices=LABELS,
        metavar="NAME",
        help=f"write boxes or classes of points beside the cloud, as {', '.join(LABELS)} has them",
    )
    add(
        "--dataset",
        choices=DATASETS,
        metavar="NAME",
        help=f"make the folder -o a data set, clouds and labels: {', '.join(DATASETS)}",
    )
    add(
        "--range-image",
        metavar="F.png|F.npz",
        type=Path,
        help="range, intensity and status by ring and azimuth, a pixel a beam",
    )
    add(
        "--ambient",
        metavar="F.npz|F.png",
        type=Path,
        help="background counts of every pulse, a near-infrared picture by ring and azimuth",
    )
    add(
        "--waveforms",
        metavar="F.npz",
        type=Path,
        help="power on the detector and its signal against time, of the pulses of --pulses",
    )
    add(
        "--pulses",
        metavar="0,100,2000-2010",
        type=pulses,
        help=f"which ones of a frame, 0 for its first (default: {FEW_PULSES} of them, evenly)",
    )
