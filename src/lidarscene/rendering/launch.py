"""Launch: pulses that the device traces together, those of a chunk of a frame, or of several frames.

A frame of few pulses takes the device less time than Python needs to start it and NumPy to take its points. So frames
that follow each other with one seed, a longer run of pulse numbers, are started together. Where something moves each
lane has the number of its frame, and with it the frame's own motions and boxes (`maths.motion_table`). Each frame has
lanes as if it was alone: it begins a packet of rays, with lanes of no pulse before it where the last one ends within a
packet (`Numbering.lane_order`), also where pulses are traced once more (`kernel.rays.kept_lanes.in_packets`). So its
points are those of a frame that is rendered alone, bit by bit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..kernel.rays.device_columns import DeviceColumns
from ..maths.arrays import Numbers
from .chunk import Chunk, detection_values
from .frame import Frame
from .render_options import FrameOptions


class Launch:
    """Pulses that the device traces together: those of several frames that follow each other, or a chunk of one.

    Attributes:
        frames: the frames and their options
        run: the first of them, with the paths of all on the device
        part: the pulses, started
        parts: the pulses, and those of them that were traced again, computed; empty before
        columns: columns of the points of all frames; None before
        surfaces: columns of all pulses that met a surface, if an observer has asked for them
    """

    def __init__(self, frames: Sequence[tuple[FrameOptions, Frame]], run: Frame, part: Chunk) -> None:
        self.frames, self.run, self.part = frames, run, part
        self.parts: Sequence[Chunk] = ()
        self.columns: DeviceColumns | None = None
        self.surfaces: dict[str, Numbers] | None = None
        self._values: dict[str, Numbers] = {}

    def frame_of(self, options: FrameOptions) -> Frame | None:
        """Return the frame of these options; None if it is not among them."""
        if not options.differs_in_number(self.frames[0][0]):
            return None
        return next((frame for own, frame in self.frames if own.number == options.number), None)

    def has(self, frame: Frame) -> bool:
        """Return whether pulses of this frame are among them."""
        return any(own is frame for _, own in self.frames)

    def place(self, frame: Frame) -> int:
        """Place of one of its frames among them."""
        return next(place for place, (_, own) in enumerate(self.frames) if own is frame)

    def values(self, frame: Frame, name: str, *, ordered: bool = True) -> Numbers:
        """`detection_values` of the frame's pulses; not ``ordered``: by lanes, which is enough to count them."""
        if name not in self._values:
            self._values[name] = detection_values(self.parts, name)
        values, order = self._values[name], self.part.order
        pulses = (len(values) if order is None else len(order.lane)) // len(self.frames)
        own = slice(self.place(frame) * pulses, (self.place(frame) + 1) * pulses)
        has_gaps = order is not None and len(values) > len(order.lane)
        return values[order.lane[own]] if order is not None and (ordered or has_gaps) else values[own]


def rows_of(pulse: Numbers, numbers: range) -> slice:
    """Rows of rising pulse numbers that are those of ``numbers``."""
    # Of their own type: NumPy would convert all that are searched to another one.
    first, end = np.searchsorted(pulse, np.array([numbers.start, numbers.stop], pulse.dtype))
    return slice(int(first), int(end))
