"""Labels of depth images as COCO: one category for each label, one mask for each label in an image.

The masks are run-length coded with ``iscrowd`` 1, as COCO has it for masks that are no polygons.
Beside COCO's fields an image has its topic, stamp and index, and ``info`` the header. COCO is one
JSON document, so reading it needs memory for all of it; writing does not.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.labels.capture_names import CaptureNames
from fusion_core.exporting.labels.label_file import (
    MASK_VALUES,
    LabelFile,
    LabelHeader,
    capture_of,
    damaged,
    json_of,
    label_of,
    ordered,
    unreadable,
)
from fusion_core.exporting.labels.run_length import decode_mask, encode_mask, unpack_counts
from fusion_core.files.atomic import atomic_stream
from fusion_core.files.regular_file import read_regular
from fusion_core.model.conventions import IntArray
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label

FORMAT = "coco"
_MAX_BYTES = 1 << 28


def write_coco(file: Path, header: LabelHeader, layer: Iterable[CaptureLabels]) -> None:
    """Raises ExportError where it cannot be written."""
    with atomic_stream(file) as stream:
        _write(lambda text: stream.write(text.encode("ascii")), header, layer)


def _write(
    put: Callable[[str], object], header: LabelHeader, layer: Iterable[CaptureLabels]
) -> None:
    names = CaptureNames()
    # Written after the annotations, which come one by one.
    images: list[str] = []
    annotations = 0
    put(f'{{"info": {json.dumps(header.to_json(FORMAT))}, "licenses": [],\n')
    put(f'"categories": {json.dumps(_categories())},\n"annotations": [')
    for image_id, labels in enumerate(layer, 1):
        images.append(json.dumps(_image(image_id, labels.capture, names)))
        codes = labels.as_image()
        for code in np.unique(labels.label).tolist():
            put(",\n" if annotations else "\n")
            annotations += 1
            put(json.dumps(_annotation(annotations, image_id, codes, code)))
    put('\n],\n"images": [\n' + ",\n".join(images) + "\n]}\n")


def _categories() -> list[dict[str, Any]]:
    return [
        {"id": value, "name": name, "supercategory": "label"}
        for name, value in MASK_VALUES.items()
        if value
    ]


def _image(number: int, capture: Capture, names: CaptureNames) -> dict[str, Any]:
    return {
        "id": number,
        "file_name": names.name(capture, ".png"),
        "height": capture.rows,
        "width": capture.columns,
        "topic": capture.topic,
        "stamp_ns": capture.stamp_ns,
        "index": capture.index,
    }


def _annotation(number: int, image_id: int, codes: IntArray, code: int) -> dict[str, Any]:
    mask = codes == code
    rows, columns = mask.any(axis=1).nonzero()[0], mask.any(axis=0).nonzero()[0]
    left, top = int(columns[0]), int(rows[0])
    return {
        "id": number,
        "image_id": image_id,
        "category_id": code + 1,
        "iscrowd": 1,
        "area": int(mask.sum()),
        "bbox": [left, top, int(columns[-1]) + 1 - left, int(rows[-1]) + 1 - top],
        "segmentation": {"size": list(mask.shape), "counts": encode_mask(mask)},
    }


def read_coco(file: Path) -> LabelFile:
    """Raises RecordingError, also for masks that are polygons."""
    return LabelFile(
        header=LabelHeader.of_json(_document(file).get("info"), file),
        labels=lambda: ordered(_captures(_document(file), file), file),
    )


def _document(file: Path) -> dict[str, Any]:
    try:
        content = read_regular(file, _MAX_BYTES)
    except OSError as error:
        raise unreadable(file, error) from error
    found = json_of(content.decode("utf-8", "replace"), file, "it")
    if not isinstance(found, dict):
        raise damaged(file, "it is no COCO document")
    return found


def _captures(document: dict[str, Any], file: Path) -> Iterator[CaptureLabels]:
    labels = _category_labels(document, file)
    captures: dict[int, Capture] = {}
    for image in _objects(document, "images", file):
        fields = (image.get(key) for key in ("topic", "stamp_ns", "index", "height", "width"))
        where = f"image {image.get('id')!r:.40}"
        captures[_id(image, "id", file)] = capture_of(("depth", *fields), file, where)
    by_image: dict[int, list[dict[str, Any]]] = {}
    for annotation in _objects(document, "annotations", file):
        by_image.setdefault(_id(annotation, "image_id", file), []).append(annotation)
    if unknown := by_image.keys() - captures.keys():
        raise damaged(file, f"an annotation names the image {min(unknown)}, which it lacks")
    if len(set(captures.values())) < len(captures):
        raise damaged(file, "an image stands twice")
    for image_id, capture in sorted(captures.items(), key=lambda item: item[1]):
        if image_id not in by_image:
            continue
        codes = np.full((capture.rows, capture.columns), NO_LABEL)
        for annotation in by_image[image_id]:
            label = labels.get(_id(annotation, "category_id", file))
            where = f"annotation {annotation.get('id')!r:.40}"
            if label is None:
                raise damaged(file, f"{where} is of a category that it lacks")
            _paint(codes, annotation.get("segmentation"), label, file, where)
        yield CaptureLabels.of_image(capture, codes)


def _paint(codes: IntArray, segmentation: Any, label: Label, file: Path, where: str) -> None:
    if not isinstance(segmentation, dict) or segmentation.get("size") != list(codes.shape):
        raise damaged(file, f"{where} has no run-length mask of its image's size")
    counts = segmentation.get("counts")
    try:
        if isinstance(counts, str):
            counts = unpack_counts(counts)
        if not isinstance(counts, list) or not all(type(count) is int for count in counts):
            raise ValueError("its counts are no whole numbers")
        mask = decode_mask(counts, *codes.shape)
    except ValueError as error:
        raise damaged(file, f"{where}: {error}") from error
    if (codes[mask] != NO_LABEL).any():
        raise damaged(file, f"{where} overlaps another")
    codes[mask] = label


def _category_labels(document: dict[str, Any], file: Path) -> dict[int, Label]:
    """By their names: another tool may number the categories anew."""
    return {
        _id(category, "id", file): label_of(
            category.get("name"), file, f"category {category.get('id')!r:.40}"
        )
        for category in _objects(document, "categories", file)
    }


def _objects(document: dict[str, Any], key: str, file: Path) -> list[dict[str, Any]]:
    found = document.get(key)
    if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
        raise damaged(file, f"it has no list of {key}")
    return found


def _id(found: dict[str, Any], key: str, file: Path) -> int:
    value = found.get(key)
    if type(value) is not int:
        raise damaged(file, f"an object has no whole number as its {key}")
    return value
