"""Pulse train: the light of all rays and paths of a pulse, and of the air, as one `EchoTrain`.

Rays are traced on lanes of their own, but a detector sees all light of a pulse at once. So the echoes of a pulse's rays
become sub-echoes of one pulse, each weighted with its ray's share of the power, and the air adds its own
(docs/theory_light.md 4 and 5).

Lanes of rays are pulse-major, lane = pulse lane * rays + ray, so ray i of all pulses is every ``rays``-th lane from i
on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

from ..maths.arrays import Array, Lanes, xp
from ..maths.random import Seed
from ..physics.optics import radiometry
from ..sensor.sensor_model import Sensor
from .air_light import AirLight
from .beams import Beams
from .echoes import Ambient, Echoes, EchoTrain, Fluctuation, SubEchoes, Volume, echo_share
from .footprint import Skirt


@dataclass(frozen=True, slots=True, kw_only=True)
class LitAir:
    """The air that some pulses pass.

    Attributes:
        light: backscatter of the air
        sensor: the sensor that fired the pulses
        ambient: light and air of the scene
        seed: 32-bit frame seed
        pulse: (n,) uint32 pulse numbers
    """

    light: AirLight
    sensor: Sensor
    ambient: Ambient
    seed: Seed
    pulse: Array


def join_echoes(
    paths: Sequence[Echoes], beams: Beams, *, rays: int, skirt: Skirt | None = None, air: LitAir | None = None
) -> EchoTrain:
    """Join the echoes of all rays and paths, and the light of the air, to one train for each pulse.

    Args:
        paths: Echoes of all rays for each path of their light, lane = pulse lane * rays + ray; the first path holds the
            background
        beams: the rays
        rays: number of rays of a pulse
        skirt: the rays of a halo among them; None: all rays share the power evenly
        air: the air that the pulses pass; None: it sends nothing back
    """
    # What all paths have in common (background, interference, calibration) stands on the first one.
    first = paths[0]
    ops = xp(first.range_m)

    def pulse_value(values: Lanes) -> Lanes:
        """Value for each pulse of a quantity that all of its rays share."""
        return ops.column(values, 0, rays) if ops.width(values) > 1 else values

    weight: Lanes = 1.0 / rays
    if skirt is not None:
        weight = skirt.weight(ops.index(first.range_m) % rays, rays)

    def ray_mean(values: Lanes) -> Lanes:
        """Mean over the rays of each pulse, weighted by their share of its power."""
        if skirt is not None:
            return sum(ops.column(values * weight, ray, rays) for ray in range(rays))
        return sum(ops.column(values, ray, rays) for ray in range(rays)) * weight

    # A ray's echo has the power of a whole pulse; as a sub-echo it has the ray's share of that.
    surfaces = [SubEchoes(range_m=path.range_m, peak_power_w=path.peak_power_w * weight, count=rays) for path in paths]
    volume: Volume | None = None
    drops: list[SubEchoes] = []
    # The light of the air rises and falls with the echoes': SNR and P_d of a return are those of one mean.
    fluctuation = _join_fluctuations(paths, weight, rays)
    if air is not None:
        laser, optics = air.sensor.laser, air.sensor.optics
        # P_t eta A tau: the lidar equation at 1 m for a backscatter of 1 per sr. Range and extinction are in the
        # course.
        scale = ops.full(air.pulse, 0.0) + radiometry.echo_power_w(
            peak_power_w=laser.peak_power_w,
            backscatter_per_sr=1.0,
            range_m=1.0,
            transmittance=air.ambient.transmittance,
            aperture_m2=pulse_value(beams.aperture_m2),
            efficiency=optics.echo_efficiency * pulse_value(echo_share(beams)),
        )
        if fluctuation is not None:
            scale = scale * fluctuation.relative_power
        end_m, edge = _ends(first, air.light.far_m, rays, rays if skirt is None else rays - skirt.count)
        volume = air.light.volume(scale=scale, end_m=end_m, edge=edge)
        drops = air.light.sub_echoes(scale=scale, end_m=end_m, edge=edge, seed=air.seed, pulse=air.pulse)
    # A pulse met a surface if any of its rays did, on any of its paths.
    ray_hits = [ops.column(path.has_surface, ray, rays) for path in paths for ray in range(rays)]
    has_surface = ray_hits[0]
    for ray_hit in ray_hits[1:]:
        has_surface = has_surface | ray_hit
    row_slope = _of_the_strongest(paths, [path.row_slope for path in paths])
    return EchoTrain(
        parts=(*surfaces, *drops),
        surfaces=len(paths) * rays,
        has_surface=has_surface,
        background_power_w=ray_mean(first.background_power_w),
        volume=volume,
        interference=tuple(
            replace(source, peak_power_w=pulse_value(source.peak_power_w)) for source in first.interference
        ),
        white_w_m2=pulse_value(first.white_w_m2),
        fluctuation=fluctuation,
        # A drop does not lean: its echo is as long as the pulse.
        broadening=_of_the_strongest([*paths, *drops], [*(path.broadening for path in paths), *(1.0 for _ in drops)]),
        row_slope=None if row_slope is None else ray_mean(row_slope),
    )


def _of_the_strongest(paths: Sequence[Echoes | SubEchoes], values: Sequence[Lanes | None]) -> Lanes | None:
    """Value of the strongest of each ray's paths, or of its echoes, for all of them; None without."""
    strongest, power_w = values[0], paths[0].peak_power_w
    for path, value in zip(paths[1:], values[1:], strict=True):
        if strongest is None or value is None:
            return None
        ops = xp(path.range_m)
        strongest = ops.where(path.peak_power_w > power_w, value, strongest)
        power_w = ops.maximum(path.peak_power_w, power_w)
    return strongest


