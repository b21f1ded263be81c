"""Which way of detection a sensor takes."""

import pytest

from lidarscene import load_sensor
from lidarscene.detection import receivers


@pytest.mark.parametrize(
    ("overrides", "plain"),
    [
        ([], True),
        (["tdc.timing='peak'", "tdc.stops=3"], True),
        (["tdc.keep='last'"], False),
        (["tdc.keep='strongest'"], False),
        (["receiver.ac_coupling_khz=100"], False),
        (["receiver.response='gaussian'"], True),
        (["sampler.type='multi_level_tdc'", "sampler.levels=[2]"], False),
    ],
)
def test_what_a_lone_echo_has_a_closed_form_for(overrides: list[str], plain: bool) -> None:
    """The first edge, whatever is timed of it; not a later return, a baseline that recovers, or samples."""
    assert receivers.is_plain(load_sensor("table1-apd", overrides=overrides)) == plain
