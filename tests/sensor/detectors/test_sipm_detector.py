"""Few busy cells of many, in double and in single precision."""

import numpy as np
import pytest

from lidarscene import load_sensor
from lidarscene.kernel.device import transfer


@pytest.mark.parametrize("cells", [400, 10**6])
def test_few_busy_ones_of_many_cells_keep_their_digits(cells, mi):
    """Noise that rises through 1.3 cells at night, in double and in single precision; all less the free ones are not
    the busy ones there.
    """
    equipped = load_sensor("sipm-905", overrides=[f"detector.cells={cells}", "detector.dark_count_rate_hz=100"])
    rates = [
        sensor.working_point(dark).crossing_rate_hz(1.3 + dark, 1.0)
        for sensor, dark in ((equipped, np.zeros(2)), (transfer.opaque(equipped), mi.Float([0.0, 0.0])))
    ]
    np.testing.assert_allclose(rates[1].numpy(), rates[0], rtol=1e-5)
