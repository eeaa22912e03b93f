"""Export then import gives the same labels, in each format; other programs read them as meant."""

import csv
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hypothesis_numpy
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from ruamel.yaml import YAML

from fusion_core.exporting.labels.capture_names import CaptureNames
from fusion_core.exporting.labels.formats import FORMATS, open_labels_file, write_labels
from fusion_core.exporting.labels.label_file import LabelHeader
from fusion_core.exporting.labels.run_length import decode_mask, encode_mask, unpack_counts
from fusion_core.model.conventions import BoolArray
from fusion_core.model.errors import ExportError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from tests.annotation.drawn_layers import layers, samples_of

# pycocotools is not yet written for NumPy 2.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")

HEADER = LabelHeader(layer="anna", recording="room.mcap", recording_sha256="ab" * 32)
IMAGE = Capture("depth", "/camera/depth", 1_700_000_000_123_456_789, 0, 4, 6)
SCAN = Capture("lidar", "/scan", 1_700_000_000_123_456_789, 1, 1, 7)
# Names that a file system, a CSV or a folder of another topic could take wrongly.
TOPICS = ["/a/b", "/a_b", "/A/b", "..", "", ",", '"', "#", "höhe/深", " x ", "a" * 200]

masks = hypothesis_numpy.arrays(np.bool_, hypothesis_numpy.array_shapes(min_dims=2, max_dims=2))


@st.composite
def captures(draw: st.DrawFn) -> list[Capture]:
    stamps = st.integers(-(1 << 62), 1 << 62)
    images = st.builds(
        Capture,
        st.just("depth"),
        st.sampled_from(TOPICS),
        stamps,
        st.just(0),
        st.integers(1, 4),
        st.integers(1, 5),
    )
    scans = st.builds(
        Capture,
        st.just("lidar"),
        st.sampled_from(TOPICS),
        stamps,
        st.integers(0, 2),
        st.just(1),
        st.integers(1, 8),
    )
    drawn = draw(
        st.lists(
            images | scans,
            max_size=5,
            unique_by=lambda one: (one.sensor, one.topic, one.stamp_ns, one.index),
        )
    )
    return sorted(drawn)


def path_in(folder: Path, name: str) -> Path:
    suffix = FORMATS[name].suffix
    path = folder / f"labels{suffix or ''}"
    if suffix is None:
        path.mkdir()
    return path


def layer_of_both() -> list[CaptureLabels]:
    """An image and a scan that have every label."""
    image = np.full((4, 6), NO_LABEL)
    image[1, 1:4] = Label.HOLE
    image[2, 2] = Label.HOLE
    image[3] = [0, 2, 2, 3, 4, 4]
    scan = np.array([[NO_LABEL, 0, 1, 1, 2, 3, 4]])
    return [CaptureLabels.of_image(IMAGE, image), CaptureLabels.of_image(SCAN, scan)]


@pytest.mark.parametrize("name", FORMATS)
@given(drawn=st.data())
def test_what_is_written_is_read(name: str, drawn: st.DataObject) -> None:
    layer = drawn.draw(layers(drawn.draw(captures())))
    format = FORMATS[name]
    with TemporaryDirectory() as folder:
        path = path_in(Path(folder), name)
        exported = write_labels(format, path, HEADER, layer)
        found_format, found = open_labels_file(path)
        again = list(found.labels())
    assert found_format is format
    assert found.header == HEADER
    expected = [labels for labels in layer if labels.capture.sensor in format.sensors]
    assert [labels.capture for labels in again] == [labels.capture for labels in expected]
    assert samples_of(again) == samples_of(expected)
    left_out = len(samples_of(layer)) - len(samples_of(expected))
    assert sum(exported.left_out.values()) == left_out
    assert sum(exported.written.values()) == len(samples_of(expected))


