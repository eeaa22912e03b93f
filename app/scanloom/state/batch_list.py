"""The list of a batch's recordings: filtered, sorted, and gone through in that order."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.model.conventions import IntArray
from fusion_core.model.errors import RecordingError
from fusion_core.workflows.batch.columns import COLUMNS, Row, shown_columns
from fusion_core.workflows.batch.table_file import (
    RECORDINGS_KEY,
    TABLE_NAME,
    read_batch_table,
)
from scanloom.state.file_stamp import FileStamp
from scanloom.state.library import Library

_SORTED_BY = {column.name for column in COLUMNS}
# What is looked through for the text that a person seeks.
_FOUND_IN = ("name", "recording", "robot", "state", "flags", "error")


@dataclass(frozen=True, slots=True)
class BatchOrder:
    """How a list is sorted: by a column, unknown values last."""

    column: str = "name"
    is_descending: bool = False

    def by(self, column: str) -> "BatchOrder":
        """By a column; by the one that it is sorted by already, the other way round. Itself for a
        name that is of no column."""
        if column not in _SORTED_BY:
            return self
        return BatchOrder(column, column == self.column and not self.is_descending)


class BatchList:
    """The rows of ``folder``/batch.parquet. Raises ExportError where it cannot be read."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._stamp = FileStamp.of(folder / TABLE_NAME)
        self._table = read_batch_table(folder)
        self._texts: list[str] | None = None
        self.columns = shown_columns(self._table)

    @property
    def is_outdated(self) -> bool:
        """Whether the file has been written again since."""
        return self._stamp.change() is not None

    @property
    def count(self) -> int:
        return int(self._table.num_rows)

    def numbers(self, order: BatchOrder, find: str = "") -> IntArray:
        """(K,) numbers of the rows with a text in them, sorted."""
        import pyarrow as pa
        import pyarrow.compute as pc

        column = self._table[order.column]
        if pa.types.is_list(column.type):
            column = pc.binary_join(column, "; ")
            column = pc.if_else(pc.equal(column, ""), None, column)
        elif pa.types.is_string(column.type):
            column = pc.utf8_lower(column)
        keyed = pa.table({"key": column, "name": self._table["name"]})
        keys = [
            ("key", "descending" if order.is_descending else "ascending"),
            ("name", "ascending"),
        ]
        sorted_: IntArray = np.asarray(pc.sort_indices(keyed, sort_keys=keys)).astype(np.int64)
        wanted = find.strip().casefold()
        if not wanted:
            return sorted_
        texts = self._searched()
        return np.array([n for n in sorted_.tolist() if wanted in texts[n]], dtype=np.int64)

    def rows(self, numbers: Sequence[int]) -> list[Row]:
        """Some rows."""
        rows: list[Row] = self._table.take(np.array(numbers, dtype=np.int64)).to_pylist()
        return rows

    def name_in(self, library: Library, number: int) -> str | None:
        """The name by which the library opens the recording of a row, None if it does not."""
        recording = str(self._table["recording"][number].as_py())
        metadata = self._table.schema.metadata or {}
        beside = metadata.get(RECORDINGS_KEY.encode())
        if beside is not None:
            path = Path(os.path.realpath(self.folder / os.fsdecode(beside) / recording))
            if (name := library.name_of(path)) is not None:
                return name
        try:
            library.path(recording)
        except RecordingError:
            return None
        return recording

    def _searched(self) -> list[str]:
        if self._texts is None:
            rows = self._table.select(list(_FOUND_IN)).to_pylist()
            self._texts = [" ".join(map(_text, row.values())).casefold() for row in rows]
        return self._texts


def is_batch(folder: Path) -> bool:
    """Whether a folder holds the table of a batch."""
    return (folder / TABLE_NAME).is_file()


class BatchWalk:
    """The recordings of a list in the order in which it was shown, and where one is.

    ``numbers``: the list's rows; ``place``: among them.
    """

    def __init__(self, batch: BatchList, numbers: IntArray, place: int) -> None:
        self._batch, self._numbers, self.place = batch, numbers, place

    @property
    def count(self) -> int:
        return int(self._numbers.size)

    @property
    def label(self) -> str:
        """What the list is called."""
        return self._batch.folder.name

    def next_name(self, library: Library, direction: int) -> tuple[int, str] | None:
        """The place and the name of the next recording that can be opened, of the previous one for
        -1; None at the end."""
        place = self.place + direction
        while 0 <= place < self._numbers.size:
            name = self._batch.name_in(library, int(self._numbers[place]))
            if name is not None:
                return place, name
            place += direction
        return None


def _text(value: Any) -> str:
    return " ".join(value) if isinstance(value, list) else str(value or "")
