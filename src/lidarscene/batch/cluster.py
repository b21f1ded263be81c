"""Cluster: the door to Dask. An address of a scheduler, or a number of processes here, in; a client out."""

from __future__ import annotations

import importlib.util
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ..errors import LidarSceneError

PATIENCE_S = 30
"""How long a scheduler may take to answer."""


def require_packages() -> None:
    """Raise LidarSceneError, with what to install, where Dask or pyarrow is missing."""
    missing = [name for name in ("distributed", "pyarrow") if importlib.util.find_spec(name) is None]
    if missing:
        raise LidarSceneError(
            f"batch needs {' and '.join(missing)}; try: pip install 'lidarscene[batch]', or "
            f"pip install {' '.join(missing)}"
        )


def usable_cores() -> int:
    """Of this machine, by this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def local_client(workers: int) -> Iterator[Any]:
    """A client of so many processes of this machine, which end with it, also when it is killed."""
    from distributed import Client, LocalCluster

    with LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        preload=[f"{__package__}.work"],
        memory_limit=0,  # Dask would stop a worker at a share of the memory that one large frame may well need
        dashboard_address="127.0.0.1:0" if has_dashboard() else None,
        silence_logs=logging.CRITICAL,  # what matters of it is told with the frames that fail
    ) as cluster, Client(cluster) as client:  # fmt: skip
        yield client


@contextmanager
def remote_client(address: str) -> Iterator[Any]:
    """A client of a scheduler that runs. Raises LidarSceneError where none answers."""
    from distributed import Client

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = Client(address, timeout=PATIENCE_S)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split()) or "no answer"
        raise LidarSceneError(f"--scheduler {address}: no Dask scheduler answers there: {reason}") from None
    with client:
        yield client


def has_dashboard() -> bool:
    """Whether Dask can show its pages here: they need bokeh."""
    return importlib.util.find_spec("bokeh") is not None
