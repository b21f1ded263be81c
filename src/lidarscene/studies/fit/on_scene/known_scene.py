"""Prediction of what a photon-counting sensor reports of surfaces whose places are known.

The light is traced once. Laser, lens and reflectivities scale its power; the stages that `render` runs turn it into
photons of the return, chance of a return (T98) and background counts. The scatter of the range is that of the filter's
peak. Each parameter is the logarithm of a number over its value in the given sensor, so 0 is the given sensor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....light.echoes import Echoes, EchoTrain
from ....maths.arrays import Lanes, Mask, Numbers, is_drjit, xp
from ....maths.special import normal_tail
from ....physics.constants import SPEED_OF_LIGHT_M_S
from ....physics.photon_counting.matched_filter import SECOND_ORDER
from ....physics.photon_counting.pile_up import BOX, BOX_SHARE
from ....sensor.detectors import WorkingPoint
from ....sensor.detectors.macropixel import Macropixel
from ....sensor.sensor_model import Sensor
from ..near_field import share
from ..products import near_field_m, scatter_over_sigma, width_of_place
from ..tuning import MOST_FIRED, STRONG_RATIO

SENSOR_FIELDS: Mapping[str, tuple[str, str]] = {
    "laser.pulse_fwhm_ns": ("laser", "pulse_fwhm_s"),
    "detector.pde": ("detector", "pde"),
    "detector.spads": ("detector", "spads"),
    "detector.dark_count_rate_hz": ("detector", "dark_count_rate_hz"),
    "histogram.threshold_slope": ("histogram", "threshold_slope"),
    "histogram.threshold_pedestal": ("histogram", "threshold_pedestal"),
}
"""Parameter -> (component of the sensor, field of the component), for those that scale a field."""

PARAMETERS = (
    "laser.peak_power_w",
    "near_field_m",
    "spot_over_field",
    "laser.pulse_fwhm_ns",
    "detector.spads",
    "detector.dark_count_rate_hz",
    "histogram.threshold_slope",
    "histogram.threshold_pedestal",
    "histogram.threshold_spread",
    "optics.sun_irradiance_w_m2",
    "scatter_floor",
    "detector.pde",
    "optics.efficiency_laser",
    "detector.jitter_ps",
)
"""All parameters, best known from publications last: of an undetermined combination the last one is held fixed."""

GAUSS_HERMITE = (0.0, math.sqrt(3.0), -math.sqrt(3.0)), (2 / 3, 1 / 6, 1 / 6)
"""Accuracy bought: nodes and weights of three-point Gauss-Hermite quadrature over a normal distribution: the chance is
smooth over the threshold's own spread."""

