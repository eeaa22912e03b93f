"""Programs and servers that are killed at any moment: what was acknowledged is in the journal."""

import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random

import pytest

from fusion_core.annotation.store import LabelStore
from tests.annotation.conftest import NewAddress
from tests.annotation.labelling_child import label_until_killed
from tests.annotation.plain_labels import PlainLabels, random_operation
from tests.annotation.postgresql_server import Server
from tests.annotation.replay import replay
from tests.annotation.samples import RECORDING

MANY = pytest.mark.slow
LATEST_KILL_S = 0.15


@pytest.fixture(scope="module")
def context() -> multiprocessing.context.ForkServerContext:
    """Children that have imported what they need."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.annotation.labelling_child"])
    return context


def run_and_kill(
    context: multiprocessing.context.ForkServerContext,
    address: str,
    seed: int,
    kill_server: Callable[[], None] | None = None,
) -> int:
    """Let a child label for a random time, and kill it, or the server below it. Returns the last
    action that it told, 0 if none; -1 if it had not opened the store."""
    own, told = context.Pipe(duplex=False)
    child = context.Process(target=label_until_killed, args=(address, seed, told))
    child.start()
    told.close()
    last = -1
    # From the first action on, the start of the opening, or the opened store.
    for _ in range((2, 0, 2, 1)[seed % 4]):
        last = max(last, _next(own))
    time.sleep(Random(-seed).uniform(0.0, LATEST_KILL_S))
    if kill_server is None:
        child.kill()
    else:
        kill_server()
    child.join(30)
    assert child.exitcode is not None
    while (number := _next(own)) >= 0:
        last = number
    own.close()
    child.close()
    return last


def _next(own: Connection) -> int:
    """What the child tells next, -1 if it has ended."""
    try:
        number: int = own.recv()
    except EOFError:
        return -1
    return number


def follow(model: PlainLabels, seed: int, upto: int) -> None:
    """Do in plain Python what the child of this seed has done until the action ``upto``."""
    random = Random(seed)
    while model.actions < upto:
        model.apply(random_operation(random))


def require_all_acknowledged(address: str, model: PlainLabels, seed: int, last: int) -> None:
    """The journal replays to the state after some of the child's actions, with all it has told."""
    head, layers = replay(address)
    assert head >= max(last, model.actions)
    # At most the action in flight was committed and not told.
    assert head <= max(last, model.actions) + 1
    follow(model, seed, head)
    for name in "ab":
        assert layers.get(name, {}) == model.in_force(name)


@pytest.mark.parametrize("kills", [4, pytest.param(200, marks=MANY)])
@pytest.mark.timeout(1800)
def test_a_killed_program_loses_nothing_it_has_told(
    context: multiprocessing.context.ForkServerContext, address: str, kills: int
) -> None:
    LabelStore.open(address, RECORDING, create=True).close()
    model, told = PlainLabels(), 0
    for seed in range(kills):
        last = run_and_kill(context, address, seed)
        told += last > 0
        require_all_acknowledged(address, model, seed, last)
    # Most were killed at work, not before.
    assert told > kills / 3
    print(f"{kills} kills, {model.actions} actions")


@pytest.mark.parametrize("kills", [2, pytest.param(40, marks=MANY)])
@pytest.mark.timeout(1800)
def test_a_killed_server_loses_nothing_it_has_told(
    context: multiprocessing.context.ForkServerContext,
    postgresql: Server,
    new_database: NewAddress,
    kills: int,
) -> None:
    address, model = new_database(), PlainLabels()
    LabelStore.open(address, RECORDING, create=True).close()
    for seed in range(kills):
        try:
            last = run_and_kill(context, address, seed, lambda: postgresql.stop("immediate"))
        finally:
            postgresql.start()
        require_all_acknowledged(address, model, seed, last)
    print(f"{kills} kills, {model.actions} actions")


@pytest.mark.parametrize("kills", [3, pytest.param(60, marks=MANY)])
@pytest.mark.timeout(1800)
def test_a_store_is_made_whole_or_not_at_all(
    context: multiprocessing.context.ForkServerContext, tmp_path: Path, kills: int
) -> None:
    random = Random(3)
    for seed in range(kills):
        path = tmp_path / f"{seed}" / "room.labels.sqlite"
        path.parent.mkdir()
        own, told = context.Pipe(duplex=False)
        child = context.Process(target=label_until_killed, args=(str(path), seed, told))
        child.start()
        told.close()
        time.sleep(random.uniform(0.0, 0.1))
        child.kill()
        child.join(30)
        own.close()
        LabelStore.open(path, RECORDING, create=True).close()
        replay(str(path))
        # What the killed one had begun is gone.
        assert [file.name for file in path.parent.iterdir()] == [path.name]
