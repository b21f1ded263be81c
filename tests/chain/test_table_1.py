"""Table 1 between the exact range and closed forms; tests/studies/paper/test_claims.py has its numbers."""

from lidarscene import load_sensor
from lidarscene.studies.paper.numbers import closed_forms
from lidarscene.studies.ranging import plane
from lidarscene.studies.ranging.plane import RangeStatus, Target

APD, SIPM, TABLE_1 = load_sensor("table1-apd"), load_sensor("table1-sipm"), Target()


def test_closed_forms_are_upper_bounds():
    """They leave out every noise but the background's, so the exact range is shorter."""
    for sensor, bound in zip((APD, SIPM), closed_forms(as_printed=False), strict=True):
        assert 0.8 * bound < plane.maximum_range_m(sensor, TABLE_1)[0] < bound


def test_range_without_light_or_limit_is_a_status():
    assert plane.maximum_range_m(APD, Target(reflectivity=0.0))[1] == RangeStatus.NEVER_DETECTED
    silent = load_sensor("table1-sipm", overrides=["detector.dark_count_rate_hz=0"])
    assert plane.maximum_range_m(silent, Target(illuminance_klux=0.0))[1] == RangeStatus.NO_LIMIT
