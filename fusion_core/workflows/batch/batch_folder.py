"""The folder of a batch: of one command, and of one run at a time."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fusion_core.files.atomic import cannot_write, write_text
from fusion_core.files.lock import acquire_lock
from fusion_core.files.regular_file import read_regular
from fusion_core.model.errors import ExportError
from fusion_core.model.project import PROJECT
from fusion_core.workflows.batch.outcome import BatchCommand
from fusion_core.workflows.batch.task import OUTCOMES, RUNS, UNFINISHED

_MARK_NAME = "batch.json"
_LOCK_NAME = ".batch.lock"
_MARK_BYTES_MAX = 1 << 16


@contextmanager
def batch_folder(folder: Path, command: BatchCommand) -> Iterator[None]:
    """Make the folder where there is none, and keep other batches out of it in the block.

    Raises ExportError where it is another command's, holds files of another origin, is in use or
    cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _require_own(folder, command)
        lock = folder / _LOCK_NAME
        descriptor = acquire_lock(lock)
    except OSError as error:
        raise cannot_write(folder, error) from error
    if descriptor is None:
        raise ExportError(
            "is being written by another batch.",
            file=folder,
            advice="Wait until that has ended, or name another output folder.",
        )
    try:
        _prepare(folder, command)
        yield
    finally:
        shutil.rmtree(folder / UNFINISHED, ignore_errors=True)
        lock.unlink(missing_ok=True)
        os.close(descriptor)


def _prepare(folder: Path, command: BatchCommand) -> None:
    try:
        for name in (RUNS, OUTCOMES):
            (folder / name).mkdir(exist_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error
    text = json.dumps({"project": PROJECT, "command": f"batch {command}"}, indent=2) + "\n"
    write_text(folder / _MARK_NAME, text)


def _require_own(folder: Path, command: BatchCommand) -> None:
    mark = folder / _MARK_NAME
    names = sorted(child.name for child in folder.iterdir())
    if mark.name not in names:
        foreign = [name for name in names if name != _LOCK_NAME]
        if foreign:
            raise ExportError(
                f"holds files that no batch has written, such as {foreign[0]}.",
                file=folder,
                advice="Name another output folder.",
            )
        return
    try:
        document = json.loads(read_regular(mark, _MARK_BYTES_MAX))
        written_by = document["command"] if document["project"] == PROJECT else None
    except (ValueError, KeyError, TypeError, RecursionError):
        written_by = None
    if written_by != f"batch {command}":
        raise ExportError(
            f"holds results of {written_by or 'something else'}.",
            file=folder,
            advice=f"Name another output folder for batch {command}.",
        )
