"""What is on the wire: a frame as packets, read again as a driver of the real sensor reads them."""

import tempfile
from pathlib import Path

import numpy as np
from drawing import INK, bar_of, dark, saved
from matplotlib.colors import LogNorm

import lidarscene
from lidarscene import Outputs
from lidarscene.recordings.opening import open_recording
from lidarscene.recordings.pcap_reader import packets_of

LIDAR_BYTES = 10_000  # more than an IMU packet has, less than one of 128 rows
STRIPS = (
    ("range_m", "range [m]", "turbo_r", (3, 10, 30)),
    ("signal", "signal [photons]", "inferno", (10, 30, 100)),
    ("near_ir", "near infrared [counts]", "gray", (100, 300)),
)


def live() -> None:
    """A frame of the drive scene by an OS1-128: ranges as its packets come, below them what a reader makes of them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drive.pcap"
        lidarscene.record("drive", "os1-128", outputs=Outputs(path))
        packets = len(packets_of(path, lambda payload: len(payload) > LIDAR_BYTES))
        with open_recording(path) as recording:
            sweep = recording[0]
    length_ms = 1e3 * float(np.nanmax(sweep.time_s))
    rows, columns = sweep.shape
    # The lasers of a column look in four directions: a reader puts each row into the order of its azimuths.
    order = np.argsort(-np.arctan2(sweep.direction[..., 1], sweep.direction[..., 0]), axis=1)
    figure, strips = dark(len(STRIPS), 1, height=7.0)
    titles = (f"{packets} packets of {columns // packets} columns, as they come [ms]", "read, by azimuth [°]", "")
    for axes, (name, label, colours, ticks), title in zip(strips, STRIPS, titles, strict=True):
        values = np.where(sweep.has_return, getattr(sweep, name), np.nan) if name != "near_ir" else sweep.near_ir
        if name == "range_m":
            width = 0.0, length_ms
            axes.vlines(np.linspace(*width, packets + 1), rows, 1.06 * rows, INK, linewidth=0.6)
        else:
            values, width = np.take_along_axis(values, order, axis=1), (180.0, -180.0)
        shown = axes.imshow(
            values,
            cmap=colours,
            norm=LogNorm(*np.nanpercentile(values[values > 0], (2, 99))),
            aspect="auto",
            extent=(*width, rows, 0.0),
            interpolation="nearest",
        )
        axes.set_ylim(1.06 * rows, 0.0) if name == "range_m" else axes.set_xticks(range(180, -181, -60))
        axes.set_ylabel("channel", color=INK)
        axes.set_title(title, color=INK, loc="left", fontsize=11)
        bar = bar_of(figure, shown, axes, label)
        bar.set_ticks(ticks, labels=[str(tick) for tick in ticks], minor=False)
        bar.ax.minorticks_off()
    saved(figure, "live.png", colours=128)
