"""The journal's actions: appended in a transaction that is alone in writing, and read again."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import ARRAY, Connection, Integer, Row, Table, func, insert, literal, select

from fusion_core.annotation import schema
from fusion_core.annotation.action import Action, ActionKind, CaptureChange
from fusion_core.annotation.identity import Author, require_storable
from fusion_core.annotation.labels_in_force import (
    CAPTURE_COLUMNS,
    ROWS_AT_ONCE,
    capture_from,
    codes_at,
    find_capture,
    find_layer,
)
from fusion_core.annotation.undo_stacks import find_tops
from fusion_core.model.conventions import IntArray
from fusion_core.model.errors import LabelStoreError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels
from fusion_core.model.project import project_version

_ACTION = schema.action.c
_CHANGE = schema.change.c


class _Layer(NamedTuple):
    id: int
    name: str


class _Link(NamedTuple):
    """How an action lies in its annotator's stacks: see undo_stacks."""

    kind: ActionKind
    target: int | None
    below: int | None


def newest_action(connection: Connection) -> int:
    """The number of the newest action, 0 where there is none."""
    newest = connection.execute(select(func.max(_ACTION.id))).scalar_one()
    return 0 if newest is None else int(newest)


def append_labels(
    connection: Connection, layer: str, labels: Sequence[CaptureLabels], author: Author
) -> Action | None:
    """Label samples. What is labelled so already is left out; None where nothing is left."""
    layer_id, changes = find_layer(connection, layer), []
    for after in _by_capture(labels):
        before = _labels_now(connection, layer_id, after)
        changed = before.label != after.label
        if changed.any():
            changes.append(
                CaptureChange(before=before.subset(changed), after=after.subset(changed))
            )
    if not changes:
        return None
    if layer_id is None:
        layer_id = _insert_numbered(connection, schema.layer, {"name": layer})
    link = _Link("do", None, find_tops(connection, layer, author.annotator).below("do"))
    return _append(connection, _Layer(layer_id, layer), link, changes, author)


def append_inverse(
    connection: Connection, layer: str, kind: ActionKind, annotator: str
) -> Action | None:
    """Take back what the annotator did last, or undid last. None where there is nothing.

    Raises LabelStoreError where a label is no longer as that action left it.
    """
    tops = find_tops(connection, layer, annotator)
    target = tops.undo if kind == "undo" else tops.redo
    if target is None:
        return None
    layer_id = find_layer(connection, layer)
    assert layer_id is not None, "the target is an action in it"
    changes = [change.inverse for change in changes_of_action(connection, target)]
    for change in changes:
        _require_unchanged(connection, _Layer(layer_id, layer), kind, change.before)
    link = _Link(kind, target, tops.below(kind))
    return _append(connection, _Layer(layer_id, layer), link, changes, Author(annotator))


def changes_of_action(connection: Connection, action_id: int) -> tuple[CaptureChange, ...]:
    """What an action changed, in the order of captures."""
    rows = connection.execute(
        select(_CHANGE.row, _CHANGE.column, _CHANGE.before, _CHANGE.after, *CAPTURE_COLUMNS)
        .join(schema.capture, schema.capture.c.id == _CHANGE.capture_id)
        .where(_CHANGE.action_id == action_id)
        .order_by(_CHANGE.capture_id, _CHANGE.row, _CHANGE.column)
    )
    changes = [
        _change(capture_from(identity), group)
        for identity, group in groupby(rows, key=itemgetter(slice(4, None)))
    ]
    return tuple(sorted(changes, key=lambda change: change.capture))


def stream_actions(connection: Connection, layer: str | None, after: int) -> Iterator[Action]:
    """The actions whose number is above ``after``, in order; of one layer, or of all."""
    touched = (
        select(_CHANGE.action_id, _CHANGE.capture_id, func.count().label("samples"))
        .where(_CHANGE.action_id > after)
        .group_by(_CHANGE.action_id, _CHANGE.capture_id)
        .subquery()
    )
    statement = (
        select(
            schema.layer.c.name.label("layer_name"),
            schema.action,
            touched.c.samples,
            *CAPTURE_COLUMNS,
        )
        .select_from(schema.action)
        .join(schema.layer, schema.layer.c.id == _ACTION.layer_id)
        .join(touched, touched.c.action_id == _ACTION.id)
        .join(schema.capture, schema.capture.c.id == touched.c.capture_id)
        .where(_ACTION.id > after)
        .order_by(_ACTION.id)
    )
    if layer is not None:
        statement = statement.where(schema.layer.c.name == layer)
    rows = connection.execute(statement, execution_options={"yield_per": ROWS_AT_ONCE})
    for _, group in groupby(rows, key=lambda row: row.id):
        yield _action(list(group))


def _by_capture(labels: Sequence[CaptureLabels]) -> Iterator[CaptureLabels]:
    """Each capture once; where one is given several times, the later labels count."""
    by_capture: dict[Capture, list[CaptureLabels]] = {}
    for given in labels:
        by_capture.setdefault(given.capture, []).append(given)
    for capture, parts in sorted(by_capture.items()):
        if any(len(part.row) for part in parts):
            yield CaptureLabels.of_samples(
                capture,
                np.concatenate([part.row for part in parts]),
                np.concatenate([part.column for part in parts]),
                np.concatenate([part.label for part in parts]),
            )


