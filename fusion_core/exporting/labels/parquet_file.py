"""Labels as Parquet: the table of runs, with the header in the schema's metadata."""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fusion_core.exporting.labels.label_file import (
    HEADER_KEY,
    LabelFile,
    LabelHeader,
    damaged,
    json_of,
    unreadable,
)
from fusion_core.exporting.labels.label_runs import (
    COLUMNS,
    INTEGER_COLUMNS,
    TableRow,
    labels_of_rows,
    table_rows,
)
from fusion_core.exporting.tables import ParquetTable
from fusion_core.files.regular_file import open_regular
from fusion_core.model.labels import CaptureLabels

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = "parquet"
MAGIC = b"PAR1"
_ROWS_AT_ONCE = 65_536


def write_parquet(file: Path, header: LabelHeader, layer: Iterable[CaptureLabels]) -> None:
    """Raises ExportError where it cannot be written."""
    metadata = {HEADER_KEY: json.dumps(header.to_json(FORMAT))}
    rows = table_rows(layer)
    with ParquetTable(file, _schema(), metadata=metadata) as table:
        while some := list(islice(rows, _ROWS_AT_ONCE)):
            columns = zip(*some, strict=True)
            table.append(
                {
                    name: np.array(column, dtype=np.int64 if name in INTEGER_COLUMNS else object)
                    for name, column in zip(COLUMNS, columns, strict=True)
                }
            )


def read_parquet(file: Path) -> LabelFile:
    """Raises RecordingError."""
    import pyarrow.parquet as pq

    with _errors_named(file), open_regular(file) as stream:
        schema = pq.read_schema(stream)
    if dict(zip(schema.names, schema.types, strict=True)) != _schema():
        raise damaged(file, f"its columns are not {', '.join(COLUMNS)}")
    text = (schema.metadata or {}).get(HEADER_KEY.encode(), b"null").decode("utf-8", "replace")
    header = LabelHeader.of_json(json_of(text, file, "its metadata"), file)
    return LabelFile(header=header, labels=lambda: labels_of_rows(_rows(file), file, first_row=1))


def _rows(file: Path) -> Iterator[TableRow]:
    import pyarrow.parquet as pq

    with _errors_named(file), open_regular(file) as stream, pq.ParquetFile(stream) as table:
        for batch in table.iter_batches(_ROWS_AT_ONCE, columns=list(COLUMNS)):
            columns = (batch.column(name).to_pylist() for name in COLUMNS)
            yield from zip(*columns, strict=True)


@contextmanager
def _errors_named(file: Path) -> Iterator[None]:
    """Arrow's errors, and the system's, as RecordingError."""
    import pyarrow as pa

    try:
        yield
    except (pa.ArrowException, UnicodeDecodeError) as error:
        raise damaged(file, _first_line(error)) from error
    except OSError as error:
        if error.errno is None:
            # Arrow's, of a damaged page.
            raise damaged(file, _first_line(error)) from error
        raise unreadable(file, error) from error


def _schema() -> "dict[str, pa.DataType]":
    import pyarrow as pa

    return {name: pa.int64() if name in INTEGER_COLUMNS else pa.string() for name in COLUMNS}


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]
