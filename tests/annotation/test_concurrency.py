"""Several threads and programs that label at once: no action is lost, none is seen half."""

import multiprocessing
import threading
from random import Random

from fusion_core.annotation.address import open_database
from fusion_core.annotation.identity import Author
from fusion_core.annotation.journal import newest_action
from fusion_core.annotation.labels_in_force import count_codes
from fusion_core.annotation.store import LabelStore
from fusion_core.model.labels import Capture
from tests.annotation.plain_labels import random_operation
from tests.annotation.replay import replay
from tests.annotation.samples import RECORDING, SCAN, codes_of, labels, state_of

WIDE = Capture("lidar", "/wide", 1, 0, 1, 400)


def act(address: str, seed: int, count: int) -> int:
    """Label, undo and redo at random; returns the number of actions."""
    random = Random(seed)
    with LabelStore.open(address, RECORDING, create=True) as store:
        return sum(random_operation(random).apply(store) is not None for _ in range(count))


def test_programs_that_label_at_once_share_one_journal(address: str) -> None:
    context = multiprocessing.get_context("forkserver")
    with context.Pool(2) as pool:
        done = pool.starmap(act, [(address, 1, 30), (address, 2, 30)])
    assert min(done) > 0
    actions, layers = replay(address)
    assert actions == sum(done)
    with LabelStore.open(address, RECORDING, create=False) as store:
        for layer, codes in layers.items():
            found = {
                (capture, *place): code
                for capture, own in state_of(store, layer).items()
                for place, code in own.items()
            }
            assert found == codes


def test_threads_share_a_store(address: str) -> None:
    def label(name: str, first: int) -> None:
        for beam in range(first, 12, 2):
            store.label("joint", [labels(WIDE, {(0, beam): 1})], Author(name))
            store.label(name, [labels(WIDE, {(0, beam): 2})], Author(name))

    with LabelStore.open(address, RECORDING, create=True) as store:
        threads = [
            threading.Thread(target=label, args=(name, first))
            for first, name in enumerate(("anna", "ben"))
        ]
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            # What is read meanwhile is whole: as many labels as actions.
            seen = store.layer("joint") if "joint" in store.layers else None
            if seen is not None:
                done = sum(action.id <= seen.upto for action in store.actions("joint"))
                assert len(seen.labels_of(WIDE).row) == done
        for thread in threads:
            thread.join()
        assert len(state_of(store, "joint")[WIDE]) == 12
        assert len(state_of(store, "ben")[WIDE]) == 6
    assert replay(address)[0] == 24


def test_what_is_read_together_is_of_one_state(address: str) -> None:
    with LabelStore.open(address, RECORDING, create=True) as store:
        store.label("anna", [labels(SCAN, {(0, 1): 1})], Author("anna"))
        database = open_database(address, RECORDING, create=False)
        with database.reading() as connection:
            head = newest_action(connection)
            store.label("anna", [labels(SCAN, {(0, 2): 1})], Author("anna"))
            assert count_codes(connection, "anna").total() == newest_action(connection) == head
        database.close()


def test_two_windows_of_one_person_share_what_can_be_undone(address: str) -> None:
    author = Author("anna")
    with (
        LabelStore.open(address, RECORDING, create=True) as first,
        LabelStore.open(address, RECORDING, create=True) as second,
    ):
        first.label("anna", [labels(SCAN, {(0, 1): 1})], author)
        seen = first.head()
        second.label("anna", [labels(SCAN, {(0, 1): 2})], author)
        assert first.head() > seen
        assert first.counts("anna") == second.counts("anna")
        assert first.undo("anna", "anna") is not None
        assert codes_of(second.labels_of("anna", SCAN)) == {(0, 1): 1}
        assert second.redo("anna", "anna") is not None
        assert codes_of(first.labels_of("anna", SCAN)) == {(0, 1): 2}
        assert first.tops("anna", "anna") == second.tops("anna", "anna")
