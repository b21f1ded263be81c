"""Noise of the range that neighbouring columns share: a window of shots that moves along the ring.

A receiver that takes shots of other columns into a point has their noise in it, too. Each column and channel has one
standard normal number for each stop. The noise of a point is the sum of its own and those of the columns around it,
with the weights of the sensor file, and has the size that its light gives, or less in weak returns. A column whose
range is another one counts less, so that ranges scatter more where a surface leans along the row
(docs/photon_counting.md, T176 to T177).
"""

from __future__ import annotations

from dataclasses import replace

from ...maths import random
from ...maths.arrays import Lanes, xp
from ...physics.electronics import tdc
from ...physics.optics import radiometry
from ...physics.photon_counting import shared_shots
from ..outcomes import Status
from ..report import Detection, Returns
from .expectation import FilteredLight
from .tuning import MOST_FIRED, MOST_NOISE


def share_noise(detection: Detection, light: FilteredLight) -> Detection:
    """Replace the noise of echoes' ranges by noise that neighbouring columns share, if they do (T176 to T176b).

    Only the noise is shared: the range stays that of the point's own surface. Points that are no echo, echoes that were
    folded, and those that fire nearly all SPADs keep their noise. Weak returns have less of it (T176b), correlated as
    that of all others (T177).

    Args:
        light: in which the echoes were found
    """
    sensor = light.sensor
    # Scanners without lines, such as flashes, have no neighbouring columns.
    if sensor.histogram is None or sensor.histogram.column_weights is None or sensor.scanner.line_pulses is None:
        return detection
    return replace(
        detection, stops=tuple(_share_in_stop(stop, number, light) for number, stop in enumerate(detection.stops))
    )


def _share_in_stop(stop: Returns, number: int, light: FilteredLight) -> Returns:
    """Replace the noise of one stop's ranges; ``number`` is the stop's."""

    def compute() -> Lanes:
        assert stop.true_range_m is not None
        return _range_with_noise(stop, light, number)

    is_echo = stop.reported & (stop.status == int(Status.ECHO))
    return replace(stop, range_m=xp(stop.range_m).where_any(is_echo, compute, stop.range_m))


def _range_with_noise(stop: Returns, light: FilteredLight, number: int) -> Lanes:
    """Reported range, (n,) m, with noise that columns share in place of the noise that was drawn."""
    assert stop.snr is not None
    assert stop.true_range_m is not None
    ops = xp(stop.range_m)
    pixel, point = light.pixel_at(stop.true_range_m), light.point_at(stop.true_range_m)
    signal = stop.snr * point.noise.deviation
    if light.fluctuation is not None:
        signal = signal * light.fluctuation.relative_power
    deviation_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=pixel.place_deviation_s(signal))
    most_m = MOST_NOISE * deviation_m
    drawn_m = ops.maximum(ops.minimum(stop.range_m - stop.true_range_m, most_m), -most_m)
    assert light.sensor.histogram is not None
    deviate = _column_deviate(light, stop.true_range_m, deviation_m, stop=number)
    deviation_m = deviation_m * light.sensor.histogram.noise_left(signal)
    range_m = ops.maximum(stop.range_m - drawn_m + deviation_m * deviate, 0.0)
    time_s = tdc.quantise(
        time_s=radiometry.time_of_flight_s(range_m=range_m),
        least_significant_bit_s=light.sensor.tdc.least_significant_bit_s,
    )
    shared_m = radiometry.range_from_time_of_flight_m(time_of_flight_s=time_s)
    if point.response.largest is None:
        return shared_m
    return ops.where(signal < MOST_FIRED * point.response.largest, shared_m, stop.range_m)


def _column_deviate(light: FilteredLight, range_m: Lanes, deviation_m: Lanes, *, stop: int) -> Lanes:
    """Draw the weighted sum of the standard normal numbers of a point's column and of those around it, (n,) (T176).

    Any point can draw the numbers of its neighbours, which need not be in the same chunk. It does not know their
    ranges: they follow from the lean at ``range_m`` of the surface that gives the pulse's strongest return.

    Args:
        deviation_m: of the noise that the point's own light gives (T176), by which columns count less (T176a)
    """
    sensor, pulse = light.sensor, light.pulse
    assert sensor.histogram is not None
    assert sensor.scanner.line_pulses is not None
    weights = sensor.histogram.window
    if sensor.histogram.column_range_sigmas is not None:
        # Without a slope the surface is a plane that faces the sensor, as studies of ranges have it.
        row_slope: Lanes = 0.0 if light.train.row_slope is None else light.train.row_slope
        reach_m = sensor.histogram.column_range_sigmas * deviation_m
        step = row_slope * range_m * sensor.histogram.column_rad / reach_m
        weights, _ = shared_shots.shares(weights, step)
    ops = xp(pulse)
    column, place = ops.divmod(ops.int32(pulse), sensor.scanner.line_pulses)
    # A random number has two words, so two columns share one.
    pair, odd = ops.divmod(column, 2)
    is_even, draw = odd == 0, ops.uint32(place + stop * 2**24)
    total: Lanes = 0.0
    for back in range(min(weights) // 2, (max(weights) + 1) // 2 + 1):
        words = random.words(seed=light.seed, stage=random.Stage.COLUMN_NOISE, pulse=ops.uint32(pair - back), draw=draw)
        of_even, of_odd = random.normal_pair(words)
        before, middle, after = (weights.get(2 * back + beside, 0.0) for beside in (-1, 0, 1))
        total = total + of_even * ops.where(is_even, middle, after) + of_odd * ops.where(is_even, before, middle)
    return total