def test_topics_never_share_a_file_and_never_leave_the_folder() -> None:
    names = CaptureNames()
    captures = [Capture("lidar", topic, -5, index, 1, 1) for topic in TOPICS for index in (0, 2)]
    found = [names.name(capture, ".label") for capture in captures]
    # Also where letters of either case are one.
    assert len({name.lower() for name in found}) == len(captures)
    assert found[:2] == ["a_b/-5.label", "a_b/-5_2.label"]
    for name in found:
        folder, file = name.split("/")
        assert folder.strip("._-") == folder
        assert len(folder) < 120
        assert file in ("-5.label", "-5_2.label")
    assert [names.name(capture, ".label") for capture in captures] == found


@given(masks)
def test_masks_are_coded_as_pycocotools_does(mask: BoolArray) -> None:
    rows, columns = mask.shape
    counts = encode_mask(mask)
    packed = coco_mask.encode(np.asfortranarray(mask.astype(np.uint8)))["counts"]
    assert unpack_counts(packed.decode()) == counts
    own = coco_mask.frPyObjects({"size": [rows, columns], "counts": counts}, rows, columns)
    np.testing.assert_array_equal(coco_mask.decode(own), mask)
    np.testing.assert_array_equal(decode_mask(counts, rows, columns), mask)


def test_long_runs_are_unpacked() -> None:
    mask = np.zeros((900, 1100), dtype=np.uint8, order="F")
    mask[100:, 300:301] = 1
    mask[:, 700:] = 1
    packed = coco_mask.encode(mask)["counts"].decode()
    assert unpack_counts(packed) == encode_mask(mask.astype(bool))


@pytest.mark.parametrize("packed", ["\x00", "o", "é", "ooooooooooooooooo0"])
def test_what_is_no_packed_text_is_refused(packed: str) -> None:
    with pytest.raises(ValueError, match="its counts"):
        unpack_counts(packed)


def test_pycocotools_reads_the_coco_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "labels.json"
    layer = layer_of_both()
    write_labels(FORMATS["coco"], file, HEADER, layer)
    coco = COCO(file)
    capsys.readouterr()
    (image,) = coco.loadImgs(coco.getImgIds())
    assert (image["height"], image["width"]) == (4, 6)
    assert image["file_name"] == "camera_depth/1700000000123456789.png"
    codes = np.full((4, 6), NO_LABEL)
    for annotation in coco.loadAnns(coco.getAnnIds()):
        mask = coco.annToMask(annotation).astype(bool)
        assert annotation["iscrowd"] == 1
        assert annotation["area"] == mask.sum()
        left, top, width, height = annotation["bbox"]
        rows, columns = np.nonzero(mask)
        assert (left, top) == (columns.min(), rows.min())
        assert (width, height) == (np.ptp(columns) + 1, np.ptp(rows) + 1)
        (category,) = coco.loadCats(annotation["category_id"])
        codes[mask] = Label[category["name"].upper()]
    np.testing.assert_array_equal(codes, layer[0].as_image())


def test_packed_masks_are_read_too(tmp_path: Path) -> None:
    """As a tool that keeps COCO's document, but packs its masks, writes them."""
    file = tmp_path / "labels.json"
    layer = layer_of_both()
    write_labels(FORMATS["coco"], file, HEADER, layer)
    document = json.loads(file.read_text(encoding="utf-8"))
    for annotation in document["annotations"]:
        size = annotation["segmentation"]["size"]
        packed = coco_mask.frPyObjects(annotation["segmentation"], *size)
        annotation["segmentation"] = {"size": size, "counts": packed["counts"].decode()}
    file.write_text(json.dumps(document, indent=1), encoding="utf-8")
    assert samples_of(open_labels_file(file)[1].labels()) == samples_of(layer[:1])


