"""Files that are cut off, damaged, foreign or hostile: one clear error, and no end without one."""

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fusion_core.exporting.labels.formats import FORMATS, open_labels_file, write_labels
from fusion_core.model.errors import RecordingError
from fusion_core.model.labels import CaptureLabels
from tests.annotation.drawn_layers import samples_of
from tests.exporting.labels.test_round_trips import HEADER, layer_of_both, path_in


def read(path: Path) -> list[CaptureLabels]:
    return list(open_labels_file(path)[1].labels())


def written(folder: Path, name: str) -> Path:
    path = path_in(folder, name)
    write_labels(FORMATS[name], path, HEADER, layer_of_both())
    return path


def refused(path: Path, words: str) -> str:
    with pytest.raises(RecordingError, match=words) as caught:
        read(path)
    text = str(caught.value)
    assert "\n" not in text
    assert path.name in text
    return text


@pytest.mark.parametrize("name", ["csv", "jsonl", "parquet", "coco"])
def test_a_file_that_is_cut_off_anywhere_is_refused(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, name)
    whole = path.read_bytes()
    expected = samples_of(read(path))
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        try:
            found = samples_of(read(path))
        except RecordingError:
            continue
        # Less than the last line end or bracket's space is missing then.
        assert whole[size:].strip() == b""
        assert found == expected


@pytest.mark.parametrize("name", ["semantic-kitti", "png"])
def test_a_folder_whose_files_are_cut_off_or_missing_is_refused(name: str, tmp_path: Path) -> None:
    folder = written(tmp_path, name)
    (mask,) = folder.rglob("*.label" if name == "semantic-kitti" else "*.png")
    for file in (mask, folder / "index.jsonl"):
        whole = file.read_bytes()
        for size in range(len(whole) - 1):
            file.write_bytes(whole[:size])
            with pytest.raises(RecordingError):
                read(folder)
        file.unlink()
        with pytest.raises(RecordingError):
            read(folder)
        file.write_bytes(whole)
    assert samples_of(read(folder))


@pytest.mark.parametrize("name", FORMATS)
def test_flipped_bytes_never_end_in_another_error(name: str, tmp_path: Path) -> None:
    path = written(tmp_path, name)
    rng = np.random.default_rng(5)
    for file in [path] if path.is_file() else sorted(path.rglob("*.*")):
        whole = file.read_bytes()
        for _ in range(150):
            content = bytearray(whole)
            content[rng.integers(len(content))] = rng.integers(256)
            file.write_bytes(content)
            with suppress(RecordingError):
                read(path)
        file.write_bytes(whole)


@pytest.mark.parametrize(
    "content",
    [b"", b"stamp,label\n1,good\n", b"PAR1", b"{}", b"[1]", b"\x89PNG\r\n\x1a\n", b"{" * 5000],
)
def test_what_is_none_of_ours_is_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "labels.bin"
    file.write_bytes(content)
    refused(file, "labels")


def test_what_is_no_regular_file_is_refused(tmp_path: Path) -> None:
    refused(tmp_path, "folder without index")
    refused(tmp_path / "none.csv", "cannot be read")
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    refused(pipe, "cannot be read")


def rewrite_header(path: Path, change: dict[str, Any]) -> None:
    """Give a CSV another header."""
    first, rest = path.read_text(encoding="utf-8").split("\n", 1)
    header = json.loads(first.removeprefix("# scanloom labels ")) | change
    path.write_text(f"# scanloom labels {json.dumps(header)}\n{rest}", encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scanloom_labels": 2}, "version 2.*knows 1"),
        ({"scanloom_labels": True}, "which recording"),
        ({"layer": ""}, "header lacks"),
        ({"recording_sha256": 5}, "header lacks"),
    ],
)
def test_a_header_is_checked(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = written(tmp_path, "csv")
    rewrite_header(path, change)
    refused(path, words)


def test_another_recordings_labels_are_told_by_their_digest() -> None:
    file = Path("labels.csv")
    HEADER.require_recording("copy.mcap", HEADER.recording_sha256, file)
    with pytest.raises(RecordingError, match=r"another recording, room\.mcap, not of this hall"):
        HEADER.require_recording("hall.mcap", "cd" * 32, file)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("lidar,/scan,5,0,1,7,0,3,7,good", "outside its capture"),
        ("lidar,/scan,5,0,1,7,0,3,2,good", "outside its capture"),
        ("lidar,/scan,5,0,1,7,0,-1,2,good", "outside its capture"),
        ("lidar,/scan,5,0,1,7,1,0,2,good", "outside its capture"),
        ("lidar,/scan,5,0,1,7,0,0,2,great", "none of good"),
        ("lidar,/scan,5,0,1,7,0,0,1e0,good", "no whole number"),
        ("lidar,/scan,5,0,1,7,0,0,٣,good", "no whole number"),
        ("lidar,/scan,1.7E+18,0,1,7,0,0,2,good", "no whole number"),
        ("lidar,/scan,99999999999999999999,0,1,7,0,0,2,good", "no whole number"),
        ("lidar,/scan,5,-1,1,7,0,0,2,good", "index from 0"),
        ("lidar,/scan,5,0,2,7,0,0,2,good", "one row"),
        ("radar,/scan,5,0,1,7,0,0,2,good", "neither a scan"),
        ("depth,/d,5,0,100000,100000,0,0,2,good", "claims"),
        ("lidar,/scan,5,0,1,7,0,0,2", "9 fields"),
        ("lidar,/scan,5,0,1,7,0,0,2,good\nlidar,/scan,5,0,1,7,0,2,3,hole", "overlap"),
        ("lidar,/scan,5,0,1,7,0,3,4,good\nlidar,/scan,5,0,1,7,0,0,1,hole", "out of order"),
        ("lidar,/scan,5,0,1,7,0,3,4,good\nlidar,/scan,4,0,1,7,0,0,1,hole", "out of order"),
        ('lidar,"/scan,5,0,1,7,0,3,4,good', "no whole file"),
        (f"lidar,{'x' * 70_000},5,0,1,7,0,3,4,good", "line of more"),
    ],
)
def test_rows_that_no_table_has_are_refused(row: str, words: str, tmp_path: Path) -> None:
    path = written(tmp_path, "csv")
    header, names, *_ = path.read_text(encoding="utf-8").split("\n")
    path.write_text(f"{header}\n{names}\n{row}\n# end\n", encoding="utf-8")
    refused(path, words)


