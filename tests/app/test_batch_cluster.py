"""``scanloom batch`` on a real scheduler with workers of their own, one of which is killed."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import fsspec
import psutil
import pytest
from moto.server import ThreadedMotoServer

from scanloom.cli import main
from tests.workflows.batch.cluster_processes import Cluster
from tests.workflows.batch.conftest import cluster
from tests.workflows.batch.unreadable_files import unreadable_files
from tests.workflows.box_recording import turning, write_boxes

__all__ = ["cluster"]

GOOD, ALL = 36, 40
OPTIONS = ("--motion", "none")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """40 recordings of four robots; four of them cannot be read."""
    folder = tmp_path_factory.mktemp("fleet") / "data"
    for number in range(GOOD):
        robot = folder / f"robot_{number % 4}"
        robot.mkdir(parents=True, exist_ok=True)
        duration_s = 0.3 + 0.1 * (number // 4 % 3)
        write_boxes(robot / f"run_{number:02}.mcap", drive=turning, duration_s=duration_s)
    whole = folder / "robot_0" / "run_00.mcap"
    for number, (name, content) in enumerate(unreadable_files(whole).items()):
        (folder / f"robot_{number}" / name).write_bytes(content)
    return folder


@pytest.fixture
def store(recordings: Path) -> Iterator[str]:
    """The same recordings in an object store of this machine."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    own = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    before = {name: os.environ.get(name) for name in own}
    os.environ.update(own)
    files = fsspec.filesystem("s3", skip_instance_cache=True)
    files.mkdir("fleet")
    files.put(f"{recordings}/", "fleet/data/", recursive=True)
    yield "s3://fleet/data"
    server.stop()
    for name, value in before.items():
        if value is None:
            del os.environ[name]
        else:
            os.environ[name] = value


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }


def times(output: Path) -> dict[str, int]:
    """When each file of what is done was changed."""
    done = [
        file
        for file in (output / "outcomes").iterdir()
        if json.loads(file.read_text())["outcome"]["error"] is None
    ]
    return {str(file): file.stat().st_mtime_ns for file in [*done, *(output / "runs").rglob("*")]}


def kill_when(output: Path, count: int, cluster: Cluster) -> threading.Thread:
    """Kills a worker with all that it started, once ``count`` outcomes are there."""

    def watch() -> None:
        tick = threading.Event()
        while len(list(output.glob("outcomes/*.json"))) < count:
            tick.wait(0.02)
        os.killpg(cluster.processes[1].pid, signal.SIGKILL)

    killer = threading.Thread(target=watch)
    killer.start()
    return killer


@pytest.mark.slow
def test_a_fleet_on_a_cluster_that_loses_a_worker(
    cluster: Cluster, recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        cluster.start_worker()
    cluster.wait_for_workers(2)
    output = tmp_path / "out"
    command = ["batch", str(recordings), "-o", str(output), "--run", "map"]
    command += ["--scheduler", cluster.address, "--", *OPTIONS]

    killer = kill_when(output, 5, cluster)
    assert main(command) == 1
    killer.join()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"recordings  {ALL}: {GOOD} done (0 of them before), 4 failed"
    failed = {line.split()[1]: line for line in lines if line.startswith("failed ")}
    assert failed.keys() == {
        "robot_0-truncated.mcap",
        "robot_1-empty.bag",
        "robot_2-wrong_bytes.db3",
        "robot_3-bomb.mcap",
    }
    assert len(list((output / "outcomes").iterdir())) == ALL

    # Nothing is redone, and what failed fails again.
    before = times(output)
    assert main(command) == 1
    assert f"{GOOD} done ({GOOD} of them before), 4 failed" in capsys.readouterr().out
    assert times(output) == before

    # Single runs write the same.
    for number in (0, 13, 35):
        recording = recordings / f"robot_{number % 4}" / f"run_{number:02}.mcap"
        single = tmp_path / f"single_{number}"
        assert main(["map", str(recording), "-o", str(single), *OPTIONS]) == 0
        run = output / "runs" / f"robot_{number % 4}-run_{number:02}.mcap"
        assert contents(run) == contents(single)


@pytest.mark.slow
def test_a_fleet_in_an_object_store(
    store: str, recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = tmp_path / "cache"
    options = ["--run", "map", "--workers", "2", "--cache", str(cache), "--", *OPTIONS]
    remote, local = tmp_path / "remote", tmp_path / "local"
    assert main(["batch", store, "-o", str(remote), *options]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0] == f"recordings  {ALL}: {GOOD} done (0 of them before), 4 failed"
    assert list(cache.iterdir()) == []
    assert main(["batch", str(recordings), "-o", str(local), *options]) == 1
    assert contents(remote / "runs") == contents(local / "runs")

    before = times(remote)
    capsys.readouterr()
    assert main(["batch", store, "-o", str(remote), *options]) == 1
    assert f"{GOOD} done ({GOOD} of them before)" in capsys.readouterr().out
    assert times(remote) == before


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_batch_that_is_stopped_keeps_what_is_done_and_leaves_nobody_behind(
    number: signal.Signals, recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    command = ["batch", str(recordings), "-o", str(output), "--run", "map", "--", *OPTIONS]
    process = subprocess.Popen(
        [sys.executable, "-m", "scanloom", *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    tick = threading.Event()
    while len(list(output.glob("outcomes/*.json"))) < 3:
        assert process.poll() is None
        tick.wait(0.02)
    workers = psutil.Process(process.pid).children(recursive=True)
    # As a terminal does: to all of them.
    os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGINT else 128 + number)
    assert said.splitlines()[-1] in (b"interrupted", b"ended by a signal")
    assert b"Traceback" not in said
    _, alive = psutil.wait_procs(workers, timeout=60)
    assert alive == []

    before = times(output)
    assert 0 < len(list((output / "outcomes").iterdir())) < ALL
    assert main(command) == 1
    assert f"{GOOD} done" in capsys.readouterr().out
    after = times(output)
    outcomes = [name for name in before if "/outcomes/" in name]
    assert outcomes
    assert {name: after[name] for name in outcomes} == {name: before[name] for name in outcomes}
