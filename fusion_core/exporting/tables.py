"""Tables written row by row or block by block, without ever holding a whole one."""

import csv
import io
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np
import numpy.typing as npt

from fusion_core.files.atomic import atomic_stream
from fusion_core.model.names import escape_undecodable

if TYPE_CHECKING:
    import pyarrow as pa


class CsvTable:
    """A CSV file (UTF-8, comma, "\\n") that appears when the ``with`` block ends without error.

    None and NaN become empty fields; floats are written with the fewest digits that read back to
    the same value.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._path = path
        self._columns = tuple(columns)
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        stream: BinaryIO = self._stack.enter_context(atomic_stream(self._path))
        self._text = io.TextIOWrapper(stream, encoding="utf-8", newline="", write_through=True)
        self._stack.callback(self._text.detach)
        self._writer = csv.writer(self._text, lineterminator="\n")
        self._writer.writerow(self._columns)
        return self

    def append(self, row: Mapping[str, object]) -> None:
        """Write one row. Raises ValueError unless its keys are the table's columns."""
        if row.keys() != set(self._columns):
            raise ValueError(f"row and columns differ in {sorted(row.keys() ^ set(self._columns))}")
        self._writer.writerow([_format_field(row[column]) for column in self._columns])

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, traceback)


def _format_field(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        # str, not repr: numpy's scalars of any width then give their own shortest digits.
        return "" if np.isnan(value) else str(value)
    text = escape_undecodable(str(value))
    if "\r" in text:
        # The csv module would leave it unquoted, and a reader would end the row there.
        raise ValueError(f"a field cannot hold a carriage return: {text!r}")
    return text


class ParquetTable:
    """A Parquet file that appears when the ``with`` block ends without error.

    ``schema`` names the columns and their Arrow types (``{"stamp_ns": pa.int64()}``), ``metadata``
    stands beside it. NaN becomes null, in columns of whole numbers too. At most one row group is
    held in memory, and the bytes do not depend on how the rows were split among the calls of
    ``append``.
    """

    def __init__(
        self,
        path: Path,
        schema: "Mapping[str, pa.DataType]",
        *,
        metadata: Mapping[str, str] | None = None,
        rows_per_group: int = 65_536,
    ) -> None:
        import pyarrow as pa

        self._path = path
        self._schema = pa.schema(list(schema.items()), metadata=metadata)
        self._rows_per_group = rows_per_group
        self._pending: list[Mapping[str, npt.NDArray[Any]]] = []
        self._pending_rows = 0
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        # A stream, since Arrow takes no path that is no UTF-8.
        import pyarrow.parquet as pq

        stream = self._stack.enter_context(atomic_stream(self._path))
        self._writer = self._stack.enter_context(
            pq.ParquetWriter(stream, self._schema, compression="zstd")
        )
        self._stack.push(self._write_rest)
        return self

    def append(self, columns: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add rows: one array of equal length for each column, with the same kind of values in
        every call. The arrays are kept until their row group is written.

        Raises ValueError for missing or unknown columns, or unequal lengths; for values that the
        column's type cannot hold when they are written, at the end of the ``with`` block at last.
        """
        names = self._schema.names
        if columns.keys() != set(names):
            raise ValueError(f"columns and schema differ in {sorted(columns.keys() ^ set(names))}")
        lengths = {len(values) for values in columns.values()}
        if len(lengths) > 1:
            raise ValueError(f"the columns have {sorted(lengths)} rows")
        self._pending.append(columns)
        self._pending_rows += lengths.pop()
        while self._pending_rows >= self._rows_per_group:
            self._write_group(self._rows_per_group)

    def _write_group(self, rows: int) -> None:
        """Write the first pending rows. They are turned into Arrow's together: to turn those of
        each call takes longer than to write them."""
        import pyarrow as pa

        pending = {
            name: np.concatenate([block[name] for block in self._pending])
            for name in self._schema.names
        }
        arrays = [_to_arrow(pending[field.name][:rows], field.type) for field in self._schema]
        table = pa.Table.from_arrays(arrays, schema=self._schema)
        self._writer.write_table(table, row_group_size=rows)
        self._pending = [{name: values[rows:] for name, values in pending.items()}]
        self._pending_rows -= rows

    def _write_rest(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None and self._pending_rows > 0:
            self._write_group(self._pending_rows)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, traceback)


def _to_arrow(values: npt.NDArray[Any], column_type: "pa.DataType") -> Any:
    """NaN becomes null; the safe cast refuses fractions and overflow.

    Numbers and text are handed over by their buffers: ``pa.array`` imports pandas where that is
    installed, which takes longer than to write a short table.
    """
    import pyarrow as pa

    if values.dtype.kind == "U":
        texts = [text.encode() for text in values.tolist()]
        ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
        buffers = [None, pa.py_buffer(ends), pa.py_buffer(b"".join(texts))]
        return pa.Array.from_buffers(pa.string(), len(texts), buffers).cast(column_type)
    if values.dtype.kind not in "iuf" or not values.dtype.isnative:
        return pa.array(values, from_pandas=True).cast(column_type)
    is_known = None
    if values.dtype.kind == "f" and (is_nan := np.isnan(values)).any():
        is_known = pa.py_buffer(np.packbits(~is_nan, bitorder="little"))
    buffers = [is_known, pa.py_buffer(np.ascontiguousarray(values))]
    number_type = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(number_type, values.size, buffers).cast(column_type)
