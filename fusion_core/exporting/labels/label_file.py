"""What every file of labels says about itself, and how one is refused."""

import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Self

from fusion_core.files.regular_file import open_regular
from fusion_core.model.errors import RecordingError
from fusion_core.model.labels import Capture, CaptureLabels, Label

SCHEMA = 1
HEADER_KEY = "scanloom_labels"
"""In a file's header the version of what it holds."""

LABEL_NAMES = {label.name.lower(): label for label in Label}
MASK_VALUES = {"unlabelled": 0} | {name: int(label) + 1 for name, label in LABEL_NAMES.items()}
"""In masks and in ``.label`` files: the label's code + 1, since both use 0 for unlabelled."""

# Set by hand, above the largest depth image and the longest scan.
_SAMPLES_MAX = 1 << 24
_LINE_MAX_BYTES = 1 << 16
_EXPORT_AGAIN = "Export it again, or import another file."


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelHeader:
    """Whose labels a file holds: ``layer``, of the recording ``recording`` with this digest."""

    layer: str
    recording: str
    recording_sha256: str

    def to_json(self, format: str) -> dict[str, Any]:
        """As a file has it."""
        return {
            HEADER_KEY: SCHEMA,
            "format": format,
            "layer": self.layer,
            "recording": self.recording,
            "recording_sha256": self.recording_sha256,
        }

    @classmethod
    def of_json(cls, found: Any, file: Path) -> Self:
        """Raises RecordingError where it is none, or of a newer version."""
        schema = found.get(HEADER_KEY) if isinstance(found, dict) else None
        if type(schema) is not int or schema < 1:
            raise RecordingError(
                "does not say which recording its labels belong to.",
                file=file,
                advice="Importable is what `scanloom labels export` has written.",
            )
        if schema > SCHEMA:
            raise RecordingError(
                f"has labels of version {schema}, and this program knows {SCHEMA}.",
                file=file,
                advice="Import it with the program's version that wrote it, or a later one.",
            )
        values = [found.get(key) for key in ("layer", "recording", "recording_sha256")]
        if not all(isinstance(value, str) and value for value in values):
            raise damaged(file, "its header lacks the layer or the recording")
        return cls(layer=values[0], recording=values[1], recording_sha256=values[2])

    def require_recording(self, name: str, sha256: str, file: Path) -> None:
        """Raise RecordingError unless the labels belong to the recording of this digest."""
        if self.recording_sha256 != sha256:
            raise RecordingError(
                f"has labels of another recording, {self.recording}, not of this {name}: their "
                f"digests {self.recording_sha256[:12]} and {sha256[:12]} differ.",
                file=file,
                advice="Name the recording that it was exported from.",
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelFile:
    """A file's header and its labels: each call of ``labels`` reads the file anew, in the order of
    Capture, without captures that have no label. It raises RecordingError where it comes to damage:
    what must be whole is read to its end before it is used.
    """

    header: LabelHeader
    labels: Callable[[], Iterator[CaptureLabels]]


def damaged(file: Path, problem: str) -> RecordingError:
    """The error for a file that holds what no export writes."""
    return RecordingError(
        f"is no whole file of labels: {problem}.", file=file, advice=_EXPORT_AGAIN
    )


def cut_off(file: Path) -> RecordingError:
    """The error for a file without its end."""
    return damaged(file, "its end is missing")


def unreadable(file: Path, error: OSError) -> RecordingError:
    """The error for a file that cannot be read at all."""
    return RecordingError(
        f"cannot be read: {error.strerror or error}.",
        file=file,
        advice="Check the path and its permissions.",
    )


def capture_of(values: Iterable[Any], file: Path, where: str) -> Capture:
    """A capture out of a file's fields, in their order. Raises RecordingError."""
    sensor, topic, *numbers = values
    if sensor not in ("lidar", "depth") or not isinstance(topic, str):
        raise damaged(file, f"{where} names neither a scan nor a depth image")
    if not all(type(number) is int and abs(number) < 1 << 63 for number in numbers):
        raise damaged(file, f"{where} has a stamp, index or size that is no whole number")
    stamp_ns, index, rows, columns = numbers
    if rows * columns > _SAMPLES_MAX:
        raise damaged(file, f"{where} claims {rows} x {columns} samples")
    try:
        return Capture(sensor, topic, stamp_ns, index, rows, columns)
    except ValueError as error:
        raise damaged(file, f"{where}: {error}") from error


def label_of(name: Any, file: Path, where: str) -> Label:
    """The label of a name. Raises RecordingError."""
    if not isinstance(name, str) or name not in LABEL_NAMES:
        known = ", ".join(LABEL_NAMES)
        raise damaged(file, f"{where} has a label that is none of {known}")
    return LABEL_NAMES[name]


def ordered(labels: Iterable[CaptureLabels], file: Path) -> Iterator[CaptureLabels]:
    """The same labels without empty captures. Raises RecordingError for captures out of order."""
    before: Capture | None = None
    for found in labels:
        if before is not None and found.capture <= before:
            raise damaged(
                file,
                f"{found.capture.topic} at {found.capture.stamp_ns} ns stands twice or out of "
                "order (sensor, topic, stamp, index)",
            )
        before = found.capture
        if found.label.size:
            yield found


def text_lines(stream: BinaryIO, file: Path) -> Iterator[str]:
    """Lines of UTF-8 with their ends, of bounded length. Raises RecordingError."""
    while line := stream.readline(_LINE_MAX_BYTES):
        if len(line) == _LINE_MAX_BYTES:
            raise damaged(file, f"it has a line of more than {_LINE_MAX_BYTES} bytes")
        try:
            yield line.decode("utf-8")
        except UnicodeDecodeError as error:
            raise damaged(file, "it is not UTF-8") from error


def first_line(file: Path) -> str:
    """The first line, empty where there is none. Raises RecordingError."""
    try:
        with open_regular(file) as stream:
            return next(text_lines(stream, file), "")
    except OSError as error:
        raise unreadable(file, error) from error


def json_of(text: str, file: Path, where: str) -> Any:
    """What a JSON text says. Raises RecordingError."""
    try:
        return json.loads(text)
    # RecursionError: nested without end. ValueError: numbers of thousands of digits, too.
    except (ValueError, RecursionError) as error:
        raise damaged(file, f"{where} is not JSON") from error