@pytest.mark.parametrize("line", ["5", "[]", '{"sensor": "lidar"}', "{" * 3000])
def test_lines_that_no_table_has_are_refused(line: str, tmp_path: Path) -> None:
    path = written(tmp_path, "jsonl")
    header, *_ = path.read_text(encoding="utf-8").split("\n")
    path.write_text(f'{header}\n{line}\n{{"end": true}}\n', encoding="utf-8")
    refused(path, "row 2")


def test_a_parquet_file_with_gaps_or_other_columns_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "parquet")
    table = pq.read_table(path)
    first = table.schema.get_field_index("stamp_ns")
    pq.write_table(
        table.set_column(first, "stamp_ns", pa.array([None] * len(table), pa.int64())), path
    )
    refused(path, "row 1|its columns|recording")
    pq.write_table(table.drop_columns(["label"]), path)
    refused(path, "its columns")
    pq.write_table(table.replace_schema_metadata({}), path)
    refused(path, "which recording")


def in_coco(document: dict[str, Any]) -> dict[str, Any]:
    annotation: dict[str, Any] = document["annotations"][0]
    return annotation


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda found: found.update(images=5), "no list of images"),
        (lambda found: found["images"].append(dict(found["images"][0], id=9)), "twice"),
        (lambda found: found["images"][0].update(height=5), "image's size"),
        (lambda found: found["images"][0].update(stamp_ns=0.5), "no whole number"),
        (lambda found: in_coco(found).update(image_id=77), "image 77"),
        (lambda found: in_coco(found).update(category_id=77), "category"),
        (lambda found: in_coco(found).update(segmentation=[[1, 2, 3, 4, 5, 6]]), "run-length"),
        (lambda found: in_coco(found)["segmentation"].update(counts=[3, -3, 24]), "counts"),
        (lambda found: in_coco(found)["segmentation"].update(counts=[0, 10**30]), "counts"),
        (lambda found: in_coco(found)["segmentation"].update(counts=[0.5]), "counts"),
        (lambda found: in_coco(found)["segmentation"].update(counts="ooo"), "counts"),
        (lambda found: in_coco(found)["segmentation"].update(counts=[0, 24]), "overlaps"),
        (lambda found: found["categories"][0].update(name="car"), "none of good"),
    ],
)
def test_coco_documents_that_mean_something_else_are_refused(
    change: Callable[[dict[str, Any]], None], words: str, tmp_path: Path
) -> None:
    path = written(tmp_path, "coco")
    document = json.loads(path.read_text(encoding="utf-8"))
    change(document)
    path.write_text(json.dumps(document), encoding="utf-8")
    refused(path, words)


@pytest.mark.parametrize("name", ["../secret.png", "/etc/passwd", "", "a\0b", 5, "..", "a/../../b"])
def test_an_index_names_files_of_its_folder_alone(name: object, tmp_path: Path) -> None:
    folder = written(tmp_path, "png")
    index = folder / "index.jsonl"
    header, entry, end = index.read_text(encoding="utf-8").splitlines()
    changed = json.dumps(json.loads(entry) | {"file": name})
    index.write_text(f"{header}\n{changed}\n{end}\n", encoding="utf-8")
    refused(folder, "names no file")


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (np.zeros((4, 7), np.uint8), "4 x 7 pixels"),
        (np.zeros((4, 6), np.uint16), "8-bit grey"),
        (np.zeros((4, 6, 3), np.uint8), "8-bit grey"),
        (np.full((4, 6), 6, np.uint8), "the value 6"),
    ],
)
def test_masks_of_another_kind_are_refused(
    mask: np.ndarray[Any, Any], words: str, tmp_path: Path
) -> None:
    folder = written(tmp_path, "png")
    (file,) = folder.rglob("*.png")
    file.write_bytes(cv2.imencode(".png", mask)[1].tobytes())
    with pytest.raises(RecordingError, match=words):
        read(folder)


def test_a_class_that_we_do_not_know_is_refused(tmp_path: Path) -> None:
    folder = written(tmp_path, "semantic-kitti")
    (file,) = folder.rglob("*.label")
    np.full(7, 40, dtype="<u4").tofile(file)
    with pytest.raises(RecordingError, match="the value 40"):
        read(folder)
