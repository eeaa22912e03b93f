"""A file of labels into a layer."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion_core.annotation.identity import Author, RecordingIdentity, checked_name
from fusion_core.annotation.layer_difference import DifferenceCounts, differing_samples
from fusion_core.exporting.labels.formats import open_labels_file
from fusion_core.model.labels import CaptureLabels, SensorKind
from fusion_core.model.progress import Progress
from fusion_core.workflows.labels.open_store import open_labels

IMPORTER = "import"
"""The annotator of what comes in, where nobody is named."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """``address``: as ``open_labels`` has it. ``layer``: None for that of the file. ``annotator``:
    who imports, and may undo it. ``replace``: make the layer as the file, whatever it loses."""

    address: str | None = None
    layer: str | None = None
    annotator: str = IMPORTER
    replace: bool = False


def import_labels(
    recording: Path, file: Path, options: ImportOptions, progress: Progress
) -> dict[str, Any]:
    """Bring in a file or folder that was exported of the same recording, as one action, and report
    the difference and ``done``, as JSON.

    Nothing is done where the layer has labels that the file lacks or gives otherwise, unless
    ``replace``. A format that holds one sensor's labels leaves the other's alone. Raises
    RecordingError where the file is damaged or of another recording, before anything is changed,
    and as ``open_labels`` and ``LabelStore.label``.
    """
    format, found = open_labels_file(file)
    layer = checked_name(options.layer or found.header.layer, "a layer")
    author = Author(options.annotator, "imported", comment=f"import of {file.resolve().name}")

    def accept(identity: RecordingIdentity) -> None:
        found.header.require_recording(identity.name, identity.sha256, file)
        # To its end: no store is made for a damaged file.
        for _ in found.labels():
            pass

    with open_labels(
        recording, options.address, create=True, progress=progress, accept=accept
    ) as store:
        ours = _of_sensors(store.labelled(layer), format.sensors)
        changes = list(differing_samples(ours, found.labels()))
        difference = DifferenceCounts.of(changes)
        done = options.replace or not (difference.altered or difference.missing)
        if done:
            store.label(layer, [change.after for change in changes], author)
        return {
            "file": str(file),
            "format": format.name,
            "store": store.place,
            "layer": layer,
            "done": done,
            "difference": difference.to_json(),
        }


def _of_sensors(
    layer: Iterable[CaptureLabels], sensors: Collection[SensorKind]
) -> Iterator[CaptureLabels]:
    return (labels for labels in layer if labels.capture.sensor in sensors)
