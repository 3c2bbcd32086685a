"""Workers: processes of this machine, or those of a running dask scheduler."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from carosac_toolkit.base.errors import CarosacError, InvalidField
from carosac_toolkit.base.extras import missing_extras, require

LOOPBACK_ADDRESS = "127.0.0.1"
CONNECT_TIMEOUT_S = 20.0  # [s]
PARALLEL_EXTRA = "parallel"
SINGLE_THREAD_ENVIRONMENT = {
    name: "1"
    for name in (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "BLIS_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "NUMEXPR_NUM_THREADS",
    )
}
"""Environment of workers. Warp runs CPU kernels in the thread that launches them."""

_DASK_CONFIG = {
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.deploy.lost-worker-timeout": "365 days",  # one that starts again is not lost
    "distributed.diagnostics.nvml": False,
    "distributed.nanny.pre-spawn-environ": {},
    "distributed.scheduler.allowed-failures": 1000,  # workers count the deaths of their cases
    "distributed.scheduler.http.routes": [],  # it serves no pages
    "distributed.scheduler.no-workers-timeout": "60s",
    "distributed.scheduler.work-stealing": True,
    "distributed.scheduler.worker-saturation": 1.0,  # the other cases wait at the scheduler
    "distributed.scheduler.worker-ttl": None,  # compiled code may hold the interpreter for long
    "distributed.worker.http.routes": [],
    "distributed.worker.preload": ["carosac_toolkit.studies.run.worker_setup"],
    "distributed.worker.profile.enabled": False,
}


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    from dask.system import CPU_COUNT

    return int(CPU_COUNT)


def has_parallel_packages() -> bool:
    """Return whether the packages of worker processes are installed."""
    return not missing_extras([PARALLEL_EXTRA])


def require_parallel_packages(user: str) -> None:
    """Refuse worker processes without their packages.

    Args:
        user: What needs them, for the message.

    Raises:
        MissingExtra: They are not installed.
    """
    require(user, "cryptography", "distributed")


def default_workers() -> int:
    """Return the number of worker processes where the user chose none.

    One per usable core, or 0 without the packages of worker processes: this process does it all.
    """
    return usable_cores() if has_parallel_packages() else 0


@contextmanager
def local_client(workers: int) -> Iterator[Any]:
    """Start worker processes with one thread each; they end with the block or with this process.

    They listen on random ports of the loopback interface alone, over TLS with a certificate that is
    made here, so that other users of this machine are refused. dask writes it and its key into
    folders that only this user can read, each for as long as the library for TLS reads it.

    Args:
        workers: Number of workers.

    Raises:
        MissingExtra: The packages of worker processes are not installed.
    """
    require_parallel_packages("a worker process")
    import dask
    from distributed import Client, LocalCluster, Security

    with (
        _environment(SINGLE_THREAD_ENVIRONMENT),
        _hidden_main(),
        _private_folder() as folder,
        dask.config.set(_DASK_CONFIG | {"temporary-directory": folder}),
    ):
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host=LOOPBACK_ADDRESS,
            security=Security.temporary(),
            dashboard_address=f"{LOOPBACK_ADDRESS}:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,  # none: the system ends what takes too much, and the case says so
            silence_logs=logging.CRITICAL,
        )
        with cluster, Client(cluster, set_as_default=False) as client:
            scheduler: Any = cluster.scheduler
            scheduler.http_server.stop()  # dask starts it in any case
            yield client


@contextmanager
def remote_client(address: str) -> Iterator[Any]:
    """Connect to a scheduler.

    Args:
        address: Such as ``tcp://host:8786``.

    Raises:
        InvalidField: No scheduler answers there.
        CarosacError: It has no workers.
        MissingExtra: The packages of worker processes are not installed.
    """
    require_parallel_packages("a dask scheduler")
    from distributed import Client
    from distributed.comm.addressing import parse_address, parse_host_port

    allowed = "address of a running dask scheduler, such as 'tcp://host:8786'"
    try:
        protocol, place = parse_address(address)
        if protocol in ("tcp", "tls"):
            parse_host_port(place)  # a client without a port hangs when it is closed
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InvalidField("scheduler", repr(address), f"{allowed} ({error})") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT_TIMEOUT_S)
        except TimeoutError as error:
            raise CarosacError(f"the scheduler at {address} has no workers") from error
        yield client


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables, which new processes inherit, for as long as the block lasts."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _private_folder() -> Iterator[str]:
    """Give a folder of this user alone, which goes with the block, for the scratch of dask.

    dask puts the scratch folders of workers and nannies first on the path of imports. By default
    they are in one folder of a fixed name that anybody may have made, and filled, before.
    """
    with tempfile.TemporaryDirectory(prefix="carosac-") as folder:
        try:
            yield folder
        finally:  # what is left would be another user's, once the folder is gone
            sys.path[:] = [x for x in sys.path if Path(folder) not in Path(x).parents]


@contextmanager
def _hidden_main() -> Iterator[None]:
    """Keep new processes from running the user's script again, guarded by __name__ or not."""
    main: dict[str, Any] = vars(sys.modules["__main__"])
    before: dict[str, Any] = {name: main[name] for name in ("__file__", "__spec__") if name in main}
    main.pop("__file__", None)
    main["__spec__"] = None
    try:
        yield
    finally:
        main.update(before)
