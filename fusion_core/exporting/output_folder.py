"""A folder of results: a run into it is skipped, replaces earlier results, or is refused."""

import hashlib
import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from fusion_core.exporting.manifest import (
    MANIFEST_NAME,
    LabelsDigest,
    Manifest,
    RunIdentity,
    digest_input,
    files_below,
    manifest_text,
)
from fusion_core.files.atomic import write_text
from fusion_core.files.inputs import real_path, require_apart
from fusion_core.files.work_folder import WORK_NAME, clear_abandoned, work_folder
from fusion_core.model.errors import ExportError
from fusion_core.model.labels import LabelLayer
from fusion_core.model.progress import Progress, silent


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputPlan:
    """What a run into ``folder`` is to do.

    ``is_done``: the folder already holds these results. ``earlier_manifest``: that of the last
    run, whose results the new ones replace.
    """

    folder: Path
    run: RunIdentity
    is_done: bool
    earlier_manifest: Manifest


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRequest:
    """What a run is to compute, and from what.

    ``also_read``: files that are read besides the inputs: the settings file, whose content is
    ``settings_text``, or the data set around the inputs; None for what was not given. ``labels``:
    the layer that overrules classes, None where there is none.
    """

    command: str
    inputs: Sequence[Path]
    settings_text: str
    seed: int
    also_read: Collection[Path | None] = ()
    labels: LabelLayer | None = None


def plan_output(
    folder: Path,
    request: RunRequest,
    *,
    force: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> OutputPlan:
    """Decide what a run does with an output folder, without changing its files.

    A folder whose manifest has the same version, command, settings, seed, inputs and labels, and
    whose files are still as written, is skipped unless ``force``.

    Raises ExportError for a folder that is an input, lies inside one or holds one. Without
    ``overwrite`` also for one with the results of another command, or with files that its manifest
    does not list; with it, the former are replaced, and the latter stay.
    """
    if (folder.exists() or folder.is_symlink()) and not folder.is_dir():
        raise ExportError("is not a folder.", file=folder, advice="Name another output folder.")
    require_apart(folder, request.inputs)
    run = RunIdentity(
        command=request.command,
        inputs=tuple(digest_input(path, progress) for path in request.inputs),
        settings_sha256=hashlib.sha256(request.settings_text.encode("utf-8")).hexdigest(),
        seed=request.seed,
        labels=_labels_digest(request.labels),
    )
    manifest = Manifest.read(folder)
    skip = not force and manifest.matches(run)
    if skip:
        clear_abandoned(folder)
    else:
        require_apart(folder, [path for path in request.also_read if path is not None])
        if not overwrite:
            require_replaceable(manifest, request.command)
    return OutputPlan(folder=folder, run=run, is_done=skip, earlier_manifest=manifest)


@contextmanager
def results_folder(plan: OutputPlan) -> Iterator[Path]:
    """Yield an empty folder to write all results into; they replace the earlier ones together.

    Enter it before the work begins: it keeps other runs out of ``plan.folder``. When the block
    ends, the files of the last run that are no longer results are removed, the manifest is written
    and the new files are moved to ``plan.folder``. When it raises, the earlier results stay as they
    were. Raises ExportError where the folder cannot be created or another run works in it, and,
    before any file is changed, where a result cannot be put in its place.
    """
    with work_folder(plan.folder) as work:
        if Manifest.read(plan.folder).content != plan.earlier_manifest.content:
            raise ExportError(
                "was written by another run in the meantime.",
                file=plan.folder,
                advice="Call again, or name another output folder.",
            )
        yield work
        _publish(plan, work)


def _labels_digest(layer: LabelLayer | None) -> LabelsDigest | None:
    return None if layer is None else LabelsDigest(layer.name, layer.sha256)


def _file_names(folder: Path) -> list[str]:
    """Files of an output folder, without its manifest and unfinished work."""
    return [
        name
        for name in files_below(folder)
        if name != MANIFEST_NAME and PurePosixPath(name).parts[0] != WORK_NAME
    ]


def require_replaceable(manifest: Manifest, command: str) -> None:
    """Raise ExportError for another command's results, and for files of unknown origin."""
    if manifest.document and manifest.command != command:
        raise ExportError(
            f"holds results of {manifest.command or 'an earlier version'}.",
            file=manifest.folder,
            advice=f"Name another output folder for {command}, or replace them with --overwrite.",
        )
    unknown = [name for name in _file_names(manifest.folder) if name not in manifest.results]
    if manifest.content is not None and not manifest.document:
        unknown.append(MANIFEST_NAME)
    if unknown:
        shown = ", ".join(unknown[:3]) + (f" and {len(unknown) - 3} more" if unknown[3:] else "")
        raise ExportError(
            f"holds files that no run here has written: {shown}.",
            file=manifest.folder,
            advice="Name another output folder, or write beside them with --overwrite.",
        )


def _publish(plan: OutputPlan, results: Path) -> None:
    # In this order, a run that is killed in between leaves a folder whose manifest knows each
    # file but finds some missing or changed: readers refuse it and the next run replaces it.
    names = _file_names(results)
    stale = [name for name in plan.earlier_manifest.results if name not in names]
    for name in (*names, *stale, MANIFEST_NAME):
        _require_writable(plan, name)
    # Made in the work folder, where what a killed run leaves is cleared.
    manifest = results.parent / MANIFEST_NAME
    write_text(manifest, manifest_text(plan.run, results, names))
    try:
        for name in stale:
            (plan.folder / name).unlink(missing_ok=True)
        manifest.replace(plan.folder / MANIFEST_NAME)
        for name in names:
            target = plan.folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            (results / name).replace(target)
    except OSError as error:
        raise ExportError(
            f"cannot be written: {error.strerror or error}.",
            file=plan.folder,
            advice="Call again when the folder can be written.",
        ) from error


def _require_writable(plan: OutputPlan, name: str) -> None:
    """Raise ExportError where a result cannot be written or removed, or would replace a file that
    is not a result."""
    target = plan.folder / name
    parent = target.parent
    while not parent.exists() and not parent.is_symlink():
        parent = parent.parent
    is_own = name in plan.earlier_manifest.results or (
        name == MANIFEST_NAME and plan.earlier_manifest.document
    )
    if not real_path(parent).is_relative_to(real_path(plan.folder)):
        problem = "leads out of the output folder"
    elif not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        problem = "cannot be written: its folder does not allow it"
    elif target.is_dir() and not target.is_symlink():
        problem = "is a folder where a result must go"
    elif not is_own and (target.exists() or target.is_symlink()):
        problem = "was not written by a run, and has the name of a result"
    else:
        return
    raise ExportError(f"{problem}.", file=target, advice="Name another output folder.")
