"""The shipped range.toml against the paper: Table 1's boards, every 50 m, through the whole chain."""

from pathlib import Path

import numpy as np
import pytest
from helpers import chain
from helpers.run_seed import chosen
from scipy import stats

from lidarscene import Simulator, load_scene, load_sensor
from lidarscene.physics.constants import SPEED_OF_LIGHT_M_S
from lidarscene.physics.electronics import tdc
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import Target

pytestmark = pytest.mark.usefixtures("mi")

SCENE = Path(__file__).parents[2] / "scenes" / "range.toml"


@pytest.fixture(scope="module")
def compiled():
    """The scene and its world."""
    scene = load_scene(SCENE)
    return scene, Simulator(scene, load_sensor("table1-apd")).world


@pytest.mark.parametrize("name", chosen(1, ["table1-apd", "table1-sipm"]))
def test_boards_of_the_range_scene(name, compiled):
    """SNR of every board equals (19) or (27) where its middle is hit, and its kept share equals P_d.

    Beams off a board's middle see it a little farther and aslant: below 0.4 % in SNR. The share is tested to
    4 standard errors, and by Poisson's tails where few beams are lost or few are kept, which are wider than those of a
    sum of draws of different probability: a false-alarm rate of at most 6e-5 for each of the 20 boards.
    """
    sensor = chain.sensor(name, "scanner.azimuth_step_deg=0.05", "scanner.elevation_step_deg=0.05")
    scene, world = compiled
    lanes = chain.run_stages(scene, sensor, seed=4, world=world)
    cloud = Simulator(scene, sensor, world=world).render(seed=4)
    range_m, snr = lanes.hits.range_m, lanes.detection.snr
    kept_total = 0
    for rho in (0.1, 0.8):
        for board_m in range(50, 501, 50):
            target = Target(reflectivity=rho)
            on_board = lanes.hits.has_surface & (np.abs(range_m - board_m) < 0.01 * board_m)
            on_board &= np.abs(lanes.hits.reflectivity - rho) < 0.01
            assert on_board.sum() > 300
            facing = on_board & (lanes.hits.cos_incidence > 0.9999)
            expected = plane.snr(sensor, target, board_m)[0]
            np.testing.assert_allclose(snr[facing], expected, rtol=4e-3)
            np.testing.assert_allclose(lanes.hits.cos_sun[on_board], 0.5, atol=1e-5)
            probability = lanes.detection.detection_probability[on_board].astype(float)
            before = 2.0 * board_m / SPEED_OF_LIGHT_M_S * float(sensor.tdc.bandwidth_hz)
            probability *= (1.0 - tdc.false_alarm_probability(threshold=5.0, noise=1.0)) ** before
            kept_count = np.count_nonzero(lanes.detection.outcome[on_board] == 0)
            rare, rare_count = min(
                (probability.sum(), kept_count), ((1.0 - probability).sum(), on_board.sum() - kept_count)
            )
            if rare < 30.0:
                tails = stats.poisson.cdf(rare_count, rare), stats.poisson.sf(rare_count - 1, rare)
                assert min(tails) > 3e-5
            else:
                error = np.sqrt(np.sum(probability * (1.0 - probability)))
                assert abs(rare_count - rare) < 4.0 * error
            kept_total += kept_count
    assert kept_total == np.count_nonzero(cloud.status == 0)


def test_the_limit_of_table_1_lies_where_the_paper_has_it(compiled):
    """10 % boards: the APD keeps most at 300 m and few at 400 m (limit 350.6 m); 80 % boards to beyond 500 m."""
    sensor = chain.sensor("table1-apd", "scanner.azimuth_step_deg=0.1", "scanner.elevation_step_deg=0.1")
    scene, world = compiled
    lanes = chain.run_stages(scene, sensor, seed=1, world=world)

    def kept_share(rho, board_m):
        on_board = lanes.hits.has_surface & (np.abs(lanes.hits.range_m - board_m) < 0.01 * board_m)
        on_board &= np.abs(lanes.hits.reflectivity - rho) < 0.01
        return np.mean(lanes.detection.outcome[on_board] == 0)

    assert kept_share(0.1, 300) > 0.85
    assert 0.3 < kept_share(0.1, 350) < 0.7
    assert kept_share(0.1, 400) < 0.25
    assert kept_share(0.8, 500) > 0.9
