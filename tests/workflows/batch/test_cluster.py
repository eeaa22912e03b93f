"""A scheduler that somebody else runs, and what may be wrong with it."""

import signal
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from distributed import Client

from fusion_core.model.errors import ScanLoomError
from fusion_core.workflows.batch.batch import BatchSummary, _tasks, run_batch
from fusion_core.workflows.batch.batch_folder import batch_folder
from fusion_core.workflows.batch.cache import RemoteCache
from fusion_core.workflows.batch.cluster import (
    _require_folder,
    _wait_for_a_worker,
    thread_count,
    workers_of,
)
from fusion_core.workflows.batch.in_flight import endings
from fusion_core.workflows.batch.items import find_items
from fusion_core.workflows.batch.settings import BatchSettings
from tests.patience import comes_true
from tests.workflows.batch.cluster_processes import Cluster
from tests.workflows.batch.stub_call import StubCall, write_recordings

SOON = BatchSettings(connect_s=0.5)


def message_of(scheduler: str, folder: Path, settings: BatchSettings = SOON) -> str:
    """The one line that a scheduler which cannot be used is refused with."""
    with pytest.raises(ScanLoomError) as raised, workers_of(scheduler, folder, settings):
        pass
    assert "\n" not in str(raised.value)
    return str(raised.value)


def test_nobody_listens(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        told = message_of(f"tcp://127.0.0.1:{port}", tmp_path)
    assert told.startswith(f"tcp://127.0.0.1:{port}: no scheduler answers within 0.5 s.")


def test_what_listens_says_nothing(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert "no scheduler answers" in message_of(f"tcp://127.0.0.1:{port}", tmp_path)


def test_what_listens_is_a_web_server(tmp_path: Path) -> None:
    def refuse(server: socket.socket) -> None:
        connection, _ = server.accept()
        with connection:
            connection.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")

    with socket.create_server(("127.0.0.1", 0)) as server:
        answering = threading.Thread(target=refuse, args=[server])
        answering.start()
        port = server.getsockname()[1]
        assert "no scheduler answers" in message_of(f"tcp://127.0.0.1:{port}", tmp_path)
        answering.join()


@pytest.mark.parametrize("address", ["", "here", "http://127.0.0.1:1", "tcp://127.0.0.1:none"])
def test_an_address_is_none(address: str, tmp_path: Path) -> None:
    assert "no scheduler answers" in message_of(address, tmp_path)


def test_there_is_no_worker(cluster: Cluster, tmp_path: Path) -> None:
    assert "has had no worker for 0.5 s." in message_of(cluster.address, tmp_path)


@pytest.mark.parametrize("what", ["project", pytest.param("python", marks=pytest.mark.slow)])
def test_a_worker_of_another_version_is_named(what: str, cluster: Cluster, tmp_path: Path) -> None:
    earlier = tmp_path / "earlier"
    if what == "project":
        installed = earlier / "scanloom-0.0.1.dist-info"
        installed.mkdir(parents=True)
        (installed / "METADATA").write_text(
            "Metadata-Version: 2.1\nName: scanloom\nVersion: 0.0.1\n"
        )
        expected = "the worker runs scanloom 0.0.1 on Python 3."
    else:
        earlier.mkdir()
        (earlier / "sitecustomize.py").write_text(
            "import platform\nplatform.python_version = lambda: '3.99.1'\n"
        )
        expected = "on Python 3.99.1, and this is scanloom"
    cluster.start_worker(PYTHONPATH=str(earlier))
    cluster.wait_for_workers(1)
    assert expected in message_of(cluster.address, tmp_path, BatchSettings())


def test_a_worker_does_not_see_the_folder(cluster: Cluster, tmp_path: Path) -> None:
    cluster.start_worker()
    cluster.wait_for_workers(1)
    told = message_of(cluster.address, tmp_path / "not_shared", BatchSettings())
    assert "the worker does not see the folder" in told


@pytest.mark.parametrize(
    "ask",
    [
        thread_count,
        lambda client: _require_folder(client, Path()),
        lambda client: _wait_for_a_worker(client, "", BatchSettings()),
    ],
)
def test_a_scheduler_is_lost_between_two_questions(
    ask: Callable[[Client], object], cluster: Cluster
) -> None:
    with Client(cluster.address, timeout=0.5, set_as_default=False) as client:
        assert thread_count(client) == 1
        cluster.processes[0].kill()
        with pytest.raises(ScanLoomError, match="the scheduler is lost"):
            ask(client)
        assert comes_true(lambda: client.status == "closed")
        with pytest.raises(ScanLoomError, match="the scheduler is lost"):
            ask(client)


def test_a_scheduler_is_lost_while_what_has_ended_is_seen_to(
    cluster: Cluster, stub: StubCall, tmp_path: Path
) -> None:
    cluster.start_worker()
    write_recordings(tmp_path / "data", *(f"good_{i:03}" for i in range(40)))
    cache = RemoteCache(folder=tmp_path / "cache", bytes_max=1)
    with (
        batch_folder(tmp_path / "out", stub.command),
        workers_of(cluster.address, tmp_path, BatchSettings(connect_s=2.0)) as client,
    ):
        tasks = _tasks(find_items([str(tmp_path / "data")]), stub, tmp_path / "out", cache)
        flow = endings(client, tasks, BatchSettings())
        assert next(flow).error is None
        cluster.processes[0].kill()
        assert comes_true(lambda: client.status == "closed")
        with pytest.raises(ScanLoomError, match="the scheduler is lost"):
            list(flow)


def test_a_scheduler_that_ends_leaves_what_is_done(
    cluster: Cluster, stub: StubCall, tmp_path: Path
) -> None:
    cluster.start_worker()
    data = write_recordings(tmp_path / "data", *(f"good_{i:03}" for i in range(40)))
    scheduler = cluster.processes[0]

    def end_it(done: int, total: int | None, what: str) -> None:
        if done == 3:
            scheduler.send_signal(signal.SIGKILL)

    def batch(progress: Callable[[int, int | None, str], None]) -> BatchSummary:
        return run_batch(
            find_items([str(data)]),
            stub,
            tmp_path / "out",
            BatchSettings(connect_s=5.0),
            scheduler=cluster.address,
            progress=progress,
        )

    with pytest.raises(ScanLoomError, match="the scheduler is lost"):
        batch(end_it)
    done = len(list((tmp_path / "out" / "outcomes").glob("*.json")))
    assert 3 <= done < 40
    assert threading.active_count() < 50
