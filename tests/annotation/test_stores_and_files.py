"""Labels from files into both kinds of store, and from one kind into the other."""

from pathlib import Path

import pytest

from fusion_core.annotation.identity import Author
from fusion_core.model.labels import Label
from fusion_core.model.progress import silent
from fusion_core.workflows.labels.adjudicate_layers import adjudicate_layers, disagreements_of
from fusion_core.workflows.labels.compare_layers import compare_layers
from fusion_core.workflows.labels.export_labels import ExportOptions, export_labels
from fusion_core.workflows.labels.import_labels import ImportOptions, import_labels
from fusion_core.workflows.labels.merge_stores import MergeOptions, merge_stores
from fusion_core.workflows.labels.open_store import open_labels
from tests.annotation.samples import IMAGE, SCAN, SECOND_SCAN, labels, state_of

LAYER = [
    labels(IMAGE, {(0, 0): 1, (0, 1): 1, (3, 4): 2}),
    labels(SCAN, {(0, 3): 0, (0, 4): 4}),
    labels(SECOND_SCAN, {(0, 0): 3}),
]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "room.mcap"
    path.write_bytes(b"beams and pixels")
    return path


def test_a_layer_goes_through_a_file_and_another_store(
    recording: Path, address: str, tmp_path: Path
) -> None:
    file, beside = tmp_path / "anna.csv", str(tmp_path / "beside.sqlite")
    with open_labels(recording, beside, create=True) as store:
        store.label("anna", LAYER, Author("anna"))
        expected = state_of(store, "anna")
    export_labels(recording, file, ExportOptions(address=beside), silent)
    assert import_labels(recording, file, ImportOptions(address=address), silent)["done"]
    with open_labels(recording, address, create=False) as store:
        assert state_of(store, "anna") == expected
        store.label("ben", LAYER[1:], Author("ben"))
    assert compare_layers(recording, address, (), silent)["percent"]["value"] == 1.0

    merge_stores(recording, address, MergeOptions(address=beside, layers=("ben",)), silent)
    with open_labels(recording, beside, create=False) as store:
        assert store.layers == ("anna", "ben")
        assert state_of(store, "ben") == {SCAN: expected[SCAN], SECOND_SCAN: expected[SECOND_SCAN]}


def test_a_majority_is_added_to_what_was_decided_by_hand(recording: Path, tmp_path: Path) -> None:
    with open_labels(recording, tmp_path / "labels.sqlite", create=True) as store:
        for name, codes in {
            "anna": [0, 1, 1, 2],
            "ben": [0, 1, 2, 2],
            "carl": [0, 3, 3, 3],
        }.items():
            beams = {(0, beam): code for beam, code in enumerate(codes)}
            store.label(name, [labels(SCAN, beams)], Author(name))
        names = store.layers
        store.label("agreed", [labels(SCAN, {(0, 0): 3, (0, 2): 2, (0, 9): 1})], Author("anna"))
        (first, second, third) = disagreements_of(store, names)
        assert second.column.tolist() == [2]
        assert second.said == {"anna": Label.HOLE, "ben": Label.BURR, "carl": Label.CONFLICT}
        assert (first.column.tolist(), third.column.tolist()) == ([1], [3])
        action = adjudicate_layers(store, names, "agreed", Author("anna", "automatic"))
        assert action is not None
        assert action.samples == 2
        by_hand = {(0, 0): 3, (0, 2): 2, (0, 9): 1}
        assert state_of(store, "agreed") == {SCAN: by_hand | {(0, 1): 1, (0, 3): 2}}
        assert adjudicate_layers(store, names, "agreed", Author("anna", "automatic")) is None
