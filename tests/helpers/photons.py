"""Receivers that count photons: sensors for tests, and photons that arrive one by one, simulated apart."""

import math
from typing import Any

import numpy as np
from scipy.special import ndtr

from helpers.chain import words
from helpers.trains import detect as detect
from lidarscene import Sensor
from lidarscene.catalog import path_of
from lidarscene.files.toml import read_toml
from lidarscene.light.echoes import Echoes
from lidarscene.maths.arrays import Numbers
from lidarscene.sensor.sensor_file import sensor_from_tables
from lidarscene.studies.ranging import plane

PIXEL = {"type": "spad", "spads": 64, "radius_mm": 0.05, "pde": 0.2, "dead_time_ns": 12, "dark_count_rate_hz": 1000}
SUM = {"shots": 50, "window_us": 1.0, "bin_ns": 1.0, "threshold_floor": 4.0, "threshold_slope": 0.3}


def tables(name: str = "table1-sipm") -> dict[str, Any]:
    """Tables of a sensor file: a catalogue sensor's, with SPADs and a histogram in place of its detector and
    converter.
    """
    sensor_tables = dict(read_toml(path_of("sensors", name)))
    sensor_tables["laser"] = sensor_tables["laser"] | {
        "pulse_fwhm_ns": 4.0,
        "repetition_rate_khz": 10,
        "peak_power_w": 1.0,
    }
    sensor_tables["detector"], sensor_tables["histogram"] = dict(PIXEL), dict(SUM)
    for key in ("tdc", "sources", "published", "sampler", "uncertainty"):
        sensor_tables.pop(key, None)
    return sensor_tables


def sensor(*overrides: str) -> Sensor:
    """Table 1's optics before SPADs of the tests."""
    return sensor_from_tables(tables(), where="test", overrides=words(*overrides))


def spinning(*overrides: str) -> Sensor:
    """A head of two beams that turns ten times a second; the sensor works out its shots from that."""
    sensor_tables = tables()
    sensor_tables["scanner"] = {
        "type": "spinning",
        "rotation_hz": 10,
        "columns_per_turn": 1024,
        "elevation_deg": [0.0, 1.0],
    }
    sensor_tables["histogram"] = {key: value for key, value in SUM.items() if key not in ("shots", "window_us")}
    sensor_tables["histogram"] |= {"pulse_period_us": 1.8, "threshold_floor": 0.0}
    return sensor_from_tables(sensor_tables, where="test", overrides=words(*overrides))


def echoes_of(
    counter: Sensor, range_m: float, *, photons: float | None = None, count: int = 4000, **target: Any
) -> Echoes:
    """Echoes of a board; with ``photons``, as strong as it takes for that many."""
    light = plane.echoes_of_plane(counter, plane.Target(**target), np.full(count, range_m))
    if photons is None:
        return light
    from dataclasses import replace

    point = counter.working_point(light.background_power_w, range_m=light.range_m)
    return replace(light, peak_power_w=np.asarray(point.response.power_w(photons + 0.0 * light.range_m)))


def echo_of(stop: Any) -> Numbers:
    """Where a stop holds the echo."""
    is_echo: Numbers = np.asarray(stop.reported) & (np.asarray(stop.status) == 0)
    return is_echo


def renewal_counts(
    rng: np.random.Generator,
    shape: tuple[int, int],
    *,
    rate_per_ns: float,
    dead: float,
    bins: int,
    bin_ns: float,
    echo: tuple[Any, Any, Any] = (0.0, 0.0, 1.0),
    afterpulse: tuple[float, float] = (0.0, 1.0),
) -> Numbers:
    """(points, bins) counts of the firings of (points, trials) SPADs, each followed from one firing to the next.

    Stationary from the start: a SPAD is blind with the probability lambda tau / (1 + lambda tau), and then for a rest
    that is even over the dead time; one that is blind for ever after it fires has not fired yet. The next photon after
    a moment is where the integral of the light has grown by an exponential number.

    Args:
        echo: detections of a SPAD that is free throughout, place, sigma: numbers, or one for each of several echoes
        afterpulse: probability after each firing, mean delay; up to four are to come at a time, none when it starts
    """
    mean, place, sigma = (np.atleast_1d(values) for values in echo)
    grid = np.linspace(0.0, bins * bin_ns, 40 * bins + 1)
    light = rate_per_ns * grid + ndtr((grid[:, None] - place) / sigma) @ mean
    blind_ns = dead if math.isfinite(dead) else 0.0
    blind = rng.random(shape) < rate_per_ns * blind_ns / (1.0 + rate_per_ns * blind_ns)
    free_from = np.where(blind, rng.uniform(0.0, blind_ns, shape), 0.0)
    point = np.broadcast_to(np.arange(shape[0])[:, None], shape).ravel()
    counts, free_from = np.zeros(shape[0] * bins), free_from.ravel()
    due = np.full((len(point), 4), np.inf)
    while len(point):
        fires = np.interp(free_from, grid, light) + rng.exponential(size=len(point))
        times = np.where(fires < light[-1], np.interp(fires, light, grid), np.inf)
        if afterpulse[0]:
            # What comes while the SPAD is blind is lost.
            due[due < free_from[:, None]] = np.inf
            times = np.minimum(times, due.min(axis=1))
        within = times < grid[-1]
        point, times, due = point[within], times[within], due[within]
        index = np.minimum((times / bin_ns).astype(np.int64), bins - 1)
        counts += np.bincount(point * bins + index, minlength=len(counts))
        free_from = times + dead
        if afterpulse[0]:
            delay = np.where(rng.random(len(times)) < afterpulse[0], rng.exponential(afterpulse[1], len(times)), np.inf)
            due[np.arange(len(times)), due.argmax(axis=1)] = times + delay
        inside = free_from < grid[-1]
        point, free_from, due = point[inside], free_from[inside], due[inside]
    return counts.reshape(shape[0], bins)
