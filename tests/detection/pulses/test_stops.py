"""Which pulses a receiver finds and keeps: walls behind fog, orders of returns."""

import numpy as np
import pytest
from helpers import trains

from lidarscene import load_sensor
from lidarscene.detection.outcomes import Status

ADC = ("sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=14", "sampler.full_scale=1e-4")
LEVELS = ("sampler.type='multi_level_tdc'", "sampler.levels=[2, 4, 8, 16, 32, 64]")


def behind_fog(*overrides):
    """Stops of 300 beams on a wall of 30 % at 25 m in fog of 80 m visibility, by a sensor with two lenses.

    The wall is some 20 thresholds high, a third more than the fog at its brightest and 20 times the fog before it,
    which is over the threshold up to the wall.
    """
    sensor = load_sensor("biaxial-905", overrides=["tdc.stops=1", *overrides])
    return trains.detect(trains.in_fog(sensor, np.ones(300), wall_m=25.0), sensor).stops


def is_wall(stop):
    """Whether a stop is the wall, within 0.5 m: a leading edge has 7 cm of noise, and fog before it bends it by 9."""
    return stop.reported & (stop.status == Status.ECHO) & (np.abs(stop.range_m - 25.0) < 0.5)


@pytest.mark.parametrize(
    "overrides",
    [
        ("tdc.keep='strongest'",),
        ("tdc.keep='last'",),
        ("tdc.keep='last'", *ADC),
        ("tdc.keep='last'", *LEVELS),
        ("tdc.keep='strongest'", *LEVELS),
    ],
)
def test_a_wall_behind_fog_is_found(overrides):
    """Its noise is 4 % of its height over the fog. Of 300 beams noise may lift the fog, a third lower than the wall,
    over one more level in a few: by its width there it is then the stronger.
    """
    (stop,) = behind_fog(*overrides)
    assert is_wall(stop).mean() > 0.98


@pytest.mark.parametrize(
    "overrides",
    [("tdc.keep='strongest_and_last'", "tdc.stops=2"), ("tdc.stops=2", *ADC), ("tdc.stops=2", *LEVELS)],
)
def test_fog_and_the_wall_behind_it(overrides):
    """Two stops hold both. What is no wall is fog: no surface stands between."""
    fog, wall = behind_fog(*overrides)
    assert is_wall(wall).mean() > 0.99
    assert (fog.status[fog.reported & ~is_wall(fog)] == Status.WEATHER).all()


def test_a_comparator_s_first_edge_is_the_fog():
    """As a real one: it stays high up to the wall, which makes no edge of its own."""
    (stop,) = behind_fog()
    assert (stop.status == Status.WEATHER).all()
    assert stop.range_m.max() < 6.0
