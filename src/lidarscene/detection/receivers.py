"""Receivers: choice among the three ways of detection.

A comparator that keeps the first edge of a lone echo has a closed form (`returns`). Overlapping echoes, samplers and
orders of returns need the waveform (`multi_echo`). SPADs that sum shots need a histogram (`photon_counting`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..light.echoes import Echoes, EchoTrain, SubEchoes
from ..light.stray_light import ChannelLight, Crosstalk, Volley
from ..maths.arrays import Array, Lanes, Mask, xp
from ..maths.random import Seed
from ..sensor.sensor_model import Sensor
from . import multi_echo, returns
from .outcomes import Outcome, Status
from .photon_counting import histogram_receiver
from .photon_counting.column_noise import share_noise
from .returns import Detection


def is_plain(sensor: Sensor) -> bool:
    """True if the closed form for one echo per pulse (`returns`) holds for the sensor's receiver."""
    needs_waveform = (
        sensor.sampler is not None or sensor.histogram is not None or sensor.receiver.ac_coupling_hz is not None
    )
    return not needs_waveform and sensor.tdc.keep == "first"


def detect(pulse_train: EchoTrain, sensor: Sensor, *, seed: Seed, pulse: Array) -> Detection:
    """Detect pulses with any number of sub-echoes.

    seed   32-bit frame seed; every random number is keyed by (seed, stage, pulse)
    pulse  (n,) uint32 pulse numbers
    """
    detect_train = multi_echo.detect if sensor.histogram is None else histogram_receiver.detect
    detection = detect_train(pulse_train, sensor, seed=seed, pulse=pulse)
    # Scanners without lines, such as flashes, have no neighbouring columns.
    in_lines = sensor.scanner.line_pulses is not None
    if in_lines and sensor.histogram is not None and sensor.histogram.column_weights is not None:
        detection = share_noise(detection, pulse_train, sensor, seed=seed, pulse=pulse)
    if not pulse_train.stray or sensor.optics.stray is None or not sensor.optics.stray.withheld:
        return detection
    return _withhold(detection, pulse_train, sensor)


def _withhold(detection: Detection, pulse_train: EchoTrain, sensor: Sensor) -> Detection:
    """Leave out the returns that have less light than the stray light of their pulse, whatever their range.

    A sensor knows what its other channels saw, and what of it may have come here. A stop that is withheld is lost for
    the other returns of its pulse.
    """
    stray_w = pulse_train.parts[-1].peak_power_w
    ops, point = xp(stray_w), sensor.working_point(pulse_train.background_power_w)
    deviation = point.noise.deviation
    stray_snr = point.response.signal(stray_w) / ops.where(deviation <= 0.0, 1e-30, deviation)
    masks = []
    for stop in detection.stops:
        assert stop.snr is not None
        masks.append((stray_w > 0.0) & ((stop.snr < stray_snr) | (stop.status == int(Status.STRAY))))
    return _without(detection, masks)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Glare:
    """Search of a volley for channels that glare; fields but for the number have an entry (n,) for each stop.

    number  next pulse of the volley
    beside  whether the stop lies beside the range of one of them
    """

    number: Lanes
    beside: tuple[Mask, ...]


def withhold_beside_glare(
    detection: Detection, light: ChannelLight, crosstalk: Crosstalk, sensor: Sensor, *, pulse: Array
) -> Detection:
    """Leave out the returns at the range of a glaring echo of another channel of their volley, theory (T200).

    light  of the pulses, computed before
    pulse  (n,) uint32 pulse numbers of whole scan lines in order of time
    """
    stray, glare_w, volleys = sensor.optics.stray, crosstalk.glare_w, crosstalk.volleys
    if stray is None or stray.glare_photons is None or glare_w is None:
        return detection
    glare_photons, reach_m = stray.glare_photons, stray.glare_reach_m
    ops, volley = xp(pulse, light.power_w), Volley.of_pulses(volleys, light, pulse)

    def search(state: _Glare) -> _Glare:
        source = volley.source(state.number)
        glares = ops.take(light.power_w, source) >= glare_w

        def compare() -> tuple[Mask, ...]:
            is_other, range_m = volley.share(state.number) > 0.0, ops.take(light.range_m, source)
            return tuple(
                is_beside | (glares & is_other & (ops.abs(stop.range_m - range_m) < reach_m))
                for is_beside, stop in zip(state.beside, detection.stops, strict=True)
            )

        return _Glare(number=state.number + 1, beside=ops.where_any(glares, compare, state.beside))

    never = ops.full(light.power_w, False)
    start = _Glare(number=ops.full(light.power_w, 0), beside=(never,) * len(detection.stops))
    beside = ops.loop(start, lambda state: state.number < volleys.size, search).beside
    masks = []
    for is_beside, stop in zip(beside, detection.stops, strict=True):
        assert stop.photons is not None
        masks.append(is_beside & (stop.photons < glare_photons))
    return _without(detection, masks)


def _without(detection: Detection, withheld: Sequence[Mask]) -> Detection:
    """Leave out the withheld returns, a mask (n,) for each stop; pulses that lose their last echo are hidden."""
    ops = xp(detection.outcome)
    stops, has_echo = [], ops.full(detection.outcome, 0) > 0
    for stop, mask in zip(detection.stops, withheld, strict=True):
        reported = stop.reported & ~mask
        of_own_light = (stop.status == int(Status.ECHO)) | (stop.status == int(Status.ALIASED))
        stops.append(replace(stop, reported=reported))
        has_echo = has_echo | (reported & of_own_light)
    without_light = (detection.outcome == int(Outcome.KEPT)) & ~has_echo
    outcome = ops.where(without_light, int(Outcome.HIDDEN), detection.outcome)
    return replace(detection, stops=tuple(stops), outcome=outcome)


def detect_alone(echoes: Echoes, sensor: Sensor, *, seed: Seed, pulse: Array) -> Detection:
    """Detect pulses with one echo each in clear air, as `render` does.

    seed, pulse  as of `detect`
    """
    if is_plain(sensor):
        return returns.detect(echoes, sensor, seed=seed, pulse=pulse)
    part = SubEchoes(range_m=echoes.range_m, peak_power_w=echoes.peak_power_w, count=1)
    train = EchoTrain(
        parts=(part,),
        surfaces=1,
        has_surface=echoes.has_surface,
        background_power_w=echoes.background_power_w,
        interference=echoes.interference,
        white_w_m2=echoes.white_w_m2,
        fluctuation=echoes.fluctuation,
    )
    return detect(train, sensor, seed=seed, pulse=pulse)
