"""Derivatives of what reaches the detector, and of SNR and P_d, against closed forms and differences on numpy."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import chain, trains
from helpers.run_seed import chosen

from lidarscene.detection import receiver
from lidarscene.kernel.device import transfer
from lidarscene.kernel.rays.trace import trace
from lidarscene.kernel.world.mitsuba_world import build_world
from lidarscene.light import beams, echoes
from lidarscene.light import pulse_train as trains_of
from lidarscene.light.beams import Beams
from lidarscene.light.echoes import Ambient
from lidarscene.light.footprint import footprint, spread
from lidarscene.light.hits import Hits
from lidarscene.maths.arrays import xp
from lidarscene.rendering.stages import ambient_of

pytestmark = pytest.mark.usefixtures("mi")

SINGLE = 1e-5
"""Single precision, through some tens of operations."""

EXTINCTION_PER_M = 1e-3
RANGES_M = np.array([5.0, 40.0, 90.0, 200.0])
RAYS = 3


def light_of(numbers, equipped):
    """`light.echoes.receive` of Lambertian surfaces under the sun: numpy or device arrays by name."""
    ops = xp(numbers["range_m"])
    hits = Hits(
        has_surface=numbers["range_m"] > 0.0,
        range_m=numbers["range_m"],
        cos_incidence=1.0,
        backscatter_per_sr=numbers["reflectivity"] / np.pi,
        sun_scatter_per_sr=0.5 * numbers["reflectivity"] / np.pi,
        reflectivity=numbers["reflectivity"],
        cos_sun=0.5,
        lit=True,
        face=0,
    )
    zero = ops.full(numbers["range_m"], 0.0)
    rays = Beams(
        pulse=None, origin_m=(zero,) * 3, direction=(zero + 1.0, zero, zero), aperture_m2=equipped.optics.aperture_m2
    )
    ambient = Ambient(
        sun_irradiance_w_m2=numbers["sun"],
        sky_irradiance_w_m2=0.1 * numbers["sun"],
        transmittance=0.98,
        extinction_per_m=EXTINCTION_PER_M,
    )
    return rays, ambient, echoes.receive(rays, hits, equipped, ambient)


def numbers_at(ranges_m=RANGES_M, reflectivity=0.3):
    ranges_m = np.asarray(ranges_m, dtype=np.float64)
    return {
        "range_m": ranges_m,
        "reflectivity": np.full(len(ranges_m), reflectivity),
        "sun": np.full(len(ranges_m), 10.0),
    }


def differentiate(numbers, result, mi):
    """The result on the device, and the derivative of each of its lanes by the number of the same lane."""
    import drjit as dr

    attached = {name: mi.Float(values.astype(np.float32)) for name, values in numbers.items()}
    for values in attached.values():
        dr.enable_grad(values)
    output = result(attached)
    dr.backward(dr.sum(output))
    slopes = {name: np.array(dr.grad(values).numpy(), dtype=float) for name, values in attached.items()}
    return np.array(dr.detach(output).numpy(), dtype=float), slopes


def test_power_of_an_echo(mi):
    """(5): P is in proportion to rho, and falls as exp(-2 alpha R) / R^2."""
    equipped = chain.sensor("table1-apd")
    numbers = numbers_at()
    power, slope = differentiate(
        numbers, lambda attached: light_of(attached, transfer.opaque(equipped))[2].peak_power_w, mi
    )
    np.testing.assert_allclose(slope["reflectivity"], power / 0.3, rtol=SINGLE)
    falling = -power * (2.0 / RANGES_M + 2.0 * EXTINCTION_PER_M)
    np.testing.assert_allclose(slope["range_m"], falling, rtol=SINGLE)
    np.testing.assert_array_equal(slope["sun"], 0.0)


def test_background_of_a_surface(mi):
    """(8) is linear in the sun, and in rho: all of it is the surface's."""
    equipped = chain.sensor("table1-apd")
    power, slope = differentiate(
        numbers_at(), lambda attached: light_of(attached, transfer.opaque(equipped))[2].background_power_w, mi
    )
    np.testing.assert_allclose(slope["sun"], power / 10.0, rtol=SINGLE)
    np.testing.assert_allclose(slope["reflectivity"], power / 0.3, rtol=SINGLE)


CASES = {
    "apd": ("table1-apd",),
    "sipm": ("table1-sipm",),
    "levels": ("table1-apd", "sampler.type='multi_level_tdc'", "sampler.levels=[2, 4]"),
    "chatter": ("table1-apd", "tdc.chatter_mhz=500"),
    "matched": ("table1-apd", "tdc.timing='matched_filter'"),
    "adc": ("table1-apd", "sampler.type='adc'", "sampler.rate_mhz=1000", "sampler.bits=12", "sampler.full_scale=1e-3"),
}


OF_A_PULSE = ("snr", "detection_probability")


