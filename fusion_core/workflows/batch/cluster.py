"""The workers of a batch: processes of this machine, or those of a Dask scheduler that runs."""

import asyncio
import logging
import os
import platform
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

import dask
from distributed import Client, LocalCluster, rpc

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.project import PROJECT, project_version
from fusion_core.worker_processes import usable_cores
from fusion_core.workflows.batch import ignore_interrupts
from fusion_core.workflows.batch.settings import BatchSettings

_LOOPBACK = "127.0.0.1"
_GIB = 1 << 30


@contextmanager
def local_workers(settings: BatchSettings) -> Iterator[Client]:
    """Worker processes of this machine with a thread each, which end with the block.

    They and their scheduler listen on the loopback address alone, and take work only from who
    holds the keys of this run: on a machine of many users, an open port would run anybody's code.
    """
    config = {
        "distributed.scheduler.allowed-failures": settings.worker_deaths_max,
        # Of a worker that dies, only the recording at work is suspected, not the next one.
        "distributed.scheduler.worker-saturation": 1.0,
        "distributed.nanny.pre-spawn-environ.NUMBA_NUM_THREADS": 1,
        "distributed.worker.preload": [ignore_interrupts.__name__],
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    memory: str | int = "auto" if settings.memory_gib == 0 else int(settings.memory_gib * _GIB)
    with (
        dask.config.set(config),
        _quiet_logs(),
        LocalCluster(
            n_workers=settings.workers or usable_cores(),
            threads_per_worker=1,
            processes=True,
            host=_LOOPBACK,
            # Without pages, and without an address their server would listen on all.
            dashboard_address=f"{_LOOPBACK}:0",
            worker_dashboard_address=f"{_LOOPBACK}:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=memory,
            security=True,
            silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


@contextmanager
def workers_of(scheduler: str, folder: Path, settings: BatchSettings) -> Iterator[Client]:
    """The workers of the scheduler at an address such as ``tcp://10.0.0.5:8786``.

    Raises ScanLoomError where it does not answer, is lost, has no worker, or one of its workers has
    another version of this project or of Python, or does not see ``folder``.
    """
    with _quiet_logs():
        client = _connect(scheduler, settings)
        with client:
            _wait_for_a_worker(client, scheduler, settings)
            _require_same_versions(client)
            _require_folder(client, folder)
            yield client


def thread_count(client: Client) -> int:
    """How many recordings the workers that are there now do at a time; 1 where there is none.
    Raises ScanLoomError where the scheduler is lost."""
    with asking_scheduler(client):
        return max(1, sum(map(int, client.nthreads().values())))


@contextmanager
def asking_scheduler(client: Client) -> Iterator[None]:
    """A block that asks the scheduler of something. Raises ScanLoomError where it is lost."""
    if not is_connected(client):
        raise lost_scheduler(client)
    try:
        yield
    except OSError as error:
        raise lost_scheduler(client) from error


def is_connected(client: Client) -> bool:
    """Whether the scheduler is not known to be lost."""
    return bool(client.status == "running")


def lost_scheduler(client: Client) -> ScanLoomError:
    """The error for a scheduler that answered before and does not now."""
    return ScanLoomError(
        "the scheduler is lost.",
        file=client.scheduler.address if client.scheduler else None,
        advice="Call again: what is done is not done again.",
    )


def _connect(scheduler: str, settings: BatchSettings) -> Client:
    try:
        # The handshake of a client waits for ever where something silent listens.
        asyncio.run(asyncio.wait_for(_greet(scheduler), settings.connect_s))
        return Client(scheduler, timeout=settings.connect_s, set_as_default=False)
    except Exception as error:
        raise ScanLoomError(
            f"no scheduler answers within {settings.connect_s:g} s.",
            file=scheduler,
            advice="Start one with `dask scheduler`, and give its address, as tcp://10.0.0.5:8786.",
        ) from error


async def _greet(scheduler: str) -> None:
    async with rpc(scheduler) as remote:
        await remote.identity()


def _wait_for_a_worker(client: Client, scheduler: str, settings: BatchSettings) -> None:
    with asking_scheduler(client):
        try:
            client.wait_for_workers(1, timeout=settings.connect_s)
        except TimeoutError as error:
            raise ScanLoomError(
                f"has had no worker for {settings.connect_s:g} s.",
                file=scheduler,
                advice=f"Start some with `dask worker {scheduler}`.",
            ) from error


def _require_same_versions(client: Client) -> None:
    # Functions of the standard library: a worker need not have this project to be asked.
    projects = _ask(client, version, PROJECT)
    pythons = _ask(client, platform.python_version)
    own_python = ".".join(map(str, sys.version_info[:2]))
    for worker, project in projects.items():
        named = project if isinstance(project, str) else "without scanloom"
        python = str(pythons.get(worker, "unknown"))
        same_python = ".".join(python.split(".")[:2]) == own_python
        if named != project_version() or not same_python:
            theirs = f"scanloom {named}" if isinstance(project, str) else named
            raise ScanLoomError(
                f"the worker runs {theirs} on Python {python}, and this is scanloom "
                f"{project_version()} on Python {platform.python_version()}.",
                file=worker,
                advice="Install the same versions on all machines.",
            )


def _require_folder(client: Client, folder: Path) -> None:
    for worker, is_there in _ask(client, os.path.isdir, str(folder)).items():
        if is_there is not True:
            raise ScanLoomError(
                f"the worker does not see the folder {folder}.",
                file=worker,
                advice="Write to a folder that all machines share, under the same path.",
            )


def _ask(client: Client, function: Any, *values: object) -> Mapping[str, Any]:
    """What each worker answers; the exception where it cannot."""
    with asking_scheduler(client):
        answers: dict[str, Any] = client.run(function, *values, on_error="return")
        return answers


@contextmanager
def _quiet_logs() -> Iterator[None]:
    """What goes wrong is in the outcomes; the cluster's own log would drown them."""
    logger = logging.getLogger("distributed")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)
