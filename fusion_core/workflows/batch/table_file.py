"""batch.parquet, read back: the list of a batch's recordings."""

from pathlib import Path
from typing import TYPE_CHECKING

from fusion_core.files.regular_file import open_regular
from fusion_core.model.errors import ExportError
from fusion_core.workflows.batch.columns import arrow_schema

if TYPE_CHECKING:
    import pyarrow as pa

TABLE_NAME = "batch.parquet"
RECORDINGS_KEY = "recordings"
"""Of the table's metadata: the folder that all recordings lie in, relative to the table's own."""

# A row takes some 300 bytes: ten times the recordings that a list of folders may have.
_BYTES_MAX = 256 << 20
_ROWS_MAX = 1_000_000
_ADVICE = "Run scanloom batch again."


def read_batch_table(folder: Path) -> "pa.Table":
    """``folder``/batch.parquet, with the columns of ``arrow_schema``.

    Raises ExportError where it cannot be read or is not as ``write_report`` writes it.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = folder / TABLE_NAME
    schema = arrow_schema()
    try:
        with open_regular(file, _BYTES_MAX) as stream, pq.ParquetFile(stream) as parquet:
            if parquet.metadata.num_rows > _ROWS_MAX:
                raise ExportError(
                    f"has {parquet.metadata.num_rows} rows, more than {_ROWS_MAX}.", file=file
                )
            metadata = parquet.schema_arrow.metadata
            table = parquet.read(columns=schema.names)
        return table.select(schema.names).cast(schema).replace_schema_metadata(metadata)
    except (OSError, pa.ArrowException, KeyError, ValueError) as error:
        raise ExportError(
            f"is not a batch's table as this version writes it ({type(error).__name__}).",
            file=file,
            advice=_ADVICE,
        ) from error
