"""Train: the Echoes of every ray and path of a pulse in, with the light of the air, the EchoTrain of the pulse out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..maths.arrays import Array, xp
from ..physics.optics import radiometry
from ..sensor.model import Sensor
from .air_light import AirLight
from .beams import Beams
from .echoes import Ambient, Echoes, EchoTrain, SubEchoes, Volume
from .footprint import Skirt


def together(
    paths: Sequence[Echoes],
    beams: Beams,
    sensor: Sensor,
    ambient: Ambient,
    *,
    rays: int,
    skirt: Skirt | None = None,
    air: AirLight | None,
    seed: Array,
    pulse: Array,
) -> EchoTrain:
    """All that comes back of each pulse.

    paths  Echoes of the lanes' rays by each way that their light takes, lane = pulse lane * rays + ray; the first
           way is that on which a ray sees its background
    rays   of a pulse, each with the same share of its power
    skirt  of them those of a halo, which have its share; None: there is none
    air    what the air sends back
    pulse  (n,) pulse numbers
    """
    first = paths[0]
    ops = xp(first.range_m)

    def of_pulse(values: Array) -> Array:
        """What all rays of a pulse have alike."""
        return ops.column(values, 0, rays) if ops.width(values) > 1 else values

    weight: Array = 1.0 / rays
    if skirt is not None:
        weight = skirt.weight(ops.index(first.range_m) % rays, rays)

    def over_rays(values: Array) -> Array:
        if skirt is not None:
            return sum(ops.column(values * weight, ray, rays) for ray in range(rays))
        return sum(ops.column(values, ray, rays) for ray in range(rays)) * weight

    surfaces = [
        SubEchoes(range_m=path.range_m, peak_power_w=path.peak_power_w * weight, count=rays) for path in paths
    ]
    volume: Volume | None = None
    drops: list[SubEchoes] = []
    if air is not None:
        scale = ops.full(pulse, 0.0) + radiometry.echo_power_w(
            peak_power_w=sensor.laser.peak_power_w,
            backscatter_per_sr=1.0,
            range_m=1.0,
            transmittance=ambient.transmittance,
            aperture_m2=of_pulse(beams.aperture_m2),
            efficiency=sensor.optics.efficiency_laser,
        )
        end_m = _end_m(first, air.far_m, rays, rays if skirt is None else rays - skirt.count)
        volume = air.volume(scale=scale, end_m=end_m)
        drops = air.sub_echoes(scale=scale, end_m=end_m, seed=seed, pulse=pulse)
    met = [ops.column(path.found, ray, rays) for path in paths for ray in range(rays)]
    found = met[0]
    for one in met[1:]:
        found = found | one
    return EchoTrain(
        parts=(*surfaces, *drops),
        surfaces=len(paths) * rays,
        found=found,
        background_power_w=over_rays(first.background_power_w),
        volume=volume,
        interference=tuple(
            replace(one, peak_power_w=of_pulse(one.peak_power_w)) for one in first.interference
        ),
        white_w_m2=of_pulse(first.white_w_m2),
    )


def _end_m(path: Echoes, far_m: Array, rays: int, core: int) -> Array:
    """Where the last ray of each pulse meets a surface; the light around a beam's core makes no air bright."""
    ops = xp(path.range_m)
    last = ops.where(path.found, path.range_m, far_m)
    end = ops.column(last, 0, rays)
    for ray in range(1, core):
        end = ops.maximum(end, ops.column(last, ray, rays))
    return end
