"""Receivers: choice among the three ways of detection.

A comparator that keeps the first edge of a lone echo has a closed form (`returns`). Overlapping echoes, samplers and
orders of returns need the waveform (`multi_echo`). SPADs that sum shots need a histogram (`photon_counting`).
"""

from __future__ import annotations

from dataclasses import replace

from ..light.echoes import Echoes, EchoTrain, SubEchoes
from ..maths.arrays import Array, Lanes
from ..sensor.sensor_model import Sensor
from . import multi_echo, returns
from .outcomes import Status
from .photon_counting import histogram_receiver
from .returns import Detection


def is_plain(sensor: Sensor) -> bool:
    """True if the closed form for one echo per pulse (`returns`) holds for the sensor's receiver."""
    needs_waveform = (
        sensor.sampler is not None or sensor.histogram is not None or sensor.receiver.ac_coupling_hz is not None
    )
    return not needs_waveform and sensor.tdc.keep == "first"


def detect(pulse_train: EchoTrain, sensor: Sensor, *, seed: Lanes, pulse: Array) -> Detection:
    """Detect pulses with any number of sub-echoes.

    seed   32-bit frame seed; every random number is keyed by (seed, stage, pulse)
    pulse  (n,) uint32 pulse numbers
    """
    detect_train = multi_echo.detect if sensor.histogram is None else histogram_receiver.detect
    detection = detect_train(pulse_train, sensor, seed=seed, pulse=pulse)
    if sensor.optics.stray is None or not sensor.optics.stray.withheld:
        return detection
    # The sensor knows what its other channels saw. A stop that took stray light is lost for the echo.
    stops = [replace(stop, reported=stop.reported & (stop.status != int(Status.STRAY))) for stop in detection.stops]
    return replace(detection, stops=tuple(stops))


def detect_alone(echoes: Echoes, sensor: Sensor, *, seed: Lanes, pulse: Array) -> Detection:
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
