"""Kernels that the tests compile without optimisation compute what users' kernels do."""

import pytest
import quick_kernels
from helpers.child import assert_ended

RENDER = """
import hashlib
from lidarscene import Simulator, load_scene, load_sensor

sensor = load_sensor("table1-apd", overrides=["scanner.azimuth_step_deg=2", "scanner.elevation_step_deg=1"])
cloud = Simulator(load_scene("car"), sensor).render(seed=3)
assert len(cloud) > 100
print([hashlib.sha256(getattr(cloud, column.attribute).tobytes()).hexdigest() for column in cloud.columns])
"""


def test_optimised_kernels_compute_the_same(mi, run_python, tmp_path):
    """Bit by bit; and the kernels differ, so the options are in force."""
    if not quick_kernels.can_be_used():
        pytest.skip("no LLVM whose options are known")
    frames, kernels = [], []
    for optimised in ("0", "1"):
        folder = tmp_path / optimised
        ended = run_python(RENDER, DRJIT_CACHE_DIR=str(folder), **{quick_kernels.VARIABLE: optimised})
        assert_ended(ended, stderr=None)
        frames.append(ended.stdout)
        kernels.append({path.name: path.read_bytes() for path in folder.glob("*.bin")})
    assert frames[0] == frames[1]
    quick, users = kernels
    both = quick.keys() & users.keys()
    assert len(both) >= 10
    assert sum(quick[name] != users[name] for name in both) > 0.9 * len(both)
