"""The list of a batch's recordings in the workbench."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.workflows.batch.report import write_report
from scanloom.state.batch_list import BatchList, BatchOrder, BatchWalk, is_batch
from scanloom.state.library import Library
from tests.workflows.batch.made_outcomes import failed, fleet, frame, fused


@pytest.fixture(scope="module")
def batch(tmp_path_factory: pytest.TempPathFactory) -> BatchList:
    """Twelve recordings of one rig, two that failed, one that is flagged; three are there."""
    root = tmp_path_factory.mktemp("shelf")
    folder, recordings = root / "night", root / "data"
    for name in ("run_03.mcap", "run_07.mcap", "run_11.mcap"):
        recordings.mkdir(exist_ok=True)
        (recordings / name).write_bytes(b"")
    bumped = fused(folder, "bumped", [frame(0, lidar_hole=12, depth_hole=12)], yaw_rad=0.2)
    outcomes = [*fleet(folder), bumped, failed("Zut"), failed("cut", "no LiDAR")]
    write_report(folder, outcomes, recordings=recordings)
    assert is_batch(folder)
    return BatchList(folder)


def names(batch: BatchList, order: BatchOrder, find: str = "") -> list[str]:
    return [row["name"] for row in batch.rows(batch.numbers(order, find).tolist())]


COLUMNS = ["name", "state", "flags", "robot", "start_ns", "yaw_rad", "frames", "agreement"]


@given(column=st.sampled_from(COLUMNS), is_descending=st.booleans())
def test_rows_are_sorted_with_unknown_values_last(
    batch: BatchList, column: str, is_descending: bool
) -> None:
    rows = batch.rows(batch.numbers(BatchOrder(column, is_descending)).tolist())
    assert len(rows) == batch.count
    values = [row[column] for row in rows]
    known = [value for value in values if value not in (None, [])]
    assert values[: len(known)] == known
    keys = [value.lower() if isinstance(value, str) else value for value in known]
    assert keys == sorted(keys, reverse=is_descending)


def test_a_heading_that_is_pressed_again_turns_the_order_round() -> None:
    order = BatchOrder().by("yaw_rad")
    assert order == BatchOrder("yaw_rad", False)
    assert order.by("yaw_rad") == BatchOrder("yaw_rad", True)
    assert order.by("yaw_rad").by("yaw_rad") == order
    assert order.by("<script>") == order


@pytest.mark.parametrize(
    ("find", "found"),
    [
        ("MOUNT moved", ["bumped"]),
        ("no lidar", ["cut"]),
        ("failed", ["cut", "Zut"]),
        ("run_1", ["run_10", "run_11"]),
        ("nowhere", []),
    ],
)
def test_rows_are_found_by_their_texts(batch: BatchList, find: str, found: list[str]) -> None:
    assert names(batch, BatchOrder(), find) == found


def test_recordings_are_opened_where_the_table_says_and_only_below_a_root(
    batch: BatchList, tmp_path: Path
) -> None:
    root = batch.folder.parent
    numbers = {row["name"]: n for n, row in enumerate(batch.rows(range(batch.count)))}
    for roots, name in (
        ([root], "data/run_03.mcap"),
        ([root / "data"], "run_03.mcap"),
        ([batch.folder], None),
    ):
        library = Library([], roots)
        assert batch.name_in(library, numbers["run_03"]) == name
        assert batch.name_in(library, numbers["cut"]) is None
        library.close()
    # The folder was moved: the path within it is enough.
    moved = tmp_path / "moved"
    moved.mkdir()
    (moved / "run_03.mcap").write_bytes(b"")
    library = Library([], [moved])
    assert batch.name_in(library, numbers["run_03"]) == "run_03.mcap"
    library.close()


def test_the_walk_goes_in_the_shown_order_past_what_cannot_be_opened(batch: BatchList) -> None:
    library = Library([], [batch.folder.parent / "data"])
    numbers = batch.numbers(BatchOrder("name", True))
    walk = BatchWalk(batch, numbers, 0)
    seen = []
    while (found := walk.next_name(library, 1)) is not None:
        walk.place = found[0]
        seen.append(found[1])
    assert seen == ["run_11.mcap", "run_07.mcap", "run_03.mcap"]
    assert walk.next_name(library, -1) == (walk.place - 4, "run_07.mcap")
    library.close()


def test_a_list_that_was_written_again_is_outdated(tmp_path: Path) -> None:
    write_report(tmp_path, fleet(tmp_path))
    batch = BatchList(tmp_path)
    assert not batch.is_outdated
    write_report(tmp_path, [failed("cut")])
    assert batch.is_outdated


def test_the_columns_are_those_that_hold_anything(batch: BatchList) -> None:
    shown = [column.name for column in batch.columns]
    assert shown[:3] == ["name", "state", "flags"]
    assert "robot" not in shown
    assert "yaw_rad_sd" not in shown
    assert not math.isnan(batch.rows([0])[0]["yaw_rad"])