def test_label_files_are_those_of_semantic_kitti(tmp_path: Path) -> None:
    write_labels(FORMATS["semantic-kitti"], tmp_path, HEADER, layer_of_both())
    header, entry, _ = (tmp_path / "index.jsonl").read_text(encoding="utf-8").splitlines()
    assert json.loads(header)["recording_sha256"] == HEADER.recording_sha256
    file = tmp_path / json.loads(entry)["file"]
    assert json.loads(entry)["topic"] == "/scan"
    assert json.loads(entry)["stamp_ns"] == SCAN.stamp_ns
    assert sorted(tmp_path.rglob("*.label")) == [file]
    # As the data set's own reader has it: the lower half is the class, the upper the instance.
    beams = np.fromfile(file, dtype=np.uint32)
    assert (beams >> 16).tolist() == [0] * 7
    classes = YAML(typ="safe").load(tmp_path / "classes.yaml")
    names = [classes["labels"][beam] for beam in (beams & 0xFFFF).tolist()]
    assert names == ["unlabelled", "good", "hole", "hole", "burr", "conflict", "unsure"]
    assert classes["color_map"].keys() == classes["labels"].keys()
    assert classes["color_map"][3] == [0x28, 0x38, 0xC9]


def test_instances_of_another_tool_are_not_read(tmp_path: Path) -> None:
    layer = layer_of_both()
    write_labels(FORMATS["semantic-kitti"], tmp_path, HEADER, layer)
    (file,) = tmp_path.rglob("*.label")
    beams = np.fromfile(file, dtype="<u4") | (7 << 16)
    beams.tofile(file)
    assert samples_of(open_labels_file(tmp_path)[1].labels()) == samples_of(layer[1:])


def test_masks_are_grey_pictures(tmp_path: Path) -> None:
    layer = layer_of_both()
    write_labels(FORMATS["png"], tmp_path, HEADER, layer)
    (file,) = tmp_path.rglob("*.png")
    mask = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    assert mask is not None
    assert mask.dtype == np.uint8
    np.testing.assert_array_equal(mask, layer[0].as_image() + 1)


def test_tables_hold_a_row_for_each_run(tmp_path: Path) -> None:
    files = {}
    for name in ("csv", "jsonl", "parquet"):
        files[name] = path_in(tmp_path, name)
        write_labels(FORMATS[name], files[name], HEADER, layer_of_both())
    lines = files["csv"].read_text(encoding="utf-8").splitlines()
    # As ``comment="#"`` reads it.
    table = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert len(table) == 11
    assert table[0] == {
        "sensor": "depth",
        "topic": "/camera/depth",
        "stamp_ns": "1700000000123456789",
        "index": "0",
        "rows": "4",
        "columns": "6",
        "row": "1",
        "first_column": "1",
        "last_column": "3",
        "label": "hole",
    }
    rows = [json.loads(line) for line in files["jsonl"].read_text(encoding="utf-8").splitlines()]
    assert [{key: str(value) for key, value in row.items()} for row in rows[1:-1]] == table
    assert pq.read_table(files["parquet"]).to_pylist() == rows[1:-1]


@pytest.mark.parametrize("topic", ["a\rb", "a\nb", "\udcff"])
def test_csv_refuses_a_topic_that_it_cannot_hold(topic: str, tmp_path: Path) -> None:
    capture = Capture("lidar", topic, 0, 0, 1, 1)
    layer = [CaptureLabels.of_image(capture, np.array([[1]]))]
    with pytest.raises(ExportError, match=r"labels\.csv.*jsonl or parquet"):
        write_labels(FORMATS["csv"], tmp_path / "labels.csv", HEADER, layer)
    assert list(tmp_path.iterdir()) == []
    write_labels(FORMATS["jsonl"], tmp_path / "labels.jsonl", HEADER, layer)
    assert samples_of(open_labels_file(tmp_path / "labels.jsonl")[1].labels()) == samples_of(layer)


@pytest.mark.parametrize("name", FORMATS)
def test_the_bytes_are_those_of_the_labels_alone(name: str, tmp_path: Path) -> None:
    contents = []
    for run in ("one", "two"):
        (tmp_path / run).mkdir()
        path = path_in(tmp_path / run, name)
        write_labels(FORMATS[name], path, HEADER, layer_of_both())
        files = [path] if path.is_file() else sorted(path.rglob("*.*"))
        contents.append([file.read_bytes() for file in files])
    assert contents[0] == contents[1]
