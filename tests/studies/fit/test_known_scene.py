"""What is expected of a pulse, against the stages that draw it."""

import numpy as np
import pytest
from helpers.drawn_scenes import published

from lidarscene.detection.receivers import detect_alone
from lidarscene.studies.fit.known_scene import Scene, expected
from lidarscene.studies.ranging.plane import Target, echoes_of_plane

SHOTS = 4000


@pytest.mark.parametrize(("range_m", "klux"), [(8.0, 5.0), (25.0, 50.0), (60.0, 20.0)])
def test_expected_is_what_is_drawn(range_m: float, klux: float) -> None:
    """4 sigma of 4000 shots: means to 6 % of a deviation, deviations to 4.5 %, the mean of a signal of 60 to 0.9 %."""
    sensor = published()
    # Not all at one place of the bins.
    ranges = range_m + np.linspace(-0.1, 0.1, SHOTS)
    light = echoes_of_plane(sensor, Target(reflectivity=0.5, illuminance_klux=klux), ranges)
    seen = detect_alone(light, sensor, seed=3, pulse=np.arange(SHOTS, dtype=np.uint32))
    scene = Scene.of(light, sensor, np.zeros(SHOTS, int), spot_over_field=0.5)
    now = expected(scene, {"detector.jitter_ps": -20.0})
    first = seen.stops[0]
    assert np.asarray(first.reported).all()
    assert float(np.min(now.chance)) > 0.999
    signal = (np.asarray(first.photons) - now.signal) / np.sqrt(now.variance)
    background = (np.asarray(seen.ambient) - now.near_ir) / np.sqrt(now.near_ir)
    off = (np.asarray(first.range_m) - ranges) / now.sigma_m
    for name, values in (("signal", signal), ("near_ir", background)):
        assert abs(np.mean(values)) < 0.064, name
        assert np.std(values) == pytest.approx(1.0, abs=0.045), name
    assert np.std(off) == pytest.approx(1.0, abs=0.045)


def test_the_chance_is_that_of_the_stages() -> None:
    """Weak echoes: the share that is kept, to 4 sigma of 4000."""
    sensor = published()
    light = echoes_of_plane(sensor, Target(reflectivity=0.1, illuminance_klux=50.0), 53.0 * np.ones(SHOTS))
    scene = Scene.of(light, sensor, np.zeros(SHOTS, int), spot_over_field=0.5)
    chance = float(np.mean(expected(scene, {}).chance))
    seen = detect_alone(light, sensor, seed=3, pulse=np.arange(SHOTS, dtype=np.uint32)).stops[0]
    kept = np.mean(np.asarray(seen.reported) & (np.asarray(seen.status) == 0))
    assert 0.05 < chance < 0.95
    assert kept == pytest.approx(chance, abs=4.0 * np.sqrt(0.25 / SHOTS))
