"""A journal replayed by plain Python, from its rows as the databases' own drivers give them."""

import sqlite3
from collections import defaultdict
from contextlib import closing
from typing import Any

import psycopg

from fusion_core.model.labels import NO_LABEL, Capture
from tests.annotation.plain_labels import Sample


def replay(address: str) -> tuple[int, dict[str, dict[Sample, int]]]:
    """The newest action, and the labels in force by layer.

    Asserts that actions are numbered without gaps, that each has changes, that each change begins
    at the state then, and that an undo or redo is the inverse of its target.
    """
    layers = dict(_rows(address, "SELECT id, name FROM layer"))
    columns = 'id, sensor, topic, stamp_ns, "index", rows, columns'
    captures = {
        row[0]: Capture(*row[1:]) for row in _rows(address, f"SELECT {columns} FROM capture")
    }
    changes: dict[int, dict[Sample, tuple[int, int]]] = defaultdict(dict)
    columns = 'action_id, layer_id, capture_id, "row", "column", before, after'
    layer_of_changes = {}
    for number, layer, capture, row, column, *codes in _rows(
        address, f"SELECT {columns} FROM change"
    ):
        changes[number][captures[capture], row, column] = (codes[0], codes[1])
        assert layer_of_changes.setdefault(number, layer) == layer
    labels: dict[str, dict[Sample, int]] = {name: {} for name in layers.values()}
    actions = _rows(address, "SELECT id, layer_id, kind, target_id FROM action ORDER BY id")
    for expected, (number, layer, kind, target) in enumerate(actions, start=1):
        assert number == expected
        assert layer_of_changes[number] == layer
        in_layer = labels[layers[layer]]
        for sample, (before, after) in changes[number].items():
            assert in_layer.get(sample, NO_LABEL) == before != after
            in_layer[sample] = after
        assert (target is None) == (kind == "do")
        if target is not None:
            inverse = {sample: change[::-1] for sample, change in changes[target].items()}
            assert changes[number] == inverse
    assert len(changes) == len(actions)
    return len(actions), {
        name: {sample: code for sample, code in own.items() if code != NO_LABEL}
        for name, own in labels.items()
    }


def _rows(address: str, query: str) -> list[Any]:
    postgresql = address.startswith("postgresql")
    with closing(
        psycopg.connect(address) if postgresql else sqlite3.connect(address)
    ) as connection:
        return list(connection.execute(query))
