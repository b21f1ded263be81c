"""Cluster: the door to Dask. An address of a scheduler, or a number of processes here, in; a client out."""

from __future__ import annotations

import asyncio
import importlib.util
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..errors import LidarSceneError, OptionWarning, shortened

PATIENCE_S = 30
"""How long a scheduler may take to answer: as long as Dask itself waits for it."""

STARTS = 3
"""How often the processes of this machine are started, if some of them die before they are ready."""

LOCAL = {
    # What scheduler and workers do beside the work takes 7 % of two cores if they look so often as by default.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "2s",
    # Arrays that are freed stay with the worker for the next frame. By default each goes back to the system and its
    # pages are cleared anew: 17,000 faults and a tenth of the time of a frame of 300,000 pulses.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 2**30,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 2**25,  # the most that glibc takes
    "distributed.nanny.pre-spawn-environ.RAYON_NUM_THREADS": 1,  # of what compresses LAZ
    # A worker that dies is started anew. By default Dask gives it up after 15 s, for good, though a busy machine takes
    # longer to start it; and a job without workers waits for ever.
    "distributed.deploy.lost-worker-timeout": "1d",
}
"""Settings of Dask for workers of this machine."""


def require_packages(*, local: bool) -> None:
    """Raise LidarSceneError, with what to install, where a package is missing.

    local  whether the cluster is one of this machine, which needs keys
    """
    names = ("distributed", "pyarrow", *(["cryptography"] if local else []))
    missing = [name for name in names if importlib.util.find_spec(name) is None]
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
    import dask

    # Its defaults must be there first: `set` takes off what it was the first to add, with all that came after.
    import distributed  # noqa: F401

    with dask.config.set(LOCAL), ExitStack() as opened:
        for start in range(STARTS):
            try:
                client = opened.enter_context(_started(workers))
                break
            except Exception as error:  # a worker that dies while it starts is told in many ways
                if start == STARTS - 1:
                    raise LidarSceneError(
                        f"--workers {workers}: the processes could not be started: {shortened(_reason(error))}"
                    ) from error
        yield client


@contextmanager
def _started(workers: int) -> Iterator[Any]:
    from distributed import Client, LocalCluster, Security

    # Whoever reaches a port of Dask runs code as its owner, and all users of a machine reach its loopback. So the
    # scheduler, the workers and their nannies accept only who has the key that this process makes for itself. Workers
    # get it through the pipe by which they are started; it is in no argument, environment or lasting file.
    with (
        LocalCluster(
            security=Security.temporary(),
            protocol="tls://",
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            preload=[f"{__package__}.work"],
            memory_limit=0,  # Dask would stop a worker at a share of the memory that one large frame may well need
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,  # what matters of it is told with the frames that fail
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


@contextmanager
def remote_client(address: str) -> Iterator[Any]:
    """A client of a scheduler that runs. Raises LidarSceneError where none answers."""
    from distributed import Client

    for handler in logging.getLogger("distributed").handlers:  # what matters is told in lines of our own
        handler.setLevel(logging.CRITICAL)
    try:
        asyncio.run(_greeted(address))
        client = Client(address, timeout=PATIENCE_S)
    except (OSError, ValueError, TypeError) as error:
        raise LidarSceneError(f"--scheduler {address}: no Dask scheduler answers there: {_reason(error)}") from None
    if not client.scheduler.address.startswith(("tls:", "wss:")):
        warnings.warn(
            OptionWarning(
                "{scheduler} {0}: whoever reaches this port, or those of the workers, runs code as their owner; tls:// "
                "asks for a key (docs/scaling.md)",
                address,
            ),
            stacklevel=2,
        )
    with client:
        yield client


async def _greeted(address: str) -> None:
    """Raise where no Dask answers: its client waits for ever for the greeting of something that listens and is none."""
    from distributed.comm import connect
    from distributed.security import Security

    how = Security().get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, timeout=PATIENCE_S, **how), 1.5 * PATIENCE_S)
    await comm.close()


def _reason(error: BaseException) -> str:
    """One line of the first cause: that no one listens rather than that it took too long."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(str(error).split()) or "no answer"


def dashboard(client: Any) -> str:
    """Where Dask shows its pages; "" where it cannot: they need bokeh, here or beside the scheduler of others."""
    here = client.cluster is not None
    return "" if here and importlib.util.find_spec("bokeh") is None else client.dashboard_link or ""
