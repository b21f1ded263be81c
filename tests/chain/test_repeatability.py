"""docs/validation.md, check 7, and "a second frame compiles nothing"."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import chain, launches, rounding, scanners, volley
from helpers.clouds import assert_same_columns
from helpers.documentation import ROOT
from helpers.run_seed import chosen
from helpers.traffic import EGO, traffic

from lidarscene import Simulator, load_scene, load_sensor
from lidarscene.detection import receiver
from lidarscene.light import beams, echoes
from lidarscene.light.hits import Hits
from lidarscene.rendering.stages import ambient_of
from lidarscene.scan.pattern import Pattern
from lidarscene.scene.scene import Air
from lidarscene.scene.weather import Weather

pytestmark = pytest.mark.usefixtures("mi")

RASTER = chain.raster(30, 20, 0.1)


def mixed_scene():
    return chain.scene(
        chain.facing(range_m=60.0, theta_deg=60.0, size_m=30.0, material="paper"),
        chain.ball(at=(30.0, 3.0, 0.0), radius_m=2.0),
        chain.box(at=(20.0, -3.0, 0.0), material="shiny"),
        materials=(
            chain.diffuse("paper", 0.8),
            chain.Material(
                name="shiny",
                bsdf="coated",
                reflectivity=chain.Spectrum.constant(0.3),
                parameters={"coat_ior": 1.5, "coat_roughness": 0.1},
            ),
        ),
        sky=0.1,
    )


@pytest.mark.parametrize(("name", "stops"), [("table1-apd", 1), ("table1-sipm", 3)])
def test_chunks_do_not_matter(name, stops):
    sensor = chain.sensor(name, *RASTER, "tdc.threshold_to_noise=3.5", f"tdc.stops={stops}", "tdc.jitter_ps=50")
    simulator = Simulator(mixed_scene(), sensor)
    whole = simulator.render(seed=3)
    assert np.count_nonzero(whole.status) > 50
    for chunk in (7919, 60_501, 60_500):
        assert_same_columns(whole, simulator.render(seed=3, chunk=chunk))


def test_chunks_shorter_than_a_tile_do_not_matter(mi):
    """Rationale: on the edge of two triangles a ray meets the one or the other by the rays that are traced with it."""
    scene = load_scene(ROOT / "scenes" / "retro.toml")
    simulator = Simulator(scene, load_sensor("table1-apd"))
    assert_same_columns(simulator.render(), simulator.render(chunk=4097))


def test_threads_do_not_matter(mi):
    import drjit as dr

    simulator = Simulator(mixed_scene(), chain.sensor("table1-apd", *RASTER))
    threads, clouds = dr.thread_count(), []
    try:
        for count in (4, 1):
            dr.set_thread_count(count)
            clouds.append(simulator.render(seed=5))
        assert_same_columns(*clouds)
    finally:
        dr.set_thread_count(threads)


def test_a_new_world_gives_the_same_cloud():
    sensor = chain.sensor("table1-apd", *RASTER)
    assert_same_columns(
        Simulator(mixed_scene(), sensor).render(seed=5), Simulator(mixed_scene(), sensor).render(seed=5)
    )


def test_seeds_matter():
    simulator = Simulator(mixed_scene(), chain.sensor("table1-apd", *RASTER))
    first, second = simulator.render(seed=0), simulator.render(seed=1)
    shared = min(len(first), len(second)) // 2
    assert np.mean(first.range_m[:shared] == second.range_m[:shared]) < 0.05


@pytest.mark.parametrize(
    ("name", "extra"),
    [
        ("table1-apd", ()),
        ("table1-sipm", ()),
        ("table1-sipm", ("detector.counting='binomial'",)),
        ("table1-sipm", ("detector.statistics='time_domain' detector.crosstalk=0.1",)),
    ],
)
def test_numpy_and_device_agree(name, extra):
    """The same stages on numpy, from the same hits: the same points but for the last bits.

    A lane may flip only where its edge lies within float32 rounding of the comparator's level. The walk is
    left in: correcting it from the amplitude of a saturated SiPM magnifies the last bits without bound.
    """
    sensor = chain.sensor(name, *RASTER, *extra, "tdc.threshold_to_noise=3.5", "tdc.stops=2", "tdc.walk='raw'")
    scene = mixed_scene()
    lanes = chain.run_stages(scene, sensor, seed=9)
    pulse = np.arange(sensor.scanner.pulses, dtype=np.uint32)
    rays = beams.fire(
        sensor, pulse=pulse, origin_m=(0.0, 0.0, 0.0), rotation=tuple(np.eye(3, dtype=np.float32).ravel())
    )
    direction = np.stack(rays.direction, axis=1)
    np.testing.assert_allclose(direction, lanes.direction, rtol=0.0, atol=rounding.limit(3e-7))
    hits: Hits = lanes.hits
    light = echoes.receive(rays, hits, sensor, ambient_of(scene, sensor))
    np.testing.assert_allclose(light.peak_power_w, lanes.light.peak_power_w, rtol=2e-6)
    np.testing.assert_allclose(light.background_power_w, lanes.light.background_power_w, rtol=2e-6)
    detection = receiver.detect(light, sensor, seed=9, pulse=pulse)
    np.testing.assert_allclose(detection.snr, lanes.detection.snr, rtol=1e-4, atol=1e-6)
    assert np.mean(detection.outcome != lanes.detection.outcome) < 2e-4
    np.testing.assert_allclose(lanes.detection.ambient, detection.ambient, rtol=1e-5, atol=1.0)
    for host, device in zip(detection.stops, lanes.detection.stops, strict=True):
        assert np.mean(host.reported != device.reported) < 2e-4
        in_both = host.reported & device.reported & (host.status == device.status)
        assert in_both.sum() > 0
        # An alarm's time is an exponential over its rate, and the rate a float32 tail: 1e-3 relative.
        allowed = 2e-3 + np.where(host.status == 1, 1e-3 * host.range_m, 0.0)
        difference = (np.abs(host.range_m - device.range_m) / allowed)[in_both]
        assert np.quantile(difference, 0.999) < 1.0


def sunny(klux):
    return replace(mixed_scene(), sun=replace(mixed_scene().sun, illuminance_klux=klux, azimuth_rad=klux / 50.0))


def wet(visibility_m, rain_mm_h):
    air = Air(weather=Weather(fog_visibility_m=visibility_m, rain_mm_h=rain_mm_h))
    return chain.scene(chain.facing(range_m=60.0, size_m=40.0), air=air)


def prisms(scale, **numbers):
    scanner = scanners.mid40(jitter_rad=1e-3 * scale, encoder_rad=1e-3 * scale, **numbers)
    return replace(chain.sensor("table1-apd"), scanner=scanner)


def coarse(words):
    """A sensor by its name and overrides, of a beam for each half of a degree."""
    name, *overrides = words.split()
    return chain.sensor(name, *chain.raster(30, 20, 0.5), *overrides)


APD = "table1-apd detector.gain=60 laser.peak_power_w=20 tdc.threshold_to_noise=6 optics.aperture_radius_mm=10"
CELLS = "table1-sipm detector.statistics='time_domain'"
BEAM = (
    "table1-apd tdc.stops=2 laser.divergence_mrad={} laser.exit_diameter_mm={} detector.radius_mm={} "
    "laser.energy_spread={}"
)
NUMBERS = {
    "receiver and sun": lambda: ((sunny(100.0), coarse("table1-apd")), (sunny(1.0), coarse(APD))),
    "cells": lambda: (
        (mixed_scene(), coarse(CELLS)),
        (mixed_scene(), coarse(f"{CELLS} detector.dead_time_ns=9 laser.pulse_fwhm_ns=4 detector.cells=900")),
    ),
    "prisms": lambda: (
        (mixed_scene(), prisms(1.0)),
        (mixed_scene(), prisms(2.0, index=[1.6, 1.7], rotation_hz=[10.0, -3.0])),
    ),
    "three rays, a field of view, fog and as many drops to draw": lambda: (
        (wet(300.0, 8.0), coarse(BEAM.format(3, 10, 0.1, 0.02))),
        (wet(200.0, 12.0), coarse(BEAM.format(4, 8, 0.2, 0.03))),
    ),
    "trajectories": lambda: (
        (traffic(), coarse("table1-apd")),
        (replace(traffic(), ego=replace(EGO, speed_m_s=11.0)), coarse("table1-apd")),
    ),
    "stray light": lambda: tuple(
        (mixed_scene(), volley.sensor(f"optics.stray.share={share}", f"laser.peak_power_w={power_w}"))
        for share, power_w in ((0.03, 20.0), (0.02, 15.0))
    ),
}


@pytest.mark.parametrize("case", chosen(2, [*NUMBERS]))
def test_other_numbers_compile_nothing(case):
    """Numbers of a scene and of a sensor file are data, in the same world too."""
    (scene, sensor), second = NUMBERS[case]()
    how = {"rays": 3, "background_rays": 7} if "rays" in case else {}
    simulator = Simulator(scene, sensor, **how)
    with launches.launched() as before:
        for _ in range(2):  # Dr.Jit puts columns of pulses that are traced again together in another order from then on
            simulator.render(seed=0, chunk=6000)
    with launches.launched(after=before):
        simulator.render(seed=1, number=2, chunk=5000)
        Simulator(*second, world=simulator.world, **how).render(seed=2)


ADC = "sampler.type='adc' sampler.rate_mhz=800 sampler.bits=10 sampler.full_scale=1e-5"
RECEIVERS = {
    "edge": (1, "table1-apd laser.peak_power_w=3"),
    "fraction behind a pole": (
        1,
        "table1-apd laser.peak_power_w=3 receiver.response='single_pole' tdc.timing='constant_fraction' tdc.stops=2",
    ),
    "matched filter behind a pole": (
        4097,
        "table1-apd laser.peak_power_w=3 receiver.response='single_pole' tdc.timing='matched_filter'",
    ),
    "peak of cells": (7, "table1-sipm laser.peak_power_w=3 receiver.response='gaussian' tdc.timing='peak'"),
    "samples": (3, f"table1-apd laser.peak_power_w=2 receiver.response='gaussian' {ADC}"),
    "histogram": (1, "os1-128 laser.peak_power_w=4"),
}


@pytest.mark.parametrize("case", chosen(2, list(RECEIVERS)))
def test_the_first_point_of_a_receiver_compiles_nothing(case, mi):
    """Whatever the number of lanes. The first frame of few pulses has no point, and later ones have: another simulator
    looks for seeds of which that is so. P_d is 0.15 to 0.5.
    """
    count, words = RECEIVERS[case]
    board = chain.scene(chain.facing(range_m=100.0, theta_deg=30.0, size_m=2000.0))
    pattern = Pattern.create(
        azimuth_rad=np.linspace(0.0, 0.9, count),
        elevation_rad=np.zeros(count),
        time_s=1e-6 * np.arange(count),
        frame_s=0.1,
    )
    sensor = chain.sensor(*words.split())
    # The directions of a pattern have no channels that fire together.
    sensor = replace(sensor, scanner=pattern, optics=replace(sensor.optics, stray=None))
    scout, empty, filled = Simulator(board, sensor), [], []
    while len(filled) < 4 or (not empty and count <= 3):
        seed = len(empty) + len(filled)
        assert seed < 500
        (filled if len(scout.render(seed=seed)) else empty).append(seed)
    simulator = Simulator(board, sensor)
    with launches.launched() as before:
        assert len(simulator.render(seed=empty[0] if count <= 3 else 0)) == 0 or count > 3
    with launches.launched(after=before):
        assert all(len(simulator.render(seed=seed)) > 0 for seed in filled)
