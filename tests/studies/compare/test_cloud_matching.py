"""Files of clouds become observations: which pulses they share, and whose truth counts."""

import numpy as np
import pytest
from helpers.clouds import small_cloud

from lidarscene.detection.outcomes import Status
from lidarscene.studies.compare import cloud_matching
from lidarscene.studies.compare.cloud_matching import disagreeing_share, observe_clouds


def cloud_of_pulses(number: np.ndarray, **changed: object):
    """Echoes of pulses whose time is their number, all alike otherwise."""
    n = len(number)
    columns = {
        "azimuth_rad": np.zeros(n, np.float32),
        "elevation_rad": np.zeros(n, np.float32),
        "channel": np.zeros(n, np.uint16),
        "sensor_index": np.zeros(n, np.uint8),
        "time_s": number.astype(float),
        "status": np.full(n, Status.ECHO, np.uint8),
        "true_range_m": np.full(n, 10.0, np.float32),
    }
    return small_cloud(n=n, **columns | changed)


@pytest.mark.parametrize(("common", "matched"), [(5, True), (4, False)])
def test_clouds_match_from_a_twentieth_of_the_smaller_on(common: int, matched: bool) -> None:
    number = np.arange(300)
    observed = observe_clouds(["a", "b"], [cloud_of_pulses(number), cloud_of_pulses(np.arange(100) + 300 - common)])
    assert (observed[0].surfaces is not None) is matched


def test_truth_is_that_of_the_first_that_found_the_pulse() -> None:
    """Pulses 0 to 9 and 5 to 14; from 10 on only the second knows. Of the five of both one is a metre off."""
    further = np.full(10, 10.0, np.float32)
    further[4] = 11.0
    observed = observe_clouds(
        ["a", "b"], [cloud_of_pulses(np.arange(10)), cloud_of_pulses(np.arange(5, 15), true_range_m=further + 0.001)]
    )
    for observed_cloud in observed:
        assert observed_cloud.surfaces is not None
        expected = np.concatenate([np.full(10, 10.0), further[5:] + 0.001]).astype(np.float32)
        np.testing.assert_array_equal(observed_cloud.surfaces.true_range_m, expected)
    assert [int(observed_cloud.rated_surfaces.detected.sum()) for observed_cloud in observed] == [10, 10]
    assert disagreeing_share(*observed) == pytest.approx(0.2)


def test_names_are_numbered_alike_and_none_stays_none() -> None:
    body = np.array([0, 1, -1], np.int32)
    a, b = (cloud_of_pulses(np.arange(3), body=body, body_names=names) for names in (("car", "road"), ("tree", "car")))
    first, second = cloud_matching.with_common_names([a, b])
    assert first.body_names == second.body_names == ("car", "road", "tree")
    assert first.body.tolist() == [0, 1, -1]
    assert second.body.tolist() == [2, 0, -1]


@pytest.mark.parametrize("column", ["time_s", "channel", "azimuth_rad", "elevation_rad", "sensor_index"])
def test_points_that_differ_in_any_of_five_are_of_two_pulses(column: str) -> None:
    """The same number for both clouds where nothing differs; zeros of both signs are one."""
    number = np.zeros(3)
    values = np.array([0, 1, 0]).astype(getattr(cloud_of_pulses(number), column).dtype)
    first, second = cloud_matching._pulse_numbers(
        [cloud_of_pulses(number, **{column: values}), cloud_of_pulses(number, **{column: -0 * values})]
    )
    assert first[0] == first[2] == second[0] != first[1]
