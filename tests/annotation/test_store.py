"""The label store, the same in SQLite and in PostgreSQL."""

from collections.abc import Iterator

import numpy as np
import pytest

from fusion_core.annotation.identity import Author
from fusion_core.annotation.store import LabelStore
from fusion_core.model.errors import LabelStoreError, SettingsError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from tests.annotation.samples import (
    ANNA,
    BEN,
    CAPTURES,
    IMAGE,
    RECORDING,
    SCAN,
    SECOND_SCAN,
    codes_of,
    labels,
    state_of,
)


@pytest.fixture
def store(address: str) -> Iterator[LabelStore]:
    with LabelStore.open(address, RECORDING, create=True) as opened:
        yield opened


def test_labels_are_there_when_the_store_is_opened_again(store: LabelStore, address: str) -> None:
    image, scan = {(0, 1): Label.BURR, (3, 4): Label.GOOD}, {(0, 11): Label.UNSURE}
    store.label("anna", [labels(IMAGE, image), labels(SCAN, scan)], ANNA)
    store.close()
    with LabelStore.open(address, RECORDING, create=False) as again:
        assert again.layers == ("anna",)
        assert state_of(again, "anna") == {IMAGE: image, SCAN: scan}
        assert codes_of(again.labels_of("anna", IMAGE)) == image
        assert codes_of(again.labels_of("anna", SECOND_SCAN)) == {}
        assert codes_of(again.labels_of("nobody", IMAGE)) == {}
        assert again.counts("anna") == dict.fromkeys(Label, 0) | {
            Label.BURR: 1,
            Label.GOOD: 1,
            Label.UNSURE: 1,
        }


def test_an_action_says_who_did_what_and_why(store: LabelStore) -> None:
    author = Author("anna", "automatic", "cd" * 32, "a first guess: 50 % sure")
    action = store.label("anna", [labels(SCAN, {(0, 1): 2}), labels(IMAGE, {(1, 1): 2})], author)
    assert action is not None
    assert (action.id, action.kind, action.target, action.samples) == (1, "do", None, 2)
    assert action.captures == (IMAGE, SCAN)
    assert (action.annotator, action.source) == ("anna", "automatic")
    assert (action.settings_sha256, action.comment) == ("cd" * 32, "a first guess: 50 % sure")
    assert list(store.actions()) == [action]


def test_what_changes_nothing_is_no_action(store: LabelStore) -> None:
    store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA)
    assert store.label("anna", [labels(SCAN, {(0, 1): 2})], ANNA) is None
    assert store.label("anna", [labels(SCAN, {})], ANNA) is None
    assert store.label("anna", [], ANNA) is None
    assert store.label("empty", [labels(SCAN, {(0, 2): NO_LABEL})], ANNA) is None
    again = store.label("anna", [labels(SCAN, {(0, 1): 2, (0, 3): 1})], ANNA)
    assert again is not None
    assert again.samples == 1
    assert (store.head(), store.layers) == (2, ("anna",))


def test_a_label_is_taken_away(store: LabelStore) -> None:
    store.label("anna", [labels(SCAN, {(0, 1): 2, (0, 2): 2})], ANNA)
    store.label("anna", [labels(SCAN, {(0, 1): NO_LABEL})], ANNA)
    assert state_of(store, "anna") == {SCAN: {(0, 2): 2}}
    (change,) = store.changes_of(2)
    assert (codes_of(change.before), codes_of(change.after)) == ({(0, 1): 2}, {(0, 1): NO_LABEL})
    assert store.changes_of(3) == ()


def test_of_a_capture_that_is_given_twice_the_later_labels_count(store: LabelStore) -> None:
    store.label("anna", [labels(SCAN, {(0, 1): 2, (0, 2): 2}), labels(SCAN, {(0, 1): 3})], ANNA)
    assert state_of(store, "anna") == {SCAN: {(0, 1): 3, (0, 2): 2}}


