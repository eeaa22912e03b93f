"""Any history of several annotators, against plain Python."""

from collections.abc import Iterator
from itertools import count
from pathlib import Path
from random import Random
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.annotation.store import LabelStore
from fusion_core.model.labels import NO_LABEL, Label
from tests.annotation.plain_labels import Operation, PlainLabels, Sample, random_operation
from tests.annotation.replay import replay
from tests.annotation.samples import CAPTURES, RECORDING, SCAN

LAYERS, ANNOTATORS = ("a", "b"), ("anna", "ben")


def operations() -> st.SearchStrategy[list[Operation]]:
    """Few samples, so that they are met again and again."""
    samples = st.sampled_from([(SCAN, 0, 0), (SCAN, 0, 1), (CAPTURES[0], 1, 1)])
    codes = st.sampled_from([NO_LABEL, *map(int, Label)])
    who = (st.sampled_from(LAYERS), st.sampled_from(ANNOTATORS))
    kinds: tuple[Literal["undo", "redo"], ...] = ("undo", "redo")
    back = st.builds(Operation, st.sampled_from(kinds), *who)
    do = st.builds(Operation, st.just("do"), *who, st.dictionaries(samples, codes, min_size=1))
    return st.lists(do | do | back, max_size=15)


def labels_in(store: LabelStore, layer: str) -> dict[Sample, int]:
    """All labels of a layer, by sample."""
    return {
        (given.capture, row, column): code
        for given in store.labelled(layer)
        for row, column, code in zip(
            given.row.tolist(), given.column.tolist(), given.label.tolist(), strict=True
        )
    }


def require_equal(store: LabelStore, model: PlainLabels, address: str) -> None:
    """The store says what the model says, in each way in which it can be asked."""
    assert replay(address)[0] == store.head() == model.actions
    for layer in LAYERS:
        expected = model.in_force(layer)
        assert labels_in(store, layer) == expected
        assert replay(address)[1].get(layer, {}) == expected
        codes = list(expected.values())
        assert store.counts(layer) == {label: codes.count(label) for label in Label}
        for capture in CAPTURES:
            own = {sample: code for sample, code in expected.items() if sample[0] == capture}
            assert len(store.labels_of(layer, capture).row) == len(own)


@pytest.fixture(scope="module")
def numbered(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Files of which each is new."""
    folder = tmp_path_factory.mktemp("stores")
    return (folder / f"{number}.sqlite" for number in count())


@given(history=operations())
def test_any_history_is_as_in_plain_python(
    numbered: Iterator[Path], history: list[Operation]
) -> None:
    address, model = str(next(numbered)), PlainLabels()
    with LabelStore.open(address, RECORDING, create=True) as store:
        for operation in history:
            assert operation.apply(store) == model.apply(operation)
            # Counts are kept up from action to action.
            store.counts(operation.layer)
        require_equal(store, model, address)
        for layer in LAYERS:
            for annotator in ANNOTATORS:
                for kind in ("undo", "redo"):
                    top = getattr(store.tops(layer, annotator), kind)
                    before = store.head()
                    back = Operation(kind, layer, annotator)
                    done = back.apply(store)
                    assert done == model.apply(back)
                    # Without a top there is nothing to do; with one, others may stand in the way.
                    assert top is not None or done is None
                    assert store.head() == before + (done is not None)


def test_a_long_history_is_as_in_plain_python(address: str) -> None:
    model, random = PlainLabels(), Random(7)
    with LabelStore.open(address, RECORDING, create=True) as store:
        for _ in range(100):
            operation = random_operation(random)
            assert operation.apply(store) == model.apply(operation)
        require_equal(store, model, address)
    with LabelStore.open(address, RECORDING, create=False) as store:
        require_equal(store, model, address)
