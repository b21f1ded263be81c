"""Echo trains by hand."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from helpers.chain import sensor as sensor
from lidarscene import Sensor
from lidarscene.detection import receiver
from lidarscene.detection.report import Detection
from lidarscene.kernel.device import transfer
from lidarscene.light.air_light import AirLight, air_light
from lidarscene.light.echoes import Echoes, EchoTrain, SubEchoes, Volume
from lidarscene.maths.arrays import Numbers
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics.pulse_sums import SIGMAS_PER_FWHM
from lidarscene.scene.weather import Weather

FWHM_S = 6e-9
SIGMA_S = FWHM_S / SIGMAS_PER_FWHM
SIGMA_M = 0.5 * SPEED_OF_LIGHT_M_S * SIGMA_S
"""Range in which light comes back one sigma_p later."""

BACKGROUND_W = 2.5e-8

QUIET = ["tdc.threshold_to_noise=50"]
"""No false alarms."""


def train(
    range_m: Any, peak_power_w: Any, *, background_w: float = BACKGROUND_W, volume: Volume | None = None
) -> EchoTrain:
    """(pulses, sub-echoes) ranges and powers."""
    range_m, peak_power_w = np.broadcast_arrays(range_m, peak_power_w)
    parts = SubEchoes(
        range_m=range_m.ravel().astype(np.float64),
        peak_power_w=peak_power_w.ravel().astype(np.float64),
        count=range_m.shape[1],
    )
    return EchoTrain(
        parts=(parts,),
        surfaces=parts.count,
        has_surface=(peak_power_w > 0.0).any(axis=1),
        background_power_w=np.full(len(range_m), background_w),
        volume=volume,
    )


FOG = Weather(fog="moderate_advection", fog_visibility_m=80.0)
_air_by_lenses: dict[tuple[Any, ...], AirLight] = {}
"""Light of `FOG`, which knows nothing of what comes behind the lenses."""


def in_fog(equipped: Sensor, scale: Numbers, *, wall_m: float | None = None, reflectivity: float = 0.3) -> EchoTrain:
    """Pulses into fog of 80 m visibility, of ``scale`` (n,) times the sensor's own light; a wall across the beam."""
    extinction = FOG.extinction_at_per_m(equipped.laser.wavelength_m)
    lenses = equipped.laser, equipped.optics, equipped.tdc.window_s, equipped.received_fwhm_s
    air = _air_by_lenses.get(lenses) or air_light(FOG, equipped, extinction_per_m=extinction)
    assert air is not None
    _air_by_lenses[lenses] = air
    sent_w = scale * float(equipped.laser.peak_power_w * equipped.optics.efficiency_laser * equipped.optics.aperture_m2)
    end_m = wall_m or 100.0
    wall_w = sent_w * reflectivity / math.pi * math.exp(-2.0 * extinction * end_m) / end_m**2
    wall_w = wall_w if wall_m else 0.0 * sent_w
    volume = air.volume(scale=sent_w, end_m=np.full(len(sent_w), end_m))
    return train(np.full((len(sent_w), 1), end_m), wall_w[:, None], volume=volume)


def detect(light: Echoes | EchoTrain, equipped: Sensor, *, seed: int = 0) -> Detection:
    """The detection of echoes, or of trains of sub-echoes; the pulses are numbered."""
    pulses = np.size(light.background_power_w)
    return receiver.detect(light, equipped, seed=seed, pulse=np.arange(pulses, dtype=np.uint32))


def power_at_snr(equipped: Sensor, snr: float) -> float:
    """Peak power of this SNR, before a matched filter."""
    point = equipped.working_point(np.array([BACKGROUND_W]))
    point = point.unfiltered or point
    return float(np.ravel(point.response.power_w(snr * point.noise.deviation))[0])


def random_trains(
    pulses: int, sub_echoes: int, equipped: Sensor, *, seed: int, spread_m: float = 6.0
) -> tuple[Numbers, Numbers]:
    """Some sub-echoes apart by a pulse width or so, some missing, around the threshold."""
    random = np.random.default_rng(seed)
    start = random.uniform(10.0, 100.0, (pulses, 1))
    range_m = start + random.uniform(0.0, spread_m, (pulses, sub_echoes))
    share = random.uniform(0.0, 1.0, (pulses, sub_echoes)) ** 3
    power = power_at_snr(equipped, 20.0) * share * (random.uniform(size=share.shape) < 0.8)
    return range_m, power


def on_device(light: Any) -> Any:
    """The same echoes or train on the device, always at the same alignment: that would become part of the kernels."""

    def upload(part: Any, **changed: Any) -> Any:
        names = ("range_m", "peak_power_w")
        return replace(part, **{name: transfer.from_numpy(getattr(part, name)) for name in names}, **changed)

    changed = {
        "has_surface": transfer.unsigned_numbers(light.has_surface) != 0,
        "background_power_w": transfer.from_numpy(light.background_power_w),
    }
    if isinstance(light, Echoes):
        return upload(light, **changed)
    if (air := light.volume) is not None:
        scale, end_m, *edge = map(transfer.from_numpy, (air.scale, air.end_m, *(air.edge or ())))
        changed["volume"] = replace(air, scale=scale, end_m=end_m, edge=(edge[0], edge[1]) if edge else None)
    return replace(light, parts=tuple(map(upload, light.parts)), **changed)


def detect_on_device(light: Echoes | EchoTrain, equipped: Sensor, *, seed: int = 0) -> Any:
    """What the device makes of them, as NumPy arrays: the twin of `detect`."""
    pulse, word = transfer.counter(0, np.size(light.background_power_w)), transfer.seed_word(seed)
    return transfer.fetch(receiver.detect(on_device(light), transfer.opaque(equipped), seed=word, pulse=pulse))