LEAST_FLOOR_M = 3e-4
"""Source: rounding to 1 mm, 1 / sqrt(12) mm; scatter from it. The filter's own scatter is known to 1 %."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownScene:
    """Light of n pulses from known surfaces, and the sensor that it was traced with.

    Attributes:
        range_m: (n,) range of the surface
        power_w: (n,) peak power of the echo, with all of the spot on the detector
        background_w: (n,) power of sun and sky
        group: (n,) index of the reflectivity factor that the pulse shares with others
        spot_over_field: radius of the laser's spot over that of the field of view, for the law of defocus; None: the
            sensor's own near field, over a range that `near_field_m` stretches
        jitter_s: jitter at parameter `detector.jitter_ps` = 0
        spread: threshold spread at parameter `histogram.threshold_spread` = 0, if the sensor has none
        floor_m: scatter common to all ranges at parameter `scatter_floor` = 0: clock steps, unmodelled effects
        texture: relative scatter of the reflectivities within a group
        strangers: share of the pulses that met an unknown object; half of them count as kept
        light_measured: True if the background was measured and does not scale with the reflectivities
    """

    sensor: Sensor
    range_m: Numbers
    power_w: Numbers
    background_w: Numbers
    group: Numbers
    spot_over_field: float | None
    jitter_s: float = 100e-12
    spread: float = 0.1
    floor_m: float = LEAST_FLOOR_M
    texture: float = 0.0
    strangers: float = 0.0
    light_measured: bool = False

    @classmethod
    def from_light(
        cls, light: Echoes | EchoTrain, sensor: Sensor, group: Numbers, *, spot_over_field: float | None
    ) -> KnownScene:
        """Build from traced light (`Simulator.light`, one ray per pulse); pulses that meet no surface are left out.

        Of several echoes, as behind a pane, the strongest counts. The loss in the sensor's own near field is undone.

        Args:
            group: index of the reflectivity factor, for all pulses of the light

        Raises:
            ValueError: for light of several rays per pulse
        """
        if isinstance(light, EchoTrain) and any(part.count != 1 for part in light.parts):
            raise ValueError("light: must be of one ray a pulse, got several")
        parts = light.parts if isinstance(light, EchoTrain) else (light,)
        mask = np.asarray(light.has_surface)
        powers = np.stack([np.asarray(part.peak_power_w, np.float64)[mask] for part in parts])
        strongest = np.argmax(powers, axis=0)[None]
        ranges = np.stack([np.asarray(part.range_m, np.float64)[mask] for part in parts])
        range_m, power_w = (np.take_along_axis(columns, strongest, axis=0)[0] for columns in (ranges, powers))
        overlap = sensor.optics.overlap
        detected_share = 1.0 if overlap is None else np.asarray(overlap.share(range_m))
        background = np.broadcast_to(np.asarray(light.background_power_w, np.float64), mask.shape)
        return cls(
            sensor=sensor,
            range_m=range_m,
            power_w=power_w / detected_share,
            background_w=background[mask],
            group=np.asarray(group)[mask],
            spot_over_field=spot_over_field,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observations:
    """Reported values, (n,) each; signal, range_m and near_ir are NaN where they do not enter the likelihood."""

    has_return: Numbers
    signal: Numbers
    near_ir: Numbers
    range_m: Numbers

    @property
    def has_values(self) -> Numbers:
        """Mask of the pulses whose signal and range count."""
        return np.isfinite(self.signal) & np.isfinite(self.range_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """Predicted values, (n,) each; NumPy or Dr.Jit.

    Attributes:
        signal: mean of the photons: counts around the peak minus the background's
        variance: variance of the photons
        chance: probability of a return
        near_ir: background counts
        sigma_m: scatter of the range
        level: threshold [photons]
        fired: share of the free SPADs that the echo fires
    """

    signal: Lanes
    variance: Lanes
    chance: Lanes
    near_ir: Lanes
    sigma_m: Lanes
    level: Lanes
    fired: Lanes

    @property
    def is_strong(self) -> Mask:
        """Mask of the pulses whose signal and range enter the likelihood, if they were recorded."""
        return (self.signal > STRONG_RATIO * self.level) & (self.fired < MOST_FIRED)


def predict(scene: KnownScene, parameters: Mapping[str, Lanes], reflectivity: Numbers | float = 0.0) -> Prediction:
    """Predict what the sensor reports.

    Args:
        parameters: logarithms by name, as in `PARAMETERS`; those left out are 0
        reflectivity: (n,) logarithm of each surface's reflectivity over the one it was traced with
    """
    parameter: Any = next(iter(parameters.values()), 0.0)
    ops = xp(parameter)

    def lanes(values: Numbers) -> Lanes:
        return type(parameter)(np.ascontiguousarray(values)) if is_drjit(parameter) else values

    def factor(name: str) -> Lanes:
        if name in parameters:
            return ops.exp(parameters[name])
        # NumPy's numbers and Dr.Jit's arrays do not mix: all are of one kind.
        return type(parameter)(1.0) if is_drjit(parameter) else 1.0

    sensor = scene.sensor
    for name, (part, field) in SENSOR_FIELDS.items():
        component = getattr(sensor, part)
        sensor = replace(
            sensor, **{part: replace(component, **{field: float(getattr(component, field)) * factor(name)})}
        )
    floor_m = scene.floor_m * factor("scatter_floor")
    if "detector.jitter_ps" in parameters:
        detector: Any = sensor.detector
        detector = replace(detector, jitter_s=scene.jitter_s * factor("detector.jitter_ps"))
        sensor = replace(sensor, detector=detector)
    if "histogram.threshold_spread" in parameters:
        histogram: Any = sensor.histogram
        component = scene.spread if histogram.threshold_spread is None else float(histogram.threshold_spread)
        histogram = replace(histogram, threshold_spread=component * factor("histogram.threshold_spread"))
        sensor = replace(sensor, histogram=histogram)
    shared = _shared(scene, lanes(scene.range_m), factor)
    surface = lanes(np.exp(np.asarray(reflectivity) * np.ones_like(scene.range_m)))
    power = lanes(scene.power_w) * shared * surface * factor("laser.peak_power_w") * factor("optics.efficiency_laser")
    background = lanes(scene.background_w) * factor("optics.sun_irradiance_w_m2")
    if not scene.light_measured:
        background = background * surface
    point = sensor.working_point(background)
    pixel = sensor.pixel(background)
    signal, level = point.response.signal(power), sensor.threshold(point)
    # The counts' box has sloping edges, a bin wide, beyond which a little more of the echo lies.
    edge = sensor.histogram.bin_s / pixel.sigma_s  # type: ignore[union-attr]
    widening = 1.0 + edge * edge / 12.0
    captured = (1.0 - 2.0 * normal_tail(BOX / xp(widening).sqrt(widening))) / BOX_SHARE
    captured_signal = signal * captured
    background_photons = pixel.count_rate_hz * (2.0 * BOX * pixel.sigma_s)
    rate, _ = sensor.background_counts(background)
    chance = (1.0 - scene.strangers) * _chance(point, level, signal, scene.texture) + 0.5 * scene.strangers
    return Prediction(
        signal=captured_signal,
        chance=chance,
        near_ir=rate * sensor.tdc.ambient_s,
        level=level,
        fired=-point.noise.kappa_2 / point.noise.kappa_1 * signal,
        # Binomial: each SPAD fires once, and -kappa_2 / kappa_1 is one over how many there are.
        variance=(captured_signal + background_photons / BOX_SHARE) / BOX_SHARE
        + (point.noise.kappa_2 / point.noise.kappa_1 + scene.texture**2) * captured_signal * captured_signal,
        sigma_m=_sigma_m(signal, pixel, floor_m),
    )


def _chance(point: WorkingPoint, level: Lanes, signal: Lanes, texture: float) -> Lanes:
    """Probability of a return, averaged over the surfaces' texture (log-normal, mean 1)."""
    assert point.noise.echo_tail is not None
    if texture == 0.0:
        return point.noise.echo_tail(level, signal)
    total: Lanes = 0.0
    for node, weight in zip(*GAUSS_HERMITE, strict=True):
        total = total + weight * point.noise.echo_tail(level, signal * math.exp(texture * node - 0.5 * texture**2))
    return total


