"""Known scenes before a unit whose numbers were drawn, rendered by the stages of `render` without a ray traced."""

import math
from dataclasses import replace

import numpy as np

from helpers.premises import premise
from helpers.trains import detect
from lidarscene.sensor.detectors.spad_detector import Spad
from lidarscene.sensor.sensor_file import load_sensor
from lidarscene.sensor.sensor_model import Sensor
from lidarscene.studies.fit.on_scene.known_scene import KnownScene, Observations
from lidarscene.studies.ranging.plane import Target, echoes_of_plane

SPOT = 0.5
"""Of the field of view's radius: what the published sensor has."""

REFLECTIVITY_SIGMA = 0.05
GROUPS = 12

DRAWN = {
    "laser.peak_power_w": 0.3,
    "near_field_m": 0.3,
    "spot_over_field": 0.3,
    "laser.pulse_fwhm_ns": 0.15,
    "detector.spads": 0.2,
    "detector.dark_count_rate_hz": 0.3,
    "histogram.threshold_slope": 0.2,
    "histogram.threshold_pedestal": 0.3,
    "histogram.threshold_spread": 0.3,
    "optics.sun_irradiance_w_m2": 0.3,
}
"""How far, as a logarithm, a unit is drawn from what is published."""


def published_sensor(columns: int = 1024) -> Sensor:
    """The sensor that a fit starts from."""
    changes = (f"scanner.columns_per_turn={columns}", "histogram.threshold_spread=0.4")
    sensor = load_sensor("os1-128", overrides=changes)
    return with_spot(sensor, SPOT)


def with_spot(sensor: Sensor, spot_over_field: float) -> Sensor:
    """The sensor with a near field, and a spot so wide."""
    from lidarscene.sensor.overlap import Overlap, OverlapGeometry, Spot

    field = float(sensor.detector.radius_m / sensor.optics.focal_length_m)
    spot = Spot(profile="gaussian", half_divergence_rad=spot_over_field * field, exit_radius_m=0.0)
    overlap = Overlap.from_geometry(
        OverlapGeometry(spot=spot, aperture_radius_m=float(sensor.optics.aperture_radius_m), field_rad=field)
    )
    # What of the spot is beyond the field of view is a part of the laser's power here.
    table = replace(overlap.table, values=overlap.table.values / -math.expm1(-2.0 / spot_over_field**2))
    return replace(sensor, optics=replace(sensor.optics, overlap=replace(overlap, table=table)))


def drawn_unit(seed: int) -> dict[str, float]:
    """Logarithms of its numbers over the published ones."""
    random = premise([seed, 3])
    return {name: float(random.uniform(-far, far)) for name, far in DRAWN.items()}


def unit_of(truth: dict[str, float], base: Sensor | None = None) -> Sensor:
    """The sensor with these numbers; the lens moves so that the background stays. ``base`` None: the published one."""
    sensor = published_sensor() if base is None else base
    grown = {name: math.exp(value) for name, value in truth.items()}
    moved = math.sqrt(grown["near_field_m"])
    laser, optics, detector, histogram = sensor.laser, sensor.optics, sensor.detector, sensor.histogram
    assert isinstance(detector, Spad)
    assert histogram is not None
    sensor = replace(
        sensor,
        laser=replace(
            laser,
            peak_power_w=laser.peak_power_w * grown["laser.peak_power_w"] / moved**2,
            pulse_fwhm_s=laser.pulse_fwhm_s * grown["laser.pulse_fwhm_ns"],
        ),
        optics=replace(
            optics,
            aperture_radius_m=optics.aperture_radius_m * moved,
            focal_length_m=optics.focal_length_m * moved,
            sun_irradiance_w_m2=optics.sun_irradiance_w_m2 * grown["optics.sun_irradiance_w_m2"],
        ),
        detector=replace(
            detector,
            spads=detector.spads * grown["detector.spads"],
            dark_count_rate_hz=detector.dark_count_rate_hz * grown["detector.dark_count_rate_hz"],
        ),
        histogram=replace(
            histogram,
            threshold_slope=histogram.threshold_slope * grown["histogram.threshold_slope"],
            threshold_pedestal=histogram.threshold_pedestal * grown["histogram.threshold_pedestal"],
            threshold_spread=(histogram.threshold_spread or 0.0) * grown["histogram.threshold_spread"],
        ),
    )
    return with_spot(sensor, SPOT * grown["spot_over_field"])


def drawn_scene(seed: int, pulses: int) -> tuple[KnownScene, np.ndarray, Target, np.ndarray]:
    """Surfaces of twelve reflectivities at 1 to 110 m, in shade and sun: scene, groups, target and true deviations."""
    layout, random = premise([seed, 8]), np.random.default_rng([seed, 4])
    group = layout.integers(0, GROUPS, pulses)
    range_m = np.exp(layout.uniform(math.log(1.5), math.log(110.0), pulses))
    klux = np.exp(layout.uniform(math.log(2.0), math.log(100.0), pulses))
    albedo = np.geomspace(0.05, 0.9, GROUPS)[group]
    sensor = published_sensor()
    target = Target(
        reflectivity=albedo, illuminance_klux=klux, cos_incidence=layout.uniform(0.3, 1.0, pulses), transmittance=1.0
    )
    scene = KnownScene.from_light(echoes_of_plane(sensor, target, range_m), sensor, group, spot_over_field=SPOT)
    return scene, range_m, target, REFLECTIVITY_SIGMA * random.standard_normal(GROUPS)


def drawn_report(unit: Sensor, seed: int, pulses: int = 3000) -> tuple[KnownScene, Observations]:
    """A scene as it is believed to be, and what the unit reports of it as it is."""
    scene, range_m, target, off = drawn_scene(seed, pulses)
    real = replace(target, reflectivity=target.reflectivity * np.exp(off[scene.group]))
    light = echoes_of_plane(unit, real, range_m)
    detection = detect(light, unit, seed=seed)
    stop = detection.stops[0]
    is_echo = np.asarray(stop.reported) & (np.asarray(stop.status) == 0)
    return scene, Observations(
        has_return=is_echo,
        signal=np.where(is_echo, stop.amplitude, np.nan),
        near_ir=np.asarray(detection.ambient, float),
        range_m=np.where(is_echo, stop.range_m, np.nan),
    )