def _join_fluctuations(paths: Sequence[Echoes], weight: Lanes, rays: int) -> Fluctuation | None:
    """Fluctuation of all echoes of each pulse, weighted by their mean powers; None without."""
    ops = xp(paths[0].range_m)
    mean_w: Lanes = 0.0
    drawn_w: Lanes = 0.0
    varying_w: Lanes = 0.0
    for path in paths:
        if path.fluctuation is None:
            return None
        drawn = path.peak_power_w * weight
        mean = drawn / path.fluctuation.relative_power
        for ray in range(rays):
            mean_w = mean_w + ops.column(mean, ray, rays)
            drawn_w = drawn_w + ops.column(drawn, ray, rays)
            varying_w = varying_w + ops.column(mean * path.fluctuation.variance, ray, rays)
    lit = mean_w > 0.0
    divisor = ops.where(lit, mean_w, 1.0)
    return Fluctuation(
        variance=ops.where(lit, varying_w / divisor, 0.0), relative_power=ops.where(lit, drawn_w / divisor, 1.0)
    )


def _ends(path: Echoes, far_m: Lanes, rays: int, core: int) -> tuple[Lanes, tuple[Lanes, Lanes] | None]:
    """`Volume.end_m` and `Volume.edge` of each pulse's ``core`` rays; a ray that meets nothing ends at ``far_m``.

    The nearest and the farthest end stand for all: with the share at the nearest for which the rays' mean of 1 / R is
    theirs, thin air returns the right energy, and two depths are exact (T50). Rays of a halo do not count: the light of
    the air has no halo.
    """
    ops = xp(path.range_m)
    last = ops.where(path.has_surface, path.range_m, far_m)
    if core == 1:
        return ops.column(last, 0, rays), None
    ends = [ops.column(last, ray, rays) for ray in range(core)]
    near_m, end_m = reduce(ops.minimum, ends), reduce(ops.maximum, ends)
    between = 1.0 / near_m - 1.0 / end_m
    mean = sum(1.0 / end for end in ends) * (1.0 / core) - 1.0 / end_m
    # Rounding of ranges that barely differ may take the share beyond 0 or 1.
    share = ops.where(between > 0.0, ops.minimum(ops.maximum(mean, 0.0) / ops.maximum(between, 1e-30), 1.0), 0.0)
    return end_m, (near_m, share)
