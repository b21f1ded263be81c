"""Give every stream of random numbers in this process the run's seed, TEST_SEED: NumPy's, and those of frames.

A generator that is asked for with a seed gets that seed and the run's: streams of a run differ as before, and none is
that of another run. Without TEST_SEED nothing changes. Streams of Python's `random` are few: tests key these by
themselves. The program knows nothing of this: modules are changed when they are imported, here and in every process
that a test starts (see `sitecustomize`).

While TEST_SEED_READ names a file, a process that draws makes it.
"""

import importlib
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import on_import

RUN = os.environ.get("TEST_SEED") or None
READ = "TEST_SEED_READ"
_paused = False


def set_run(seed: int) -> None:
    """Draw the numbers of this run from now on, here and in processes that are started."""
    global RUN
    RUN = os.environ["TEST_SEED"] = str(seed)


def _note() -> None:
    """Leave a trace that somebody has drawn by the run's seed."""
    if path := os.environ.get(READ):
        Path(path).touch()


def pause(paused: bool) -> None:
    """Draw the numbers of no run while ``paused``, here and in processes that are started meanwhile."""
    global _paused
    _paused = paused
    if RUN is not None:
        os.environ["TEST_SEED"] = "" if paused else RUN


def frame_seed(seed: int) -> int:
    """Seed of a frame in this run, 32 bits: different for different seeds."""
    if _paused:
        return int(seed)
    _note()
    return (int(seed) ^ zlib.crc32(f"run {RUN}".encode())) & 0xFFFFFFFF


def _numpy(module: ModuleType) -> None:
    for name in ("default_rng", "SFC64"):
        setattr(module, name, _with_run(getattr(module, name)))


def _with_run(generator: Callable[..., Any]) -> Callable[..., Any]:
    def seeded(seed: Any = None) -> Any:
        if _paused or seed is None or hasattr(seed, "random") or hasattr(seed, "generate_state"):
            return generator(seed)  # no seed, or a stream that has its own
        _note()
        words = [seed] if isinstance(seed, int) or not hasattr(seed, "__len__") else list(seed)
        return generator([*words, int(RUN or 0)])

    return seeded


def _words(module: ModuleType) -> None:
    """Seeds of NumPy's path, and literals; a word on the device has its run from `_seed_word`."""
    words, on_device = module.words, importlib.import_module("lidarscene.maths.arrays").is_drjit

    def of_run(*, seed: Any, **counters: Any) -> Any:
        word, *rollover = seed if isinstance(seed, tuple) else (seed,)
        word = word if on_device(word) else frame_seed(word)
        return words(seed=(word, *rollover) if rollover else word, **counters)

    module.words = of_run  # type: ignore[attr-defined]


def _seed_word(module: ModuleType) -> None:
    """Seeds go to the device by one function. The run's word is folded in before, so it is no part of a kernel."""
    word = module.seed_word
    module.seed_word = lambda seed: word(frame_seed(seed))  # type: ignore[attr-defined]


def use() -> None:
    """Change the modules that draw random numbers, in a run that has a seed."""
    if RUN is not None:
        on_import.change("numpy.random", _numpy)
        on_import.change("lidarscene.maths.random", _words)
        on_import.change("lidarscene.kernel.device.transfer", _seed_word)
