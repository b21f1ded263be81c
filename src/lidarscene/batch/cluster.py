"""Cluster: access to Dask. The address of a scheduler, or a number of processes on this machine, in; a client out."""

from __future__ import annotations

import asyncio
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from ..errors import LidarSceneError, OptionWarning, shorten, warn
from ..files.optional import is_installed, require_together

PATIENCE_S = 30
"""Longest wait for a scheduler's answer: Dask's own default."""

STARTS = 3
"""Attempts to start the processes of this machine, if some of them die before they are ready."""

LOCAL = {
    # By default profiling and ticks of scheduler and workers take 7 % of two cores.
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


def require_packages(extra: str = "", *, local: bool) -> None:
    """Raise one LidarSceneError that names all packages that are missing, with a command to install them.

    Args:
        extra: group of packages of the clouds' format; "" if it needs none
        local: whether the cluster runs on this machine, where connections are encrypted
    """
    # Without bokeh there are no pages, and all else works.
    require_together("batch", *filter(None, [extra]), without=("bokeh",) if local else ("bokeh", "cryptography"))


@contextmanager
def local_client(workers: int) -> Iterator[Any]:
    """Start processes on this machine and a client for them; they end with the client, even if it is killed."""
    import dask

    # Dask's defaults must be loaded first: on exit `set` removes a key that it was the first to add, and with it all
    # defaults that were added below that key meanwhile.
    import distributed  # noqa: F401

    with dask.config.set(LOCAL), ExitStack() as opened:
        for start in range(STARTS):
            try:
                client = opened.enter_context(_start_cluster(workers))
                break
            except Exception as error:  # Dask reports a worker that dies while it starts by various exceptions
                if start == STARTS - 1:
                    raise LidarSceneError(
                        f"{workers} worker processes could not be started: {shorten(_reason(error))}"
                    ) from error
        yield client


@contextmanager
def _start_cluster(workers: int) -> Iterator[Any]:
    from distributed import Client, LocalCluster, Security

    # Anyone who reaches a port of Dask can run code as its owner, and all users of a machine reach its loopback. So
    # scheduler, workers and nannies accept only connections with the key that this process makes. Workers get it
    # through the pipe by which they are started; it is in no argument, environment or lasting file.
    with (
        _HIDDEN_SCRIPT,
        LocalCluster(
            security=Security.temporary(),
            protocol="tls://",
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            preload=[f"{__package__}.work"],
            memory_limit=0,  # Dask would stop a worker at a share of the memory that one large frame may well need
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,  # frames that fail report the cause
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


class _HiddenScript:
    """Hides the running script from new processes, which would import it, and with it run its call of `batch` again.

    They ask for its ``__spec__`` and ``__file__`` (`multiprocessing.spawn.get_preparation_data`), which are None until
    the last of several jobs has ended. All else of the script stays, such as classes that are pickled.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs = 0
        self._names: dict[str, Any] = {}

    def __enter__(self) -> None:
        script = vars(sys.modules["__main__"])
        with self._lock:
            if self._jobs == 0:
                self._names = {name: script[name] for name in ("__spec__", "__file__") if name in script}
                script |= dict.fromkeys(self._names)
            self._jobs += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._jobs -= 1
            if self._jobs == 0:
                vars(sys.modules["__main__"]).update(self._names)


_HIDDEN_SCRIPT = _HiddenScript()


@contextmanager
def remote_client(address: str) -> Iterator[Any]:
    """Connect to a running scheduler.

    Raises:
        LidarSceneError: where none answers
    """
    from distributed import Client

    for handler in logging.getLogger("distributed").handlers:  # our own messages replace its log
        handler.setLevel(logging.CRITICAL)
    try:
        asyncio.run(_require_greeting(address))
        client = Client(address, timeout=PATIENCE_S)
    except (OSError, ValueError, TypeError) as error:
        raise LidarSceneError(f"no Dask scheduler answers at {address}: {_reason(error)}") from None
    if not client.scheduler.address.startswith(("tls:", "wss:")):
        warn(
            OptionWarning(
                "{scheduler} {0}: whoever reaches this port, or those of the workers, runs code as their owner; tls:// "
                "asks for a key (docs/clusters.md)",
                address,
            )
        )
    with client:
        yield client


async def _require_greeting(address: str) -> None:
    """Raise an error where no Dask answers: its client would wait for ever for a greeting from any other server."""
    from distributed.comm import connect
    from distributed.security import Security

    arguments = Security().get_connection_args("client")
    comm = await asyncio.wait_for(connect(address, timeout=PATIENCE_S, **arguments), 1.5 * PATIENCE_S)
    await comm.close()


def _reason(error: BaseException) -> str:
    """One line of the root cause: "connection refused" rather than a timeout."""
    while error.__cause__ is not None:
        error = error.__cause__
    return " ".join(str(error).split()) or "no answer"


def dashboard(client: Any) -> str:
    """Address of Dask's dashboard, or "" without one: it needs bokeh where the scheduler runs."""
    is_local = client.cluster is not None
    return "" if is_local and not is_installed("bokeh") else client.dashboard_link or ""
