"""A batch over recordings of which some fail, with a command that does what they say."""

import json
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from distributed import Client

from fusion_core.files.lock import acquire_lock
from fusion_core.model.errors import ExportError, ScanLoomError
from fusion_core.model.project import project_version
from fusion_core.workflows.batch.batch import BatchSummary, run_batch, stored_outcomes
from fusion_core.workflows.batch.cache import RemoteCache
from fusion_core.workflows.batch.cluster import local_workers, thread_count
from fusion_core.workflows.batch.in_flight import endings
from fusion_core.workflows.batch.input_state import InputStates
from fusion_core.workflows.batch.items import find_items
from fusion_core.workflows.batch.outcome_file import is_done
from fusion_core.workflows.batch.run_one import run_one
from fusion_core.workflows.batch.settings import BatchSettings
from fusion_core.workflows.batch.task import BatchTask
from tests.workflows.batch.stub_call import StubCall, write_recordings

CACHE = RemoteCache(folder=Path("/nonexistent"), bytes_max=0)
SETTINGS = BatchSettings(workers=2, worker_deaths_max=0)


def batch(data: Path, call: StubCall, output: Path) -> BatchSummary:
    return run_batch(find_items([str(data)]), call, output, SETTINGS)


def task_of(data: Path, call: StubCall, output: Path) -> BatchTask:
    (output / "outcomes").mkdir(parents=True, exist_ok=True)
    (item,) = find_items([str(data)])
    return BatchTask(
        item=item,
        call=call,
        folder=output,
        version=project_version(),
        input_state=InputStates().of(item, call),
        cache=CACHE,
    )


def test_a_failure_costs_its_recording_alone(stub: StubCall, tmp_path: Path) -> None:
    failing = ("bug_1", "damage_1", "error_1", "kill_1", "memory_1")
    data = write_recordings(tmp_path / "robot", *failing, *(f"good_{i}" for i in range(4)))
    output = tmp_path / "out"
    summary = batch(data, stub, output)
    assert (summary.total, summary.done, summary.skipped) == (9, 4, 0)
    assert [each.name for each in summary.failures] == [f"{name}.mcap" for name in failing]
    told = {each.name: str(each.error) for each in summary.failures}
    assert "ZeroDivisionError: of this test" in told["bug_1.mcap"]
    assert told["damage_1.mcap"] == "is damaged."
    assert told["error_1.mcap"] == "holds\\nnothing."
    assert "its worker process died each time" in told["kill_1.mcap"]
    assert "needs more memory" in told["memory_1.mcap"]
    assert not any("\n" in line for line in summary.lines())
    assert stub.count("kill_1.mcap") == 2

    outcomes = list(stored_outcomes(output, find_items([str(data)])))
    assert [each.name for each in outcomes if each.is_done] == [f"good_{i}.mcap" for i in range(4)]
    good = outcomes[5]
    assert good.result == {"size": 8, "warnings": ["a warning"]}
    assert good.warnings == ("a warning",)
    assert good.recorded_bytes == 8
    assert outcomes[2].advice == "Record again."

    # Called again, it tries what failed, and nothing else.
    (data / "kill_1.mcap").unlink()
    again = batch(data, stub, output)
    assert (again.total, again.done, again.skipped) == (8, 4, 4)
    assert [stub.count(f"good_{i}.mcap") for i in range(4)] == [1, 1, 1, 1]
    assert stub.count("error_1.mcap") >= 2


def test_what_changed_is_done_again(stub: StubCall, tmp_path: Path) -> None:
    data = write_recordings(tmp_path / "robot", "good")
    output = tmp_path / "out"

    def is_skipped(call: StubCall) -> bool:
        return is_done(task_of(data, call, output))

    assert not is_skipped(stub)
    run_one(task_of(data, stub, output))
    assert is_skipped(stub)
    assert not is_skipped(replace(stub, choice="another"))
    assert not is_skipped(replace(stub, is_repeated=True))
    (data / "good.mcap").write_bytes(b"\x89MCAP0\r\nmore")
    assert not is_skipped(stub)
    run_one(task_of(data, stub, output))
    assert is_skipped(stub)
    (output / "outcomes" / "good.mcap.json").write_text("[")
    assert not is_skipped(stub)


