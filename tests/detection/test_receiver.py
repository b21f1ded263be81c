"""Which way of detection a sensor takes, and receivers of several sizes in one process."""

import os
from pathlib import Path

import pytest
from helpers.child import assert_ended
from helpers.run_seed import chosen

from lidarscene import load_sensor
from lidarscene.detection import receiver

TESTS = Path(__file__).parents[1]

# Lone echoes far above the threshold; one line a receiver.
DETECT = """
import hashlib
import numpy as np
from lidarscene.kernel.device import backend, transfer
backend.mitsuba()
from helpers.trains import on_device, sensor, train
from lidarscene.detection import receiver

for name, setting, power_w in {cases}:
    equipped = sensor(name, setting)
    light = on_device(train(np.linspace(20.0, 60.0, 200)[:, None], np.full((200, 1), power_w)))
    seed, pulse = transfer.opaque_uint32(1), transfer.counter(0, 200)
    stop = receiver.detect(light, transfer.opaque(equipped), seed=seed, pulse=pulse).stops[0]
    columns = transfer.fetch_columns(dict(reported=stop.reported, range_m=stop.range_m, amplitude=stop.amplitude))
    digest = hashlib.sha256(b"".join(column.tobytes() for column in columns.values())).hexdigest()
    print(name, setting, columns["reported"].sum(), digest, flush=True)
"""

SIZES = [
    # From 10 samples to the most that a file may ask for. Their number is data: only the memory differs.
    [("vlp-16", f"sampler.rate_mhz={rate}", 2e-6) for rate in (500, 60_000)],
    # 18 and 32 bins.
    [("os1-128", f"histogram.bin_ns={width}", 1e-7) for width in (0.9, 0.4)],
]


@pytest.mark.parametrize("cases", chosen(1, SIZES))
def test_receivers_of_several_sizes_share_a_process(cases, mi, run_python, tmp_path):
    """Receivers run from the smallest memory to the largest, and back in a second process with the same kernels on the
    disk: the same bits, and both processes live. Kernels of a larger memory serve a smaller one well, so that the
    second process is the reference of the first.
    """
    outputs = []
    for order in (cases, cases[::-1]):
        process = run_python(
            DETECT.format(cases=order),
            PYTHONPATH=f"{TESTS.parent / 'src'}{os.pathsep}{TESTS}",
            HOME=str(tmp_path),
            LIDARSCENE_VARIANT=mi.variant(),
        )
        assert_ended(process, stderr=None)
        outputs.append(sorted(process.stdout.splitlines()))
    rising, falling = outputs
    assert rising == falling
    assert len({line.split()[-1] for line in rising}) == len(cases)
    assert all(int(line.split()[-2]) == 200 for line in rising), rising


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
    assert receiver.is_plain(load_sensor("table1-apd", overrides=overrides)) == plain
