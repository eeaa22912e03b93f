"""Recordings at addresses, copied to a bounded cache while they are read."""

import threading
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import fsspec
import pytest

from fusion_core.model.errors import RecordingError
from fusion_core.model.project import project_version
from fusion_core.workflows.batch.cache import RemoteCache, cache_space
from fusion_core.workflows.batch.input_state import InputStates
from fusion_core.workflows.batch.items import find_items
from fusion_core.workflows.batch.outcome_file import is_done
from fusion_core.workflows.batch.remote import local_copy, remote_state
from fusion_core.workflows.batch.run_one import run_one
from fusion_core.workflows.batch.task import BatchTask
from tests.workflows.batch.stub_call import StubCall, write_recordings


@pytest.fixture
def root() -> Iterator[str]:
    """An address of recordings in the store of this process."""
    files = fsspec.filesystem("memory")
    folder = f"/{uuid4().hex}"
    for name in ("robot_1/good_1.mcap", "robot_1/notes.txt", "robot_2/error_2.bag"):
        files.pipe(f"{folder}/{name}", name.encode())
    for name in ("metadata.yaml", "run_0.db3", "run_1.db3"):
        files.pipe(f"{folder}/robot_2/run/{name}", name.encode())
    yield f"memory:/{folder}"
    files.rm(folder, recursive=True)


@pytest.fixture
def cache(tmp_path: Path) -> RemoteCache:
    return RemoteCache(folder=tmp_path / "cache", bytes_max=100)


def test_a_folder_is_searched_by_names(root: str) -> None:
    found = {item.name: (item.place, item.robot) for item in find_items([root])}
    assert {name: robot for name, (_, robot) in found.items()} == {
        "robot_1-good_1.mcap": "robot_1",
        "robot_2-error_2.bag": "robot_2",
        "robot_2-run": "robot_2",
    }
    place, _ = found["robot_1-good_1.mcap"]
    assert find_items([place])[0].name == "good_1.mcap"
    matched = find_items([f"{root}/robot_*/*.mcap", f"{root}/*/run"])
    assert [item.name for item in matched] == ["robot_1-good_1.mcap", "robot_2-run"]


def test_addresses_and_paths_go_together(root: str, tmp_path: Path) -> None:
    data = write_recordings(tmp_path / "robot_1", "good_1")
    names = [item.name for item in find_items([root, str(data)])]
    assert names[0] == "good_1.mcap"
    assert len(set(names)) == 4


@pytest.mark.parametrize(
    ("address", "problem"),
    [
        ("memory://nowhere/at.all", "does not exist"),
        ("nostore://bucket/run.mcap", "Protocol not known"),
        ("memory://a::memory://b", "is a chain of addresses"),
        ("memory://nowhere/*.mcap", "has no file with a recording's suffix"),
    ],
)
def test_an_address_that_cannot_be_read_is_named(address: str, problem: str) -> None:
    with pytest.raises(RecordingError, match=problem) as raised:
        find_items([address])
    assert raised.value.file == address


def test_a_copy_is_there_while_it_is_read(root: str, cache: RemoteCache) -> None:
    with local_copy(f"{root}/robot_1/good_1.mcap", cache) as copy:
        assert copy.name == "good_1.mcap"
        assert copy.read_bytes() == b"robot_1/good_1.mcap"
    with local_copy(f"{root}/robot_2/run", cache) as copy:
        assert sorted(path.name for path in copy.iterdir()) == [
            "metadata.yaml",
            "run_0.db3",
            "run_1.db3",
        ]
    assert list(cache.folder.iterdir()) == []


def test_a_recording_larger_than_the_cache_is_refused(root: str, tmp_path: Path) -> None:
    small = RemoteCache(folder=tmp_path / "cache", bytes_max=18)
    with (
        pytest.raises(RecordingError, match="has 19 bytes, and the cache 18"),
        local_copy(f"{root}/robot_1/good_1.mcap", small),
    ):
        pass


def test_the_cache_is_never_fuller_than_its_bound(
    cache: RemoteCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits, entered = threading.Event(), threading.Event()

    def use() -> None:
        with cache_space(cache, 50):
            entered.set()

    third = threading.Thread(target=use)
    with cache_space(cache, 50), cache_space(cache, 50):
        monkeypatch.setattr("fusion_core.workflows.batch.cache.time.sleep", lambda _: waits.set())
        third.start()
        assert waits.wait(timeout=30)
        assert not entered.is_set()
    third.join()
    assert entered.is_set()
    assert list(cache.folder.iterdir()) == []


def test_a_recording_that_changes_while_it_is_copied_is_refused(
    root: str, cache: RemoteCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = fsspec.filesystem("memory")
    monkeypatch.setattr(
        type(files), "get_file", lambda _, remote, local: Path(local).write_bytes(b"short")
    )
    with (
        pytest.raises(RecordingError, match="was changed while it was copied"),
        local_copy(f"{root}/robot_1/good_1.mcap", cache),
    ):
        pass
    assert list(cache.folder.iterdir()) == []


def test_what_killed_processes_left_is_removed_and_nothing_else(cache: RemoteCache) -> None:
    abandoned = cache.folder / f"scanloom-100-{'0' * 16}"
    (abandoned / "copy").mkdir(parents=True)
    own = cache.folder / "photos"
    own.mkdir()
    with cache_space(cache, 100):
        assert not abandoned.exists()
    assert own.is_dir()
    assert not (own / "lock").exists()


def test_a_remote_recording_is_done_once(
    root: str, cache: RemoteCache, stub: StubCall, tmp_path: Path
) -> None:
    (tmp_path / "out" / "outcomes").mkdir(parents=True)

    def tasks() -> list[BatchTask]:
        states = InputStates()
        return [
            BatchTask(
                item=item,
                call=stub,
                folder=tmp_path / "out",
                version=project_version(),
                input_state=states.of(item, stub),
                cache=cache,
            )
            for item in find_items([root])
        ]

    endings = {ending.name: ending.error for ending in map(run_one, tasks())}
    assert endings == {
        "robot_1-good_1.mcap": None,
        "robot_2-error_2.bag": "holds\\nnothing.",
        "robot_2-run": None,
    }
    assert [is_done(task) for task in tasks()] == [True, False, True]
    before = remote_state(f"{root}/robot_1/good_1.mcap")
    files, path = fsspec.core.url_to_fs(f"{root}/robot_1/good_1.mcap")
    files.pipe(path, b"another content")
    assert remote_state(f"{root}/robot_1/good_1.mcap") != before
    assert [is_done(task) for task in tasks()] == [False, False, True]
