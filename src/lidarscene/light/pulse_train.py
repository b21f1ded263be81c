"""Train: the Echoes of every ray and path of a pulse in, with the light of the air, the EchoTrain of the pulse out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..maths.arrays import Array, Lanes, xp
from ..physics.optics import radiometry
from ..sensor.model import Sensor
from .air_light import AirLight
from .beams import Beams
from .echoes import Ambient, Echoes, EchoTrain, SubEchoes, Volume
from .footprint import Skirt


@dataclass(frozen=True, slots=True, kw_only=True)
class LitAir:
    """The air that some pulses go through.

    light    what it sends back
    sensor   that fired the pulses; ambient is what they go through
    seed     32-bit frame seed
    pulse    (n,) uint32 pulse numbers
    """

    light: AirLight
    sensor: Sensor
    ambient: Ambient
    seed: Lanes
    pulse: Array


def together(
    paths: Sequence[Echoes],
    beams: Beams,
    *,
    rays: int,
    skirt: Skirt | None = None,
    air: LitAir | None = None,
) -> EchoTrain:
    """All that comes back of each pulse.

    paths  Echoes of the lanes' rays by each way that their light takes, lane = pulse lane * rays + ray; the first
           way is that on which a ray sees its background
    rays   of a pulse, each with the same share of its power
    skirt  of them those of a halo, which have its share; None: there is none
    air    what the pulses go through, if it sends anything back
    """
    first = paths[0]
    ops = xp(first.range_m)

    def of_pulse(values: Lanes) -> Lanes:
        """What all rays of a pulse have alike."""
        return ops.column(values, 0, rays) if ops.width(values) > 1 else values

    weight: Lanes = 1.0 / rays
    if skirt is not None:
        weight = skirt.weight(ops.index(first.range_m) % rays, rays)

    def over_rays(values: Lanes) -> Lanes:
        if skirt is not None:
            return sum(ops.column(values * weight, ray, rays) for ray in range(rays))
        return sum(ops.column(values, ray, rays) for ray in range(rays)) * weight

    surfaces = [
        SubEchoes(range_m=path.range_m, peak_power_w=path.peak_power_w * weight, count=rays) for path in paths
    ]
    volume: Volume | None = None
    drops: list[SubEchoes] = []
    if air is not None:
        laser, optics = air.sensor.laser, air.sensor.optics
        scale = ops.full(air.pulse, 0.0) + radiometry.echo_power_w(
            peak_power_w=laser.peak_power_w,
            backscatter_per_sr=1.0,
            range_m=1.0,
            transmittance=air.ambient.transmittance,
            aperture_m2=of_pulse(beams.aperture_m2),
            efficiency=optics.efficiency_laser,
        )
        end_m = _end_m(first, air.light.far_m, rays, rays if skirt is None else rays - skirt.count)
        volume = air.light.volume(scale=scale, end_m=end_m)
        drops = air.light.sub_echoes(scale=scale, end_m=end_m, seed=air.seed, pulse=air.pulse)
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


def _end_m(path: Echoes, far_m: Lanes, rays: int, core: int) -> Lanes:
    """Where the last ray of each pulse meets a surface; the light around a beam's core makes no air bright."""
    ops = xp(path.range_m)
    last = ops.where(path.found, path.range_m, far_m)
    end = ops.column(last, 0, rays)
    for ray in range(1, core):
        end = ops.maximum(end, ops.column(last, ray, rays))
    return end
