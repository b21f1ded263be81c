"""Field of view: the background of each pulse, gathered over all that its receiver sees.

The receiver may see more, or less, than the laser lights. Rays of the laser's footprint would then sample the wrong
background. Rays spread evenly over the receiver's field of view sample the right one (docs/theory.md 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..maths.arrays import Lanes, LookupTable, xp
from ..maths.vectors import dot, weighted_sum
from ..physics.optics import radiometry, sunlight
from ..sensor.sensor_model import Sensor
from .beams import Beams
from .echoes import Ambient, background_aperture_m2, receive
from .footprint import Footprint, points, with_sweep
from .hits import Hits


def field_of_view(sensor: Sensor, rays: int) -> Footprint:
    """Rays that share the receiver's field of view evenly: the detector's disc, seen through the lens.

    Args:
        rays: number of rays for each pulse
    """
    # All rays start in the middle of the lens: a lens that is focused far away sees the patch sharp only there.
    slope = float(sensor.detector.radius_m) / float(sensor.optics.focal_length_m)
    places, sweeps = points("top_hat", rays), rays > 1 and sensor.sweep_rad > 0.0
    return Footprint(
        points=LookupTable(with_sweep(places) if sweeps else places),
        exit_radius_m=0.0,
        slope=(slope, slope),
        sweep_rad=sensor.sweep_rad if sweeps else None,
    )


def background_power_w(rays: Beams, paths: Sequence[Hits], sensor: Sensor, ambient: Ambient, *, count: int) -> Lanes:
    """Background power of each pulse, (n,) W: the mean over its rays, with all paths of each.

    Args:
        rays: ``count`` of each pulse, lane = pulse lane * count + number
        paths: for each path, what the rays met
    """
    background = sum(_ray_background_w(rays, hits, sensor, ambient) for hits in paths)
    ops = xp(background)
    return sum(ops.column(background, number, count) for number in range(count)) * (1.0 / count)


def _ray_background_w(rays: Beams, hits: Hits, sensor: Sensor, ambient: Ambient) -> Lanes:
    """Background power if all of the field of view saw what this ray sees, (n,) W."""
    light = receive(rays, hits, sensor, replace(ambient, sun_direction=None))
    if ambient.sun_direction is None:
        return light.background_power_w
    # Each ray stands for a small part of the field of view, which either sees the sun's disc or does not. So it takes
    # the disc's radiance, and not the share of the disc in the whole field that `receive` would add.
    chord = weighted_sum(1.0, hits.direction or rays.direction, -1.0, ambient.sun_direction)
    disc = radiometry.background_power_w(
        radiance_w_m2_sr=sunlight.sun_disc_radiance_w_m2_sr(sun_irradiance_w_m2=ambient.sun_irradiance_w_m2),
        aperture_m2=background_aperture_m2(rays),
        field_of_view_sr=radiometry.field_of_view_solid_angle_sr(
            detector_radius_m=sensor.detector.radius_m, focal_length_m=sensor.optics.focal_length_m
        ),
        transmittance=1.0,  # the sun's irradiance is that at the sensor
        efficiency=sensor.optics.efficiency_sun * rays.receiver_share * hits.throughput,
    )
    on_disc = ~hits.has_surface & (dot(chord, chord) < sunlight.SUN_RADIUS_RAD * sunlight.SUN_RADIUS_RAD)
    return light.background_power_w + xp(light.background_power_w).where(on_disc, disc, 0.0)
