"""The table of formats of labels, recognised by content."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from fusion_core.exporting.labels import coco, csv_file, jsonl_file, parquet_file, png_masks
from fusion_core.exporting.labels import semantic_kitti as kitti
from fusion_core.exporting.labels.capture_folder import INDEX, folder_header
from fusion_core.exporting.labels.label_file import (
    HEADER_KEY,
    LabelFile,
    LabelHeader,
    damaged,
    unreadable,
)
from fusion_core.files.regular_file import read_head
from fusion_core.model.errors import RecordingError
from fusion_core.model.labels import CaptureLabels, SensorKind

_HEAD_BYTES = 1 << 10
_BOTH: frozenset[SensorKind] = frozenset({"lidar", "depth"})


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelFormat:
    """``sensors``: whose captures it holds. ``suffix``: of its file; None for a folder.

    ``write`` takes the file, or an existing empty folder, and labels of ``sensors`` alone.
    """

    name: str
    suffix: str | None
    sensors: frozenset[SensorKind]
    write: Callable[[Path, LabelHeader, Iterable[CaptureLabels]], None]
    read: Callable[[Path], LabelFile]


FORMATS = {
    format.name: format
    for format in (
        LabelFormat(
            name=csv_file.FORMAT,
            suffix=".csv",
            sensors=_BOTH,
            write=csv_file.write_csv,
            read=csv_file.read_csv,
        ),
        LabelFormat(
            name=jsonl_file.FORMAT,
            suffix=".jsonl",
            sensors=_BOTH,
            write=jsonl_file.write_jsonl,
            read=jsonl_file.read_jsonl,
        ),
        LabelFormat(
            name=parquet_file.FORMAT,
            suffix=".parquet",
            sensors=_BOTH,
            write=parquet_file.write_parquet,
            read=parquet_file.read_parquet,
        ),
        LabelFormat(
            name=coco.FORMAT,
            suffix=".json",
            sensors=frozenset({"depth"}),
            write=coco.write_coco,
            read=coco.read_coco,
        ),
        LabelFormat(
            name=png_masks.FORMAT,
            suffix=None,
            sensors=frozenset({"depth"}),
            write=png_masks.write_png_masks,
            read=png_masks.read_png_masks,
        ),
        LabelFormat(
            name=kitti.FORMAT,
            suffix=None,
            sensors=frozenset({"lidar"}),
            write=kitti.write_semantic_kitti,
            read=kitti.read_semantic_kitti,
        ),
    )
}


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportedLabels:
    """How many labels of each sensor were written, and left out as the format has no place for
    them."""

    written: dict[SensorKind, int]
    left_out: dict[SensorKind, int]


def write_labels(
    format: LabelFormat, path: Path, header: LabelHeader, layer: Iterable[CaptureLabels]
) -> ExportedLabels:
    """Write what the format has a place for. Raises ExportError."""
    written: Counter[SensorKind] = Counter()
    left_out: Counter[SensorKind] = Counter()

    def kept() -> Iterator[CaptureLabels]:
        for labels in layer:
            sensor = labels.capture.sensor
            count = int(labels.label.size)
            if sensor not in format.sensors:
                left_out[sensor] += count
            elif count:
                written[sensor] += count
                yield labels

    format.write(path, header, kept())
    return ExportedLabels(written=dict(written), left_out=dict(left_out))


def open_labels_file(path: Path) -> tuple[LabelFormat, LabelFile]:
    """A file or folder of labels. Raises RecordingError for what is none, and what is damaged as
    far as its header shows; for the rest see LabelFile."""
    format = FORMATS[_format_name(path)]
    return format, format.read(path)


def _format_name(path: Path) -> str:
    if path.is_dir():
        if not (path / INDEX).is_file():
            raise RecordingError(
                f"is a folder without {INDEX}.",
                file=path,
                advice="Name the folder that `scanloom labels export` has written.",
            )
        name = folder_header(path).get("format")
        if name not in (png_masks.FORMAT, kitti.FORMAT):
            raise damaged(path / INDEX, "it does not say of which format the folder is")
        return str(name)
    try:
        head = read_head(path, _HEAD_BYTES)
    except OSError as error:
        raise unreadable(path, error) from error
    if head.startswith(parquet_file.MAGIC):
        return parquet_file.FORMAT
    if head.startswith(csv_file.MARK.encode()):
        return csv_file.FORMAT
    if head.startswith(f'{{"{HEADER_KEY}"'.encode()):
        return jsonl_file.FORMAT
    if head.lstrip().startswith(b"{"):
        return coco.FORMAT
    raise RecordingError(
        "is no file of labels.",
        file=path,
        advice=f"Importable are {', '.join(FORMATS)} as `scanloom labels export` writes them.",
    )
