"""Recordings drawn from known laws: what the fit must find again. Also for `benchmarks/fit_coverage.py`."""

from dataclasses import asdict, dataclass, replace

import numpy as np

from helpers.premises import premise
from lidarscene.recordings.sweep import Sweep
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.fit.near_field import LENSES, Curve, LensCurve, own_curve, share
from lidarscene.studies.fit.products import near_field_m
from lidarscene.studies.fit.tuning import LENS_BOUNDS, LENS_SIGMAS, LOG_RANGE_STEP


@dataclass(frozen=True, kw_only=True)
class Truth:
    """True numbers of a unit, by the keys of the fit's estimates; scatter in millimetres."""

    white_m2: float
    near_field_m: float
    spot_over_field: float
    threshold_slope: float
    threshold_pedestal: float
    threshold_width: float
    scatter_c: float
    scatter_floor: float
    row_gains: float = 0.1

    def threshold(self, near_ir: np.ndarray) -> np.ndarray:
        """SIGNAL at which half are kept."""
        return self.threshold_slope * np.sqrt(near_ir + self.threshold_pedestal)


def drawn_truth(seed: int) -> Truth:
    """A unit at random, as wide as the three real ones are apart and more."""
    random = premise([seed, 1])

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    return Truth(
        white_m2=between(1e5, 6e5),
        near_field_m=between(6.0, 25.0),
        spot_over_field=between(0.3, 0.9),
        threshold_slope=between(0.2, 0.5),
        threshold_pedestal=between(150.0, 600.0),
        threshold_width=between(0.15, 0.3),
        scatter_c=between(120.0, 350.0),
        scatter_floor=between(4.0, 8.0),
        row_gains=between(0.05, 0.25),
    )


def two_lenses(seed: int, sensor: Sensor) -> tuple[Truth, Curve]:
    """A unit whose near field is that of the sensor's two lenses, stretched by up to 35 %."""
    stretch = float(np.exp(premise([seed, 6]).uniform(-0.3, 0.3)))
    curve = own_curve(sensor)
    assert curve is not None
    return replace(drawn_truth(seed), near_field_m=stretch * near_field_m(sensor)), curve


def free_lenses(seed: int, sensor: Sensor, columns: int = 1000) -> tuple[dict[str, float], Sweep]:
    """Truth by the keys of the fit's estimates, and a frame, of a unit whose `LENSES` are not the sensor's.

    They differ as `LENS_SIGMAS` say. As in real recordings the signals of each bin of the range depart from any law, by
    2 %.
    """
    unit, lens_curve = premise([seed, 8]), LensCurve(sensor)
    lenses = np.clip(unit.normal(lens_curve.own, LENS_SIGMAS), *np.transpose(LENS_BOUNDS))
    stretch = float(np.exp(unit.uniform(-0.3, 0.3)))
    truth = replace(drawn_truth(seed), near_field_m=stretch * near_field_m(sensor))
    off = 0.02 * np.random.default_rng([seed, 3]).standard_normal(1000)

    def curve(ratio: np.ndarray) -> np.ndarray:
        place = np.floor(np.log(ratio * truth.near_field_m) / LOG_RANGE_STEP).astype(int)
        shares = lens_curve(ratio.reshape(1, -1), *lenses[:, None, None]).reshape(ratio.shape)
        return np.asarray(shares * np.exp(off[place + 500]))

    numbers = {key: asdict(truth)[key] for key in ("white_m2", "near_field_m")}
    numbers |= dict(zip(LENSES, lenses.tolist(), strict=True))
    return numbers, drawn_sweep(truth, seed, columns=columns, curve=curve)


def drawn_sweep(truth: Truth, seed: int, rows: int = 32, columns: int = 1000, curve: Curve | None = None) -> Sweep:
    """One frame of walls, smooth or rough, and sky, each 20 columns wide and some rows high, under a changing light.

    The arrangement is the same in every run; photons and ranges are drawn.

    Args:
        curve: of two lenses, whose near field ends four times as far out; None: one lens
    """
    layout, random = premise([seed, 7]), np.random.default_rng([seed, 2])
    tall, wide = 8, 20
    shape = (rows // tall, columns // wide)

    def spread(values: np.ndarray) -> np.ndarray:
        return np.repeat(np.repeat(values, tall, axis=0), wide, axis=1)

    place = np.linspace(-1.0, 1.0, wide)
    knee_m = truth.near_field_m * (1.0 if curve is None else 4.0)
    near_m = np.exp(layout.uniform(np.log(0.25 * knee_m), np.log(6.0 * knee_m), shape))
    slant = 1.0 + np.tile(place, (rows, shape[1])) * spread(layout.uniform(-0.05, 0.05, shape))
    range_m = spread(near_m) * slant
    rough = spread(layout.random(shape) < 0.3) * 0.05 * random.standard_normal((rows, columns))
    white = spread(np.exp(layout.uniform(np.log(0.05), np.log(0.9), shape)))
    ratio = range_m / truth.near_field_m
    light = truth.white_m2 * (share(ratio, truth.spot_over_field) if curve is None else curve(ratio)) / range_m**2
    sky = spread(layout.random(shape) < 0.25)
    # Some surfaces so dark that they are found now and then.
    dim = spread(layout.random(shape) < 0.3)
    mean_photons = np.where(dim, spread(layout.uniform(2.0, 25.0, shape)), white * light)
    photons = np.where(sky, random.gumbel(5.0, 1.0, (rows, columns)), mean_photons)
    near_ir = spread(np.exp(layout.uniform(np.log(100.0), np.log(1500.0), shape)))
    near_ir = near_ir * np.exp(truth.row_gains * layout.standard_normal(rows))[:, None]
    near_ir = random.poisson(near_ir).astype(float)
    noise = np.where(sky, 0.0, np.sqrt(1.3 * np.maximum(photons, 1.0)))
    signal = np.rint(np.maximum(photons + noise * random.standard_normal(photons.shape), 1.0))
    excess = np.log(signal / truth.threshold(near_ir)) / truth.threshold_width
    has_return = random.random(signal.shape) < 1.0 / (1.0 + np.exp(-np.clip(excess, -50.0, 50.0)))
    sigma_m = 1e-3 * np.sqrt(truth.scatter_c**2 / signal + truth.scatter_floor**2)
    reported = range_m + rough + sigma_m * random.standard_normal(signal.shape)
    reflectivity = np.clip(np.rint(100.0 * signal / light), 0.0, 255.0)
    azimuth = np.broadcast_to(-2.0 * np.pi * np.arange(columns) / columns, signal.shape)
    return Sweep(
        range_m=np.where(has_return, np.rint(1e3 * reported) / 1e3, np.nan),
        recorded=np.ones(signal.shape, bool),
        direction=np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=-1),
        signal=signal,
        near_ir=near_ir,
        reflectivity=np.where(has_return, reflectivity, 0.0),
        includes_lost=True,
    )
