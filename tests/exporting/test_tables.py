"""CSV and Parquet tables, read back by other means."""

import csv
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting.tables import CsvTable, ParquetTable

SCHEMA = {"stamp_ns": pa.int64(), "row": pa.int32(), "range_m": pa.float64(), "source": pa.string()}


def test_csv_fields(tmp_path: Path) -> None:
    path = tmp_path / "frames.csv"
    with CsvTable(path, ["a", "b", "c"]) as table:
        table.append({"a": None, "b": math.nan, "c": np.float32("nan")})
        table.append({"c": 0.1, "b": np.float32(0.1), "a": np.int64(2**62)})
        table.append({"a": True, "b": np.bool_(False), "c": 'say "x, y"'})
        table.append({"a": 1e-12, "b": np.float64(1 / 3), "c": -0.0})
        assert not path.exists()
    assert path.read_bytes() == (
        b"a,b,c\n,,\n4611686018427387904,0.1,0.1\n"
        b'true,false,"say ""x, y"""\n1e-12,0.3333333333333333,-0.0\n'
    )


@given(
    st.lists(
        st.tuples(
            st.floats(allow_nan=False),
            st.text(st.characters(codec="utf-8", exclude_characters="\r")),
        ),
        max_size=5,
    )
)
def test_csv_reads_back(tmp_path_factory: pytest.TempPathFactory, rows: list) -> None:
    path = tmp_path_factory.mktemp("csv") / "t.csv"
    with CsvTable(path, ["number", "text"]) as table:
        for number, text in rows:
            table.append({"number": number, "text": text})
    with path.open(encoding="utf-8", newline="") as stream:
        read = [(float(row["number"]), row["text"]) for row in csv.DictReader(stream)]
    assert read == rows


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ({"a": 1}, "row and columns differ"),
        ({"a": 1, "b": 2, "c": 3}, "row and columns differ"),
        ({"a": 1, "b": "\r"}, "carriage return"),
    ],
)
def test_csv_refuses_what_does_not_fit_and_leaves_nothing(
    tmp_path: Path, row: dict, words: str
) -> None:
    with (
        pytest.raises(ValueError, match=words),
        CsvTable(tmp_path / "t.csv", ["a", "b"]) as table,
    ):
        table.append(row)
    assert list(tmp_path.iterdir()) == []


def columns(start: int, stop: int) -> dict[str, np.ndarray]:
    index = np.arange(start, stop)
    return {
        "stamp_ns": index.astype(np.int64),
        "row": np.where(index % 3 == 0, np.nan, index),
        "range_m": np.where(index % 4 == 0, np.nan, index / 7),
        "source": np.where(index % 2 == 0, "raw", "neighbours"),
    }


def write_parquet(path: Path, cuts: list[int]) -> bytes:
    with ParquetTable(path, SCHEMA, rows_per_group=40) as table:
        for start, stop in pairwise(cuts):
            table.append(columns(start, stop))
    return path.read_bytes()


def test_parquet_values_and_nulls(tmp_path: Path) -> None:
    write_parquet(tmp_path / "t.parquet", [0, 30, 100])
    table = pq.read_table(tmp_path / "t.parquet")
    assert table.schema.names == list(SCHEMA)
    assert table.schema.types == list(SCHEMA.values())
    assert table["stamp_ns"].to_pylist() == list(range(100))
    assert table["row"].to_pylist() == [None if i % 3 == 0 else i for i in range(100)]
    assert table["range_m"].to_pylist() == [None if i % 4 == 0 else i / 7 for i in range(100)]
    assert table["source"].to_pylist() == ["raw", "neighbours"] * 50
    groups = pq.ParquetFile(tmp_path / "t.parquet").metadata
    assert [groups.row_group(i).num_rows for i in range(groups.num_row_groups)] == [40, 40, 20]


@given(st.lists(st.integers(0, 100), max_size=8))
def test_parquet_bytes_do_not_depend_on_the_blocks(
    tmp_path_factory: pytest.TempPathFactory, cuts: list[int]
) -> None:
    folder = tmp_path_factory.mktemp("parquet")
    whole = write_parquet(folder / "whole.parquet", [0, 100])
    assert write_parquet(folder / "cut.parquet", sorted([0, 100, *cuts])) == whole


def test_parquet_holds_at_most_one_group(tmp_path: Path) -> None:
    with ParquetTable(tmp_path / "t.parquet", SCHEMA, rows_per_group=40) as table:
        for start in range(0, 1000, 30):
            table.append(columns(start, start + 30))
            assert table._pending_rows < 40
            assert sum(block["row"].size for block in table._pending) == table._pending_rows


def test_an_empty_parquet_table_has_its_columns(tmp_path: Path) -> None:
    write_parquet(tmp_path / "t.parquet", [0])
    table = pq.read_table(tmp_path / "t.parquet")
    assert (table.num_rows, table.schema.names) == (0, list(SCHEMA))


@pytest.mark.parametrize(
    "wrong",
    [
        {"row": np.array([0.5, 1.0])},
        {"row": np.array([2.0**40, 1.0])},
        {"row": np.array([1.0])},
        {"other": np.array([1.0, 2.0])},
    ],
    ids=["fraction", "overflow", "length", "column"],
)
def test_parquet_refuses_what_does_not_fit_and_leaves_nothing(
    tmp_path: Path, wrong: dict[str, np.ndarray]
) -> None:
    with (
        pytest.raises(ValueError),  # noqa: PT011 (the words are pyarrow's)
        ParquetTable(tmp_path / "t.parquet", SCHEMA) as table,
    ):
        table.append(columns(0, 2) | wrong)
    assert list(tmp_path.iterdir()) == []
