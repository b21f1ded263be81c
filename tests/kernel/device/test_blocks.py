"""Blocks of lanes: how large they are, that Dr.Jit takes the size, and that results do not depend on it."""

import ctypes
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import chain
from helpers.traffic import SENSOR, traffic

from lidarscene import load_scene, load_sensor
from lidarscene.kernel.device import blocks
from lidarscene.kernel.device.backend import drjit, is_cuda
from lidarscene.rendering.render_options import FrameOptions
from lidarscene.rendering.simulator import Simulator

SCENES = Path(__file__).parents[3] / "scenes"


@pytest.mark.parametrize(
    ("lanes", "threads", "size"),
    [
        (1_000_000, 2, 4_096),  # Dr.Jit's own is four times as large
        (65_520, 2, 4_096),
        (30_400, 2, 2_048),
        (20_000, 2, 2_048),  # a Livox frame: ten blocks, where there were two
        (20_000, 16, 1_024),
        (231, 64, 1_024),
    ],
)
def test_blocks_for_every_thread(lanes: int, threads: int, size: int) -> None:
    assert blocks.block_size(lanes, threads) == size
    assert size in (
        blocks.SMALLEST_BLOCK,
        blocks.LARGEST_BLOCK,
    ) or lanes / size >= blocks.BLOCKS_PER_THREAD * threads > lanes / (2 * size)


@pytest.mark.usefixtures("mi")
def test_threads_for_the_work() -> None:
    """Never more than there were, and all of them again for a large frame; a number that somebody sets is the most."""
    if is_cuda():
        pytest.skip("threads are of CPUs")
    assert [blocks.thread_count(lanes, 8) for lanes in (1, 20_000, 10**6)] == [1, 4, 8]
    dr, before = drjit(), drjit().thread_count()
    try:
        for most in (5, 3):
            dr.set_thread_count(most)
            counts = []
            for lanes in (10**6, 9_000, 100, 10**6):
                blocks.share_frame(lanes)
                counts.append(dr.thread_count())
            assert counts == [most, 2, 1, most]
            blocks.rest()
            assert dr.thread_count() == 1
            blocks.share_out(100)
            assert dr.thread_count() == most
        blocks.rest()
        dr.set_thread_count(2)
        blocks.share_out(100)
        assert dr.thread_count() == 2
        blocks.share_frame(100)
        blocks.use_threads(1)  # as many as there are just then: no frame has more from now on
        blocks.share_frame(10**6)
        assert dr.thread_count() == 1
        dr.set_thread_count(5)
        blocks.use_threads(4)
        assert dr.thread_count() == 4
    finally:
        blocks.use_threads(before)


def test_threads_rest_while_python_works(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads end between the kernels of a frame, and before the next one begins; the kernels have all of them."""
    if is_cuda():
        pytest.skip("threads are of CPUs")
    simulator = Simulator(load_scene(SCENES / "glass.toml"), load_sensor("livox-mid-40"))
    dr, before = drjit(), drjit().thread_count()
    counts = list[tuple[str, int]]()

    def noted(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *args, **keywords: (counts.append((name, dr.thread_count())), call(*args, **keywords))[1]

    for name in ("_chain", "_trace_continuing", "_columns", "_started_together"):
        monkeypatch.setattr(simulator, name, noted(name, getattr(simulator, name)))
    try:
        blocks.use_threads(2)
        simulator.render(ahead=partial(simulator.begin, FrameOptions(number=1)))
        assert counts == [
            ("_chain", 2),
            ("_trace_continuing", 1),
            ("_chain", 2),
            ("_columns", 1),
            ("_started_together", 1),
            ("_chain", 2),
        ]
        assert dr.thread_count() == 2

        def interrupted(*_: Any) -> None:
            assert dr.thread_count() == 1
            raise KeyboardInterrupt

        monkeypatch.setattr(simulator, "_trace_continuing", interrupted)
        with pytest.raises(KeyboardInterrupt):
            simulator.render()
        assert dr.thread_count() == 2
    finally:
        blocks.use_threads(before)


@pytest.mark.usefixtures("mi")
def test_the_library_takes_the_size() -> None:
    """Its own answer, in lanes."""
    if is_cuda():
        pytest.skip("blocks are of CPUs")
    (path,) = Path(str(drjit().__file__)).parent.glob("libdrjit-core.*")
    size_function = ctypes.CDLL(str(path))._Z19jit_llvm_block_sizev
    size_function.restype = ctypes.c_uint32
    for lanes in (20_000, 1_000_000):
        blocks.share_out(lanes)
        assert size_function() == blocks.block_size(lanes, drjit().thread_count())


@pytest.mark.usefixtures("mi")
def test_results_do_not_depend_on_it(monkeypatch: pytest.MonkeyPatch) -> None:
    simulator = Simulator(traffic(), chain.sensor("table1-apd", *SENSOR))
    clouds = []
    for least in (16, blocks.LARGEST_BLOCK):
        monkeypatch.setattr(blocks, "SMALLEST_BLOCK", least)
        monkeypatch.setattr(blocks, "BLOCKS_PER_THREAD", 10_000)
        clouds.append(simulator.render(seed=3))
    assert len(clouds[0]) > 10_000
    for name in ("time_s", "range_m", "snr", "body", "in_shadow"):
        np.testing.assert_array_equal(getattr(clouds[0], name), getattr(clouds[1], name), err_msg=name)
