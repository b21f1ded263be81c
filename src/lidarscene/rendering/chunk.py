"""Chunk: some pulses of a frame on the device, after the stages, and what takes them apart and puts them together.

Two kinds of pulses are traced apart, those that end at the first surface and those that go on through glass. What
belongs to a chunk is in several parts until here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..detection.outcomes import Outcome
from ..detection.returns import Detection
from ..kernel.device import transfer
from ..kernel.rays.point_columns import Staged, with_nan_outcomes
from ..light.beams import Beams
from ..light.echoes import Echoes
from ..light.hits import Hits
from ..maths.arrays import Array, Mask, Numbers, is_drjit, xp
from ..maths.pose import Pose
from .frame import LARGEST_FLOAT32_M
from .tiles import Order


@dataclass(frozen=True, slots=True, eq=False)
class Chunk:
    """Some pulses after all stages, on the device; by pulse unless ``order`` says otherwise.

    twice  the two lanes are one and the same pulse
    """

    pulse: Any
    paths: Sequence[Hits]
    detection: Detection
    goes_on: Any = None
    order: Order | None = None
    twice: bool = False

    def staged(self, rays: int) -> Staged:
        """What columns are made of, with this many rays to a pulse."""
        return Staged(pulse=self.pulse, paths=self.paths, rays=rays, detection=self.detection)

    def arrays(self) -> list[Any]:
        """Everything that is still needed once the stages are done."""
        detection = self.detection
        needed = [self.pulse, detection.snr, detection.detection_probability, detection.outcome, detection.ambient]
        needed += [one for one in (self.goes_on, detection.source) if one is not None]
        for hits in self.paths:
            needed += needed_of(hits)
        for stop in detection.stops:
            needed += [stop.reported, stop.status, stop.range_m, stop.intensity]
            own = (stop.width_s, stop.photons, stop.snr, stop.detection_probability, stop.source, stop.true_range_m)
            needed += [one for one in own if one is not None]
        return needed


def without_continuing(pulse: Array, paths: Sequence[Hits], detection: Detection, goes_on: Mask | None) -> Chunk:
    """Drop the lanes of pulses that continue through glass: their full trace replaces them."""
    if goes_on is None:
        return Chunk(pulse, paths, with_nan_outcomes(detection))
    kept = [dataclasses.replace(stop, reported=stop.reported & ~goes_on) for stop in detection.stops]
    outcome = xp(goes_on).where(goes_on, int(Outcome.NO_SURFACE), detection.outcome)
    left = dataclasses.replace(detection, stops=tuple(kept), outcome=outcome)
    return Chunk(pulse, paths, with_nan_outcomes(left), goes_on)


def of_every_pulse(parts: Sequence[Chunk], first: int, name: str, *, ordered: bool = True) -> Numbers:
    """What detections say of each pulse from ``first`` on; later parts go before the first.

    ordered  by pulse, or as they are on the lanes, which is enough to count them
    """
    # A later part is the full trace of pulses that the first part only surveyed, so its values replace those.
    values: Numbers = getattr(parts[0].detection, name).numpy()
    order = parts[0].order
    if len(parts) > 1:
        values = values.copy()
    for one in parts[1:]:
        pulse = one.pulse.numpy() - first
        values[pulse if order is None else order.lane[pulse]] = getattr(one.detection, name).numpy()
    return values[order.lane] if ordered and order is not None else values


def all_of(parts: Sequence[Mapping[str, Numbers]]) -> dict[str, Numbers]:
    """Columns of several collections as one, by pulse."""
    filled = [one for one in parts if one]
    if not filled:
        return {}
    # Stable: returns of one pulse keep their order.
    order = np.argsort(np.concatenate([one["pulse"] for one in filled]), kind="stable")
    return {name: np.concatenate([one[name] for one in filled])[order] for name in filled[0]}


@dataclass(frozen=True, slots=True, eq=False)
class Lit:
    """Some pulses after the optical stages: their rays, what those met, and the light of each way back."""

    pulse: Any
    rays: Beams
    paths: Sequence[Hits]
    light: Sequence[Echoes]
    goes_on: Any


def of_light(light: Echoes) -> list[Any]:
    """What pulses are put together from."""
    found = [light.found, light.range_m, light.peak_power_w, light.background_power_w, light.white_w_m2]
    found += [one.peak_power_w for one in light.interference]
    return [one for one in found if is_drjit(one)]


def needed_of(hits: Hits) -> list[Any]:
    """What the truth of points is made of."""
    needed = [hits.range_m, hits.cos_incidence, hits.reflectivity, hits.cos_sun, hits.lit, hits.face]
    # Plain numbers are the same for all lanes (nothing moves, no glass): there is nothing to compute.
    counted = (hits.radial_velocity_m_s, hits.interactions, hits.mirrored)
    needed += [*(hits.normal or ()), *(hits.velocity_m_s or ())]
    return [*needed, *(one for one in counted if is_drjit(one))]


@dataclass(frozen=True, slots=True, eq=False)
class Placing:
    """From the sensor's frame to that of the points, once for a frame: a sensor does not know that it moves.

    turn, shift  rotation and place, on the device
    added_m      (3,) what numpy adds in float64, or None: float32 is good to 0.1 mm where the sensor stands
    """

    turn: Any
    shift: Any
    added_m: Numbers | None

    @classmethod
    def of(cls, goal: Pose) -> Placing:
        """The sensor stands at ``goal`` in the frame of the points."""
        # Far from the origin, as in map coordinates, float32 would round points to metres. The device then computes
        # relative to the sensor, and NumPy adds the position in float64.
        near = np.abs(goal.position_m).max() < LARGEST_FLOAT32_M
        return cls(
            turn=transfer.opaque(numbers_of(goal.rotation)),
            shift=transfer.opaque(numbers_of(goal.position_m if near else np.zeros(3))),
            added_m=None if near else goal.position_m,
        )


def numbers_of(values: Numbers) -> tuple[Any, ...]:
    """An array as plain numbers, row by row."""
    return tuple(float(x) for x in values.ravel())