def _labels_now(
    connection: Connection, layer_id: int | None, samples: CaptureLabels
) -> CaptureLabels:
    """What is in force for these samples, NO_LABEL included."""
    capture_id = find_capture(connection, samples.capture)
    codes: IntArray = np.full(len(samples.row), NO_LABEL)
    if layer_id is not None and capture_id is not None:
        codes = codes_at(connection, layer_id, capture_id, samples)
    return CaptureLabels(
        capture=samples.capture, row=samples.row, column=samples.column, label=codes
    )


def _require_unchanged(
    connection: Connection, layer: _Layer, kind: ActionKind, left: CaptureLabels
) -> None:
    now = _labels_now(connection, layer.id, left)
    differing = np.flatnonzero(now.label != left.label)
    if not len(differing):
        return
    first = differing[0]
    newest = connection.execute(
        select(_ACTION.annotator, _ACTION.id)
        .join(schema.change, _CHANGE.action_id == _ACTION.id)
        .where(
            _CHANGE.layer_id == layer.id,
            _CHANGE.capture_id == find_capture(connection, left.capture),
            _CHANGE.row == int(left.row[first]),
            _CHANGE.column == int(left.column[first]),
        )
        .order_by(_ACTION.id.desc())
        .limit(1)
    ).one()
    raise LabelStoreError(
        f"{kind} would overwrite what {newest.annotator} has labelled in layer {layer.name} since "
        f"(action {newest.id}: {left.capture.topic} at {left.capture.stamp_ns} ns).",
        advice=f"Ask {newest.annotator} to undo it, or label these samples anew.",
    )


def _append(
    connection: Connection,
    layer: _Layer,
    link: _Link,
    changes: Sequence[CaptureChange],
    author: Author,
) -> Action:
    action = Action(
        id=newest_action(connection) + 1,
        layer=layer.name,
        kind=link.kind,
        target=link.target,
        time_utc=datetime.now(UTC),
        annotator=author.annotator,
        source=author.source,
        settings_sha256=author.settings_sha256,
        version=project_version(),
        comment=author.comment,
        captures=tuple(change.capture for change in changes),
        samples=sum(len(change.after.row) for change in changes),
    )
    connection.execute(
        insert(schema.action).values(
            id=action.id,
            layer_id=layer.id,
            kind=link.kind,
            target_id=link.target,
            below_id=link.below,
            time_utc=action.time_utc.isoformat(timespec="microseconds"),
            annotator=action.annotator,
            source=action.source,
            settings_sha256=action.settings_sha256,
            version=action.version,
            comment=action.comment,
        )
    )
    for change in changes:
        capture_id = find_capture(connection, change.capture)
        if capture_id is None:
            capture_id = _insert_capture(connection, change.capture)
        _insert_change(connection, (action.id, layer.id, capture_id), change)
    return action


def _insert_change(
    connection: Connection, keys: tuple[int, int, int], change: CaptureChange
) -> None:
    """``keys``: the numbers of action, layer and capture."""
    columns = (change.after.row, change.after.column, change.before.label, change.after.label)
    values = [array.tolist() for array in columns]
    if connection.dialect.name == "postgresql":
        # As arrays: a whole image row by row would hold the lock for longer than others wait.
        arrays = [func.unnest(literal(column, ARRAY(Integer))) for column in values]
        rows = select(*map(literal, keys), *arrays)
        connection.execute(insert(schema.change).from_select(schema.change.c.keys(), rows))
        return
    names = schema.change.c.keys()
    connection.execute(
        insert(schema.change),
        [dict(zip(names, (*keys, *row), strict=True)) for row in zip(*values, strict=True)],
    )


def _insert_capture(connection: Connection, capture: Capture) -> int:
    require_storable(capture.topic)
    return _insert_numbered(connection, schema.capture, asdict(capture))


def _insert_numbered(connection: Connection, table: Table, values: dict[str, Any]) -> int:
    """Insert a row with the next number."""
    number: int = connection.execute(
        select(func.coalesce(func.max(table.c.id), 0) + 1)
    ).scalar_one()
    connection.execute(insert(table).values(id=number, **values))
    return number


def _change(capture: Capture, rows: Iterable[Row[Any]]) -> CaptureChange:
    """From (row, column, before, after) in order."""
    array = np.array([tuple(row[:4]) for row in rows], dtype=np.int64).reshape(-1, 4)
    row, column, before, after = (values.copy() for values in array.T)
    return CaptureChange(
        before=CaptureLabels(capture=capture, row=row, column=column, label=before),
        after=CaptureLabels(capture=capture, row=row, column=column, label=after),
    )


def _action(rows: Sequence[Row[Any]]) -> Action:
    """From the rows of one action, one for each capture."""
    first = rows[0]
    captures = sorted(capture_from(row[-len(CAPTURE_COLUMNS) :]) for row in rows)
    return Action(
        id=first.id,
        layer=first.layer_name,
        kind=first.kind,
        target=first.target_id,
        time_utc=datetime.fromisoformat(first.time_utc),
        annotator=first.annotator,
        source=first.source,
        settings_sha256=first.settings_sha256,
        version=first.version,
        comment=first.comment,
        captures=tuple(captures),
        samples=sum(row.samples for row in rows),
    )
