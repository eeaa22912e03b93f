"""What all tests share: reproducible examples, how they are shared out among processes, and the
recordings of SCANLOOM_TEST_DATA."""

import gc
import os
import signal
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from xdist.scheduler import LoadFileScheduling

from fusion_core import worker_processes

# The same examples in each run, and no clock: a slow machine is no failure. For more of them:
# --hypothesis-profile=thorough.
settings.register_profile("quick", deadline=None, derandomize=True, max_examples=30)
settings.register_profile("thorough", settings.get_profile("quick"), max_examples=100)
settings.load_profile("quick")

# Each of these is run by one process, which makes its browser, servers and recordings once.
TOGETHER = (
    "tests/annotation/",
    "tests/app/browser/",
    "tests/workflows/fuse/",
    "tests/workflows/map/",
)
# The longest come first, so that the processes end at the same time. While one of them compiles
# what fuse calls, the other reads recordings, which needs none of it.
FIRST = (
    "tests/app/browser/",
    "tests/recordings/",
    "tests/workflows/fuse/",
    "tests/workflows/map/",
    "tests/workflows/",
    "tests/hostile/",
)


class FoldersThenFiles(LoadFileScheduling):
    """Gives each process of ``-n`` a whole folder of TOGETHER, or a whole file."""

    def _split_scope(self, nodeid: str) -> str:
        folder = next((folder for folder in TOGETHER if nodeid.startswith(folder)), None)
        return folder or super()._split_scope(nodeid)


def pytest_configure() -> None:
    # Before numpy is imported, here and in all that is started: the cores are taken by the other
    # tests, and OpenBLAS's threads spin while they wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # What runs in the background, or beyond a terminal, ignores these, and hands that on to all
    # that the tests start.
    for number, handler in (
        (signal.SIGINT, signal.default_int_handler),
        (signal.SIGHUP, signal.SIG_DFL),
    ):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadFileScheduling | None:
    if config.getoption("dist") != "loadfile":
        return None
    # In the order of collection, not by the number of tests.
    config.option.loadscopereorder = False
    return FoldersThenFiles(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the garbage collector from what lives to the end: the tests, millions of objects.

    To look through them again and again takes as long as to collect them, and some of each test.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    def place(item: pytest.Item) -> int:
        return next((n for n, f in enumerate(FIRST) if item.nodeid.startswith(f)), len(FIRST))

    items.sort(key=place)


@pytest.fixture(scope="session", autouse=True)
def _one_core() -> Iterator[None]:
    """Work that could be shared out stays in this process, unless a test asks for workers.

    The cores are taken by the other tests, and a new process imports everything for a little work.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker_processes, "usable_cores", lambda: 1)
        yield


@pytest.fixture(scope="session", autouse=True)
def _mounts_are_kept() -> Iterator[None]:
    """What is aligned again has its mount from the first time: its search is tested by itself."""
    from fusion_core.workflows.fuse import align
    from tests.kept_mounts import KeptMounts

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(align, "estimate_mount", KeptMounts())
        yield


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder that holds rooms/ and real/. Tests that use it are marked ``data``."""
    folder = os.environ.get("SCANLOOM_TEST_DATA")
    if not folder:
        pytest.skip("SCANLOOM_TEST_DATA names no folder with rooms/ and real/")
    path = Path(folder)
    if not (path / "rooms").is_dir():
        pytest.fail(f"SCANLOOM_TEST_DATA={folder} has no folder rooms/")
    return path


@pytest.fixture(scope="session", params=["room_1", "room_2.bag", "room_3"])
def room_path(request: pytest.FixtureRequest, data_folder: Path) -> Path:
    """Each of the three rooms' recordings in turn."""
    return data_folder / "rooms" / str(request.param)


@pytest.fixture(scope="session")
def room_truth_path(room_path: Path) -> Path:
    """The truth of ``room_path``."""
    return room_path.with_name(f"{room_path.stem}.truth.npz")
