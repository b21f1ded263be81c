"""Light in files: ambient counts of a frame, or waveforms of chosen pulses, in; an NPZ or a 16-bit PNG out.

Both are arrays over pulses and not over points, so no format of point clouds holds them.
"""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path

import numpy as np

from ..cloud.pixels import cells_of_beams, pixel_values
from ..detection.sampled_waveforms import Waveforms
from ..files.atomic import atomic_output, put_arrays
from ..files.encodings.png import encode_png
from ..maths.arrays import Numbers
from ..sensor.sensor_model import Sensor


def write_waveforms(path: str | os.PathLike[str], waveforms: Waveforms) -> None:
    """Write an NPZ with one array for each field of `detection.sampled_waveforms.Waveforms`, by its name."""
    arrays = {field.name: getattr(waveforms, field.name) for field in dataclasses.fields(waveforms)}
    put_arrays(path, {name: array for name, array in arrays.items() if array is not None})


class AmbientImage:
    """Background counts of every pulse of a frame, gathered chunk by chunk."""

    def __init__(self) -> None:
        self._pulses: list[Numbers] = []
        self._counts: list[Numbers] = []

    def __call__(self, pulse: Numbers, counts: Numbers) -> None:
        """Add the pulses of a chunk."""
        self._pulses.append(pulse)
        self._counts.append(counts)

    def save(self, path: str | os.PathLike[str], sensor: Sensor) -> None:
        """Write the counts as an NPZ or as a 16-bit PNG, by the path's suffix.

        The .npz has pulse, counts, channel, azimuth_rad and elevation_rad of every pulse; the image of ring by azimuth,
        and azimuth_deg and elevation_deg, the edges of its pixels. Of a worn sensor it has wear, the lost share of
        each pulse's echo, and the mask wear_image too. The .png is the image; its text has the size of a step, and it
        is white from twice the 99th percentile on.

        Rows run from the highest elevation down, columns from the left to the right; 0 where no pulse looks. Of
        pulses that share a pixel the last is shown.
        """
        pulse, counts = np.concatenate(self._pulses), np.concatenate(self._counts)
        azimuth, elevation = (np.asarray(angle) for angle in sensor.scanner.angles(pulse))
        cells = cells_of_beams(azimuth, elevation, np.ones(len(pulse), np.uint8))
        place = cells.point[::-1, ::-1]
        image = pixel_values(counts, place)
        if Path(path).suffix.lower() == ".png":
            # The sun itself is a million times as bright as the rest: it may saturate.
            step = max(1, math.ceil(2.0 * float(np.quantile(counts, 0.99)) / 65535.0))
            text = {"Title": "ambient", "Description": f"one step is {step} count{'s' if step > 1 else ''}"}
            levels = np.rint(image / step).clip(0, 65535).astype(np.uint16)
            with atomic_output(path) as temporary:
                temporary.write_bytes(encode_png(levels, text=text))
            return
        masks: dict[str, Numbers] = {}
        if sensor.wear is not None:
            loss = sensor.wear.loss(sensor.scanner.direction(pulse), sensor.scanner.channel(pulse))
            masks["wear"] = np.broadcast_to(np.float32(loss), pulse.shape)
            masks["wear_image"] = pixel_values(masks["wear"], place)
        put_arrays(
            path,
            masks
            | {
                "pulse": pulse,
                "counts": counts,
                "channel": sensor.scanner.channel(pulse),
                "azimuth_rad": azimuth,
                "elevation_rad": elevation,
                "image": image,
                "azimuth_deg": cells.azimuth_deg[::-1],
                "elevation_deg": cells.elevation_deg[::-1],
            },
        )