def _shared(scene: KnownScene, range_m: Lanes, factor: Callable[[str], Lanes]) -> Lanes:
    """Share of the light that falls on the detector at these ranges."""
    if scene.spot_over_field is None:
        overlap = scene.sensor.optics.overlap
        return 1.0 + 0.0 * range_m if overlap is None else overlap.share(range_m / factor("near_field_m"))
    return share(
        range_m / (near_field_m(scene.sensor) * factor("near_field_m")),
        scene.spot_over_field * factor("spot_over_field"),
    )


def _sigma_m(signal: Lanes, pixel: Macropixel, floor_m: Lanes) -> Lanes:
    """Scatter of the range: the filter's peak moves with the shot noise of echo and background.

    The background's variance is r int h'^2 / (S int h' s')^2 = r sigma^3 sqrt(pi) / 2 w^3 (1 + 1 / w^2)^3 / S^2, with
    rate r, signal S, filter h of w echo widths and echo s; the echo's is `scatter_over_sigma`.
    """
    sigma_s, rate_hz = pixel.sigma_s, pixel.variance_share * pixel.count_rate_hz
    w = width_of_place(sigma_s, pixel.histogram.bin_s)
    ops = xp(signal, sigma_s)
    relative = scatter_over_sigma(w)
    photon_variance = relative * relative * (1.0 + SECOND_ORDER / signal) / signal
    shape = 1.0 + 1.0 / (w * w)
    background_variance = rate_hz * sigma_s * (0.5 * math.sqrt(math.pi)) * (w * shape) ** 3 / (signal * signal)
    scale_m = 0.5 * SPEED_OF_LIGHT_M_S * sigma_s * pixel.histogram.noise_left(signal)
    return ops.sqrt(scale_m * scale_m * (photon_variance + background_variance) + floor_m * floor_m)
