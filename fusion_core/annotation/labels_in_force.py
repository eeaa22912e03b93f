"""The labels that are in force: what the newest change of each sample left."""

from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import groupby
from operator import itemgetter
from typing import Any, cast

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, Select, Subquery, func, select

from fusion_core.annotation import schema
from fusion_core.annotation.identity import is_storable
from fusion_core.model.conventions import IntArray
from fusion_core.model.errors import LabelStoreError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, SensorKind

ROWS_AT_ONCE = 20_000
"""Rows that are fetched together where all are streamed."""

_CAPTURE = schema.capture.c
CAPTURE_COLUMNS: tuple[ColumnElement[Any], ...] = (
    _CAPTURE.sensor,
    _CAPTURE.topic,
    _CAPTURE.stamp_ns,
    _CAPTURE["index"],
    _CAPTURE.rows,
    _CAPTURE.columns,
)


def capture_from(row: Row[Any] | tuple[Any, ...]) -> Capture:
    """A capture from CAPTURE_COLUMNS."""
    sensor, topic, stamp_ns, index, rows, columns = tuple(row)
    return Capture(cast(SensorKind, sensor), topic, stamp_ns, index, rows, columns)


def find_capture(connection: Connection, capture: Capture) -> int | None:
    """The number of a capture in the journal, None where nothing of it was ever labelled.

    Raises LabelStoreError where the journal has it with other rows or columns.
    """
    if not is_storable(capture.topic):
        return None
    row = connection.execute(
        select(_CAPTURE.id, _CAPTURE.rows, _CAPTURE.columns).where(
            _CAPTURE.sensor == capture.sensor,
            _CAPTURE.topic == capture.topic,
            _CAPTURE.stamp_ns == capture.stamp_ns,
            _CAPTURE["index"] == capture.index,
        )
    ).one_or_none()
    if row is None:
        return None
    if (row.rows, row.columns) != (capture.rows, capture.columns):
        raise LabelStoreError(
            f"the labels of {capture.topic} at {capture.stamp_ns} ns are for {row.rows} x "
            f"{row.columns} samples, not {capture.rows} x {capture.columns}.",
            advice="Take the recording that was labelled.",
        )
    return cast(int, row.id)


def find_layer(connection: Connection, name: str) -> int | None:
    """The number of a layer, None where nothing was ever labelled in it."""
    return connection.execute(
        select(schema.layer.c.id).where(schema.layer.c.name == name)
    ).scalar_one_or_none()


def labels_of_capture(
    connection: Connection, layer: str, capture: Capture, upto: int | None
) -> CaptureLabels:
    """The labels of one capture in a layer, as they were after the action ``upto``."""
    layer_id, capture_id = find_layer(connection, layer), find_capture(connection, capture)
    rows: Iterable[Row[Any]] = ()
    if layer_id is not None and capture_id is not None:
        own = schema.change.c.capture_id == capture_id
        rows = connection.execute(_by_place(_in_force(layer_id, upto, own)))
    return _labels(capture, rows)


def all_labels(connection: Connection, layer: str, upto: int | None) -> Iterator[CaptureLabels]:
    """All captures with labels in a layer, in the order of captures, streamed."""
    layer_id = find_layer(connection, layer)
    if layer_id is None:
        return
    labelled = _in_force(layer_id, upto)
    found = labelled.c
    place = (_CAPTURE.sensor, _CAPTURE.topic, _CAPTURE.stamp_ns, _CAPTURE["index"])
    statement = (
        select(found.row, found.column, found.after, *CAPTURE_COLUMNS)
        .join(schema.capture, _CAPTURE.id == found.capture_id)
        .order_by(*place, found.row, found.column)
    )
    streamed = connection.execute(statement, execution_options={"yield_per": ROWS_AT_ONCE})
    for identity, rows in groupby(streamed, key=itemgetter(slice(3, None))):
        yield _labels(capture_from(identity), (row[:3] for row in rows))


def codes_at(
    connection: Connection, layer_id: int, capture_id: int, samples: CaptureLabels
) -> IntArray:
    """(N,) codes that are in force for some samples of a capture, NO_LABEL where there is none."""
    change = schema.change.c
    row, column = samples.row, samples.column
    near = _in_force(
        layer_id,
        None,
        change.capture_id == capture_id,
        # One sample among many of its capture is found without reading the others.
        change.row.between(int(row.min()), int(row.max())),
        change.column.between(int(column.min()), int(column.max())),
    )
    labels = _labels(samples.capture, connection.execute(_by_place(near)))
    codes: IntArray = np.full(len(row), NO_LABEL)
    columns = samples.capture.columns
    known, wanted = labels.row * columns + labels.column, row * columns + column
    _, i_known, i_wanted = np.intersect1d(known, wanted, assume_unique=True, return_indices=True)
    codes[i_wanted] = labels.label[i_known]
    return codes


def count_codes(connection: Connection, layer: str) -> Counter[int]:
    """How many samples of a layer have each code of Label."""
    layer_id = find_layer(connection, layer)
    if layer_id is None:
        return Counter()
    after = _in_force(layer_id, None).c.after
    rows = connection.execute(select(after, func.count()).group_by(after))
    return Counter({row.after: row[1] for row in rows})


def count_between(connection: Connection, layer: str, after: int, upto: int) -> Counter[int]:
    """What the changes of the actions after ``after``, up to ``upto``, add to ``count_codes``;
    negative where they take away."""
    change, name = schema.change.c, schema.layer.c.name
    rows = connection.execute(
        select(name, change.before, change.after, func.count())
        .join(schema.layer, schema.layer.c.id == change.layer_id)
        # Without a condition on the layer: the actions are found by their numbers alone.
        .where(change.action_id.between(after + 1, upto))
        .group_by(name, change.before, change.after)
    )
    added: Counter[int] = Counter()
    for changed_layer, old, new, count in rows:
        if changed_layer == layer:
            added[old] -= count
            added[new] += count
    del added[NO_LABEL]
    return added


def _in_force(layer_id: int, upto: int | None, *conditions: ColumnElement[bool]) -> Subquery:
    """capture_id, row, column and after of the newest change of each labelled sample of a layer.

    A window over the index ``change_state``, whose order it has: a query for each sample's newer
    changes would make PostgreSQL compare all with all while it has no statistics of a young store.
    """
    change = schema.change.c
    if upto is not None:
        conditions += (change.action_id <= upto,)
    newer = func.lead(change.action_id).over(
        partition_by=(change.layer_id, change.capture_id, change.row, change.column),
        order_by=change.action_id,
    )
    changes = (
        select(change.capture_id, change.row, change.column, change.after, newer.label("newer"))
        .where(change.layer_id == layer_id, *conditions)
        .subquery()
    ).c
    return (
        select(changes.capture_id, changes.row, changes.column, changes.after)
        .where(changes.newer.is_(None), changes.after != NO_LABEL)
        .subquery("in_force")
    )


def _by_place(labelled: Subquery) -> Select[Any]:
    found = labelled.c
    return select(found.row, found.column, found.after).order_by(found.row, found.column)


def _labels(capture: Capture, rows: Iterable[Row[Any] | tuple[Any, ...]]) -> CaptureLabels:
    """From (row, column, code), in order."""
    array = np.array([tuple(row) for row in rows], dtype=np.int64).reshape(-1, 3)
    return CaptureLabels(
        capture=capture,
        row=array[:, 0].copy(),
        column=array[:, 1].copy(),
        label=array[:, 2].copy(),
    )