def test_results_that_are_gone_are_made_again(stub: StubCall, tmp_path: Path) -> None:
    task = task_of(
        write_recordings(tmp_path / "robot", "good"),
        replace(stub, command="fuse"),
        tmp_path / "out",
    )
    run_one(task)
    assert not is_done(task)
    task.output.mkdir(parents=True)
    (task.output / "manifest.json").write_text("{}")
    assert is_done(task)


def test_a_worker_of_another_version_fails_the_recording(stub: StubCall, tmp_path: Path) -> None:
    task = task_of(write_recordings(tmp_path / "robot", "good"), stub, tmp_path / "out")
    ending = run_one(replace(task, version="0.0.1"))
    assert "was sent by scanloom 0.0.1" in str(ending.error)
    assert stub.count("good.mcap") == 0


def test_only_a_bounded_number_is_on_its_way(
    threads: Client, stub: StubCall, tmp_path: Path
) -> None:
    data = write_recordings(tmp_path / "robot", "good")
    one = task_of(data, stub, tmp_path / "out")
    taken = 0

    def tasks() -> Iterator[BatchTask]:
        nonlocal taken
        for number in range(60):
            taken += 1
            yield replace(one, item=replace(one.item, name=f"good_{number}"))

    settings = BatchSettings(tasks_per_worker=2)
    seen = []
    for ended, ending in enumerate(endings(threads, tasks(), settings), start=1):
        seen.append(ending.name)
        assert taken - ended < 2 * 2
    assert sorted(seen) == sorted(f"good_{number}" for number in range(60))
    assert len(list((tmp_path / "out" / "outcomes").iterdir())) == 60


def test_a_full_disk_ends_the_batch_and_keeps_what_is_done(
    threads: Client, stub: StubCall, tmp_path: Path
) -> None:
    data = write_recordings(tmp_path / "robot", "a_good", "full_1", *(f"z_{i}" for i in range(20)))
    (tmp_path / "out" / "outcomes").mkdir(parents=True)
    items = find_items([str(data)])
    tasks = [
        BatchTask(
            item=item,
            call=stub,
            folder=tmp_path / "out",
            version=project_version(),
            input_state="x",
            cache=CACHE,
        )
        for item in items
    ]
    settings = BatchSettings(tasks_per_worker=1)
    assert len(list(endings(threads, iter(tasks[:1]), settings))) == 1
    with pytest.raises(ScanLoomError, match="No space left on device") as raised:
        list(endings(threads, iter(tasks[1:]), settings))
    assert "\n" not in str(raised.value)
    outcome = json.loads((tmp_path / "out" / "outcomes" / "a_good.mcap.json").read_text())
    assert outcome["outcome"]["error"] is None
    assert stub.count("z_19.mcap") == 0


def test_a_folder_is_of_one_batch_at_a_time_and_of_one_command(
    stub: StubCall, tmp_path: Path
) -> None:
    data, output = write_recordings(tmp_path / "robot", "error"), tmp_path / "out"
    batch(data, stub, output)
    with pytest.raises(ExportError, match="holds results of batch info"):
        batch(data, replace(stub, command="fuse"), output)
    held = acquire_lock(output / ".batch.lock")
    assert held is not None
    with pytest.raises(ExportError, match="is being written by another batch"):
        batch(data, stub, output)
    with pytest.raises(ExportError, match="holds files that no batch has written"):
        batch(data, stub, data)


def test_workers_listen_on_the_loopback_address_alone() -> None:
    with local_workers(SETTINGS) as client:
        own = psutil.Process()
        listening = {
            connection.laddr.ip
            for process in (own, *own.children(recursive=True))
            for connection in process.net_connections()
            if connection.status == psutil.CONN_LISTEN
        }
        assert listening == {"127.0.0.1"}
        assert client.scheduler_info()["address"].startswith("tls://")
        assert set(client.run(os.environ.get, "NUMBA_NUM_THREADS").values()) == {"1"}
        assert thread_count(client) == 2