def test_undo_to_the_start_and_redo_to_the_end(store: LabelStore) -> None:
    states = [state_of(store, "anna")]
    for number in range(6):
        store.label(
            "anna", [labels(SCAN, {(0, number // 2): number % 3, (0, 9): number % 5})], ANNA
        )
        states.append(state_of(store, "anna"))
    for state in reversed(states[:-1]):
        assert store.undo("anna", "anna") is not None
        assert state_of(store, "anna") == state
    assert store.undo("anna", "anna") is None
    for state in states[1:]:
        assert store.redo("anna", "anna") is not None
        assert state_of(store, "anna") == state
    assert store.redo("anna", "anna") is None
    kinds = [action.kind for action in store.actions()]
    assert kinds == ["do"] * 6 + ["undo"] * 6 + ["redo"] * 6


def test_a_new_label_leaves_nothing_to_redo(store: LabelStore) -> None:
    store.label("anna", [labels(SCAN, {(0, 1): 1})], ANNA)
    store.label("anna", [labels(SCAN, {(0, 2): 1})], ANNA)
    store.undo("anna", "anna")
    store.label("anna", [labels(SCAN, {(0, 3): 1})], ANNA)
    assert store.redo("anna", "anna") is None
    tops = store.tops("anna", "anna")
    assert (tops.undo, tops.redo) == (4, None)
    store.undo("anna", "anna")
    assert state_of(store, "anna") == {SCAN: {(0, 1): 1}}


def test_what_somebody_else_has_changed_since_is_not_undone(store: LabelStore) -> None:
    store.label("joint", [labels(SCAN, {(0, 1): 1, (0, 2): 1})], ANNA)
    store.label("joint", [labels(SCAN, {(0, 2): 3})], BEN)
    with pytest.raises(LabelStoreError, match="undo would overwrite what ben has labelled"):
        store.undo("joint", "anna")
    assert store.head() == 2
    store.undo("joint", "ben")
    store.undo("joint", "anna")
    assert state_of(store, "joint") == {}
    store.label("joint", [labels(SCAN, {(0, 1): 2})], BEN)
    with pytest.raises(LabelStoreError, match="redo would overwrite what ben"):
        store.redo("joint", "anna")


def test_each_annotator_and_layer_has_an_undo_of_its_own(store: LabelStore) -> None:
    store.label("anna", [labels(SCAN, {(0, 1): 1})], ANNA)
    store.label("anna", [labels(SCAN, {(0, 2): 2})], BEN)
    store.label("ben", [labels(SCAN, {(0, 3): 3})], BEN)
    assert store.undo("ben", "anna") is None
    store.undo("anna", "anna")
    assert state_of(store, "anna") == {SCAN: {(0, 2): 2}}
    assert state_of(store, "ben") == {SCAN: {(0, 3): 3}}


def test_a_layer_for_a_run_does_not_follow_later_labels(store: LabelStore) -> None:
    store.label("anna", [labels(SCAN, {(0, 1): 1})], ANNA)
    before = store.layer("anna")
    store.label("anna", [labels(SCAN, {(0, 1): 2, (0, 2): 2})], ANNA)
    after = store.layer("anna")
    assert codes_of(before.labels_of(SCAN)) == {(0, 1): 1}
    assert codes_of(after.labels_of(SCAN)) == {(0, 1): 2, (0, 2): 2}
    assert before.sha256 != after.sha256
    store.undo("anna", "anna")
    assert store.layer("anna").sha256 == before.sha256


def test_layers_of_equal_labels_have_equal_digests(store: LabelStore) -> None:
    store.label("a", [labels(SCAN, {(0, 1): 1}), labels(IMAGE, {(1, 1): 2})], ANNA)
    store.label("b", [labels(IMAGE, {(1, 1): 2})], BEN)
    store.label("b", [labels(SCAN, {(0, 1): 1})], BEN)
    assert store.layer("a").sha256 == store.layer("b").sha256
    for different in ({(0, 2): 1}, {(0, 1): 2}, {(0, 1): 1, (0, 2): 1}):
        store.label("c", [labels(SCAN, {(0, beam): NO_LABEL for beam in range(12)})], BEN)
        store.label("c", [labels(SCAN, different), labels(IMAGE, {(1, 1): 2})], BEN)
        assert store.layer("c").sha256 != store.layer("a").sha256


def test_a_layer_that_does_not_exist_is_no_empty_layer(store: LabelStore) -> None:
    with pytest.raises(LabelStoreError, match=r"has no layer anna\. It has no labels yet"):
        store.layer("anna")
    store.label("anna", [labels(SCAN, {(0, 1): 1})], ANNA)
    with pytest.raises(LabelStoreError, match=r"has no layer ana\. There is anna\."):
        store.layer("ana")


def test_captures_come_in_their_order(store: LabelStore) -> None:
    scans = [
        Capture("lidar", topic, stamp, 0, 1, 4) for topic in ("/ß", "/Z", "/a") for stamp in (2, 1)
    ]
    for capture in (*scans, *CAPTURES):
        store.label("anna", [labels(capture, {(0, 1): 1})], ANNA)
    order = [given.capture for given in store.labelled("anna")]
    assert order == sorted([*scans, *CAPTURES])


def test_what_is_read_while_others_label_is_one_state(store: LabelStore) -> None:
    for capture in CAPTURES:
        store.label("anna", [labels(capture, {(0, 1): 1})], ANNA)
    read = store.labelled("anna")
    first = next(read)
    store.label("anna", [labels(capture, {(0, 1): 2}) for capture in CAPTURES], ANNA)
    assert [codes_of(given) for given in (first, *read)] == [{(0, 1): 1}] * 3


def test_the_journal_is_read_from_any_action_on(store: LabelStore) -> None:
    for beam in range(4):
        for author in (ANNA, BEN):
            store.label(author.annotator, [labels(SCAN, {(0, beam): 1})], author)
    assert [action.id for action in store.actions()] == list(range(1, 9))
    assert [action.id for action in store.actions("ben", after=3)] == [4, 6, 8]


def test_names_that_cannot_be_shown_are_refused(store: LabelStore) -> None:
    for name in ("", "  ", "a\nb", "x" * 81, "a\0", "\udcff", "\u202eevil"):
        with pytest.raises(SettingsError, match="cannot be the name of a layer"):
            store.label(name, [labels(SCAN, {(0, 1): 1})], ANNA)
        with pytest.raises(SettingsError, match="cannot be the name of an annotator"):
            Author(name)
    assert store.head() == 0


def test_names_that_look_alike_are_alike(store: LabelStore) -> None:
    store.label(" Andre\u0301 ", [labels(SCAN, {(0, 1): 1})], Author("Andre\u0301"))
    assert store.layers == ("Andr\u00e9",)
    assert codes_of(store.labels_of("Andre\u0301", SCAN)) == {(0, 1): 1}
    assert store.undo("Andr\u00e9", "Andr\u00e9 ") is not None


def test_texts_that_databases_cannot_keep_are_refused(store: LabelStore) -> None:
    for text in ("a\0b", "\udcff", "x" * 10_001):
        with pytest.raises(SettingsError, match="cannot be kept"):
            Author("anna", comment=text)
        capture = Capture("lidar", text, 1, 0, 1, 4)
        assert codes_of(store.labels_of("anna", capture)) == {}
        with pytest.raises(SettingsError, match="cannot be kept"):
            store.label("anna", [labels(capture, {(0, 1): 1})], ANNA)
    assert (store.head(), store.layers) == (0, ())


def test_a_capture_of_another_size_is_refused(store: LabelStore) -> None:
    store.label("anna", [labels(IMAGE, {(0, 1): 1})], ANNA)
    larger = Capture("depth", "/depth", 900, 0, 8, 10)
    with pytest.raises(LabelStoreError, match="for 4 x 5 samples, not 8 x 10"):
        store.label("anna", [labels(larger, {(0, 1): 1})], ANNA)
    with pytest.raises(LabelStoreError, match="for 4 x 5 samples, not 8 x 10"):
        store.labels_of("anna", larger)


def test_a_whole_image_is_one_action(store: LabelStore) -> None:
    image = Capture("depth", "/depth", 1, 0, 48, 64)
    codes = np.random.default_rng(1).integers(0, 5, (48, 64))
    store.label("anna", [CaptureLabels.of_image(image, codes)], ANNA)
    np.testing.assert_array_equal(store.labels_of("anna", image).as_image(), codes)
    store.undo("anna", "anna")
    assert state_of(store, "anna") == {}
