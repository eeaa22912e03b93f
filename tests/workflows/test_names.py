"""Recordings, folders and output folders whose names are no UTF-8."""

import csv
import json
from pathlib import Path

import pytest

from fusion_core.evaluation.fuse_folder import open_fuse_folder, read_frames, read_samples
from fusion_core.model.progress import silent
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from tests.hostile.names import NO_UTF8, SHOWN, moved_to_no_utf8
from tests.workflows.box_recording import write_boxes


@pytest.fixture(scope="module")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("names")
    write_boxes(folder / "boxes.mcap")
    return moved_to_no_utf8(folder / "boxes.mcap", folder)


def input_of(output: Path) -> dict[str, object]:
    manifest = json.loads((output / "manifest.json").read_text(encoding="utf-8"))
    (recorded,) = manifest["inputs"]
    return recorded


def test_fuse(boxes: Path, tmp_path: Path) -> None:
    output = tmp_path / NO_UTF8
    assert not fuse(boxes, output, FuseOptions(), silent).skipped
    assert input_of(output)["name"] == f"{SHOWN}.mcap"
    with (output / "figures" / "table1.csv").open(encoding="utf-8") as lines:
        assert next(csv.DictReader(lines))["room"] == f"{SHOWN}.mcap"
    folder = open_fuse_folder(output)
    assert read_frames(folder).stamp_ns.size
    assert sum(samples.stamp_ns.size for samples in read_samples(folder))
    # The manifest knows the folder and the recording again.
    assert fuse(boxes, output, FuseOptions(), silent).skipped


def test_map_of_a_folder(boxes: Path, tmp_path: Path) -> None:
    output = tmp_path / NO_UTF8
    options = MapOptions(motion="none")
    assert not build_map(boxes.parent, output, options, silent).is_skipped
    recorded = input_of(output)
    assert recorded["name"] == SHOWN
    assert list(recorded["sha256"]) == [f"{SHOWN}.mcap"]
    assert build_map(boxes.parent, output, options, silent).is_skipped