@pytest.mark.parametrize("case", chosen(1, list(CASES)))
def test_many_rays_on_one_pulse(case, mi):
    """Slopes through the sum of sub-echoes and its peak, against central differences of the stage on numpy.

    Rays of a pulse meet surfaces up to a pulse's width apart, so that the place of the peak moves with each of them.
    """
    equipped = chain.sensor(*CASES[case])
    random = np.random.default_rng(5)
    apart = random.uniform(0.0, 2.0, (40, 1)) + random.uniform(0.0, 0.9, (40, RAYS))
    reflectivity = random.uniform(0.1, 0.6, apart.size)

    def numbers_around(range_m):
        return numbers_at((range_m + apart).ravel()) | {"reflectivity": reflectivity}

    def detect_rays(attached):
        on_device = not isinstance(attached["range_m"], np.ndarray)
        sensor = transfer.opaque(equipped) if on_device else equipped
        pulse = transfer.counter(0, 40) if on_device else np.arange(40, dtype=np.uint32)
        rays, _, light = light_of(attached, sensor)
        whole = trains_of.join_echoes([light], rays, rays=RAYS)
        return receiver.detect(whole, sensor, seed=0, pulse=pulse)

    far = (
        candidate
        for candidate in map(numbers_around, range(60, 1000, 20))
        if np.median(detect_rays(candidate).snr) < 5.5
    )
    numbers = next(far)
    host = detect_rays(numbers)
    outputs, slopes = {}, {}
    for name in OF_A_PULSE:
        outputs[name], slopes[name] = differentiate(
            numbers, lambda attached, name=name: getattr(detect_rays(attached), name), mi
        )
    np.testing.assert_allclose(outputs["snr"], host.snr, rtol=1e-4)
    # P_d moves by no more than the normal density, 0.4, of what the SNR is off.
    np.testing.assert_allclose(
        outputs["detection_probability"], host.detection_probability, rtol=0.0, atol=0.4e-4 * host.snr.max()
    )
    assert np.sum((outputs["detection_probability"] > 0.05) & (outputs["detection_probability"] < 0.95)) > 5
    for parameter, step in (("reflectivity", 1e-4), ("sun", 1e-3), ("range_m", 1e-4)):
        for ray in range(RAYS):
            moved = np.zeros(apart.size)
            moved[ray::RAYS] = step
            two = [detect_rays(numbers | {parameter: numbers[parameter] + sign * moved}) for sign in (1.0, -1.0)]
            for name in OF_A_PULSE:
                expected = (getattr(two[0], name) - getattr(two[1], name)) / (2.0 * step)
                # The tail of P_d is good to 1e-4 of its slope's height in single precision.
                np.testing.assert_allclose(
                    slopes[name][parameter][ray::RAYS], expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max()
                )


def test_reflectivity_of_a_traced_plane(mi):
    """Slopes from Mitsuba's own parameter, through footprint, waveform and comparator: an APD's SNR is in proportion to
    the reflectivity, less what the sun on the plane adds to the noise. In the dark it is that alone.
    """
    import drjit as dr

    equipped = chain.sensor("table1-apd", *chain.NARROW, "laser.divergence_mrad=2")
    described = chain.scene(chain.facing(range_m=60.0), klux=0.0)
    world = build_world(described, wavelength_m=equipped.laser.wavelength_m, centre_m=np.zeros(3))
    parameters = mi.traverse(world.scene)
    (key,) = (name for name in parameters.keys() if name.endswith("reflectance.value"))  # noqa: SIM118
    dr.enable_grad(parameters[key])
    parameters.update()
    sensor, rotation = transfer.opaque(equipped), transfer.opaque(tuple(np.eye(3).ravel().tolist()))
    pulse = transfer.counter(0, 9)
    of_ray, ray = transfer.repeat_lanes(pulse, 7)
    axes = beams.fire(sensor, pulse=of_ray, origin_m=transfer.opaque((0.0, 0.0, 0.0)), rotation=rotation)
    fan = spread(axes, footprint(equipped.laser, 7), ray=ray, rotation=rotation)
    hits, *_ = trace(world, fan, sun=transfer.opaque(tuple(float(x) for x in described.sun.direction)))
    ambient = transfer.opaque(ambient_of(described, equipped))
    light = echoes.receive(fan, hits, sensor, ambient)
    whole = trains_of.join_echoes([light], fan, rays=7)
    snr = receiver.detect(whole, sensor, seed=transfer.seed_word(0), pulse=pulse).snr
    dr.backward(dr.sum(snr))
    total = float(np.sum(dr.detach(snr).numpy()))
    assert float(np.sum(dr.grad(parameters[key]).numpy())) == pytest.approx(total / 0.1, rel=1e-4)


def test_what_a_converter_reports_has_none(mi):
    """Whether a threshold is crossed is a step, and the places that loops find are numbers: asked for their
    derivatives, Dr.Jit says that there are none, instead of 0.
    """
    import drjit as dr

    equipped = chain.sensor("table1-apd")
    light = trains.on_device(trains.train([[60.0, 60.5]], [[3e-7, 2e-7]]))
    scale = mi.Float(1.0)
    dr.enable_grad(scale)
    (part,) = light.parts
    light = replace(light, parts=(replace(part, peak_power_w=part.peak_power_w * scale),))
    detection = receiver.detect(
        light, transfer.opaque(equipped), seed=transfer.seed_word(0), pulse=transfer.counter(0, 1)
    )
    assert dr.grad_enabled(detection.snr)
    for output in (detection.stops[0].range_m, detection.stops[0].amplitude, detection.stops[0].snr):
        with pytest.raises(RuntimeError, match="does not depend"):
            dr.backward(output)
