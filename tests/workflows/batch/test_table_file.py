"""batch.parquet, read back, and the folder that it leads to."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fusion_core.model.errors import ExportError
from fusion_core.workflows.batch.columns import arrow_schema
from fusion_core.workflows.batch.items import BatchItem, common_folder
from fusion_core.workflows.batch.report import write_report
from fusion_core.workflows.batch.table_file import RECORDINGS_KEY, TABLE_NAME, read_batch_table
from tests.workflows.batch.made_outcomes import failed, fleet


def item(place: str, recording: str) -> BatchItem:
    return BatchItem(name="a", place=place, recording=recording, robot="")


def test_a_table_is_read_as_it_was_written(tmp_path: Path) -> None:
    output = tmp_path / "out" / "night"
    output.mkdir(parents=True)
    write_report(output, [*fleet(output), failed("cut")], recordings=tmp_path / "data")
    table = read_batch_table(output)
    assert table.equals(pq.read_table(output / TABLE_NAME))
    assert table.schema.metadata[RECORDINGS_KEY.encode()] == b"../../data"


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1" + bytes(100) + b"PAR1"])
def test_what_is_no_table_is_one_error(tmp_path: Path, content: bytes) -> None:
    (tmp_path / TABLE_NAME).write_bytes(content)
    with pytest.raises(ExportError, match="is not a batch's table"):
        read_batch_table(tmp_path)


def test_a_table_of_other_columns_or_types_is_one_error(tmp_path: Path) -> None:
    whole = arrow_schema().empty_table()
    wrong_type = whole.set_column(0, "name", pa.array([], pa.list_(pa.int64())))
    for table in (whole.drop_columns(["flags"]), wrong_type):
        pq.write_table(table, tmp_path / TABLE_NAME)
        with pytest.raises(ExportError, match="is not a batch's table"):
            read_batch_table(tmp_path)


def test_a_missing_table_is_one_error(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="is not a batch's table"):
        read_batch_table(tmp_path)


@pytest.mark.parametrize(
    ("items", "folder"),
    [
        ([item("/data/r/a.bag", "r/a.bag"), item("/data/b.bag", "b.bag")], "/data"),
        ([item("/data/a.bag", "a.bag"), item("/other/b.bag", "b.bag")], None),
        ([item("s3://data/a.bag", "s3://data/a.bag")], None),
        ([], None),
    ],
)
def test_the_folder_that_all_recordings_lie_in(items: list[BatchItem], folder: str | None) -> None:
    assert common_folder(items) == (None if folder is None else Path(folder))
