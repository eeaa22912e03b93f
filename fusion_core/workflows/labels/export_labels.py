"""A layer as a file or folder that others read."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion_core.annotation.identity import RecordingIdentity
from fusion_core.annotation.store import LabelStore
from fusion_core.exporting.labels.formats import (
    FORMATS,
    ExportedLabels,
    LabelFormat,
    write_labels,
)
from fusion_core.exporting.labels.label_file import LabelHeader
from fusion_core.exporting.manifest import InputDigest, Manifest, RunIdentity
from fusion_core.exporting.output_folder import OutputPlan, require_replaceable, results_folder
from fusion_core.files.inputs import require_apart
from fusion_core.model.errors import ExportError
from fusion_core.model.progress import Progress
from fusion_core.workflows.labels.chosen_layers import chosen_layer
from fusion_core.workflows.labels.open_store import open_labels
from fusion_core.workflows.source import paths_of

_COMMAND = "labels export"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """``address``: as ``open_labels`` has it. ``layer``: None for the only one. ``format``: of
    FORMATS, None for that of the output's suffix. ``overwrite``: replace what is there."""

    address: str | None = None
    layer: str | None = None
    format: str | None = None
    overwrite: bool = False


def export_labels(
    recording: Path, output: Path, options: ExportOptions, progress: Progress
) -> dict[str, Any]:
    """Write a layer and report what was written, as JSON. The store is not changed.

    Raises ExportError where ``output`` is refused or cannot be written, and as ``open_labels`` and
    ``chosen_layer``.
    """
    format = _format_of(output, options.format)
    require_apart(output, paths_of(recording))
    with open_labels(recording, options.address, create=False, progress=progress) as store:
        layer = chosen_layer(store, options.layer)
        header = LabelHeader(
            layer=layer,
            recording=store.recording.name,
            recording_sha256=store.recording.sha256,
        )
        if Path(store.place).exists():
            require_apart(output, [Path(store.place)])
        if format.suffix is None:
            exported = _write_folder(format, output, header, store, options)
        else:
            _require_free(output, overwrite=options.overwrite)
            exported = write_labels(format, output, header, store.labelled(layer))
    return {
        "output": str(output),
        "format": format.name,
        "layer": layer,
        "written": exported.written,
        "left_out": exported.left_out,
    }


def _format_of(output: Path, name: str | None) -> LabelFormat:
    if name is not None:
        return FORMATS[name]
    suffixes = {format.suffix: format for format in FORMATS.values() if format.suffix}
    if output.suffix not in suffixes:
        raise ExportError(
            "does not say which format it is to have.",
            file=output,
            advice=f"Choose one by --format, or end the name in {', '.join(suffixes)}.",
        )
    return suffixes[output.suffix]


def _require_free(output: Path, *, overwrite: bool) -> None:
    if output.is_dir():
        raise ExportError("is a folder.", file=output, advice="Name a file, or another --format.")
    if output.exists() and not overwrite:
        raise ExportError("exists.", file=output, advice="Choose another name, or --overwrite.")


def _write_folder(
    format: LabelFormat,
    output: Path,
    header: LabelHeader,
    store: LabelStore,
    options: ExportOptions,
) -> ExportedLabels:
    plan = OutputPlan(
        folder=output,
        run=_run_identity(format, header.layer, store.recording),
        is_done=False,
        earlier_manifest=Manifest.read(output),
    )
    if not options.overwrite:
        require_replaceable(plan.earlier_manifest, _COMMAND)
    with results_folder(plan) as work:
        return write_labels(format, work, header, store.labelled(header.layer))


def _run_identity(format: LabelFormat, layer: str, recording: RecordingIdentity) -> RunIdentity:
    # What the labels say is in the files' digests.
    choices = hashlib.sha256(f"{format.name}\n{layer}".encode()).hexdigest()
    source = InputDigest(recording.name, {recording.name: recording.sha256})
    return RunIdentity(command=_COMMAND, inputs=(source,), settings_sha256=choices, seed=0)
