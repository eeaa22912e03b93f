"""The file of an outcome: it is written by the worker, and read again to resume and to report."""

import json
import secrets
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import overload

from pydantic import TypeAdapter, ValidationError

from fusion_core.exporting.manifest import MANIFEST_NAME
from fusion_core.files.atomic import cannot_write
from fusion_core.files.regular_file import read_regular
from fusion_core.model.errors import ExportError
from fusion_core.workflows.batch.outcome import Outcome
from fusion_core.workflows.batch.task import UNFINISHED, BatchTask

_BYTES_MAX = 64 << 20
_OUTCOME = TypeAdapter(Outcome)


def write_outcome(task: BatchTask, outcome: Outcome) -> None:
    """Raises ExportError.

    It is not flushed to disk, which would take longer than a short task: an outcome that a power
    failure has cut is one that is not done. Nor is its folder looked through, which holds as many
    files as the batch has recordings.
    """
    document = {"request": task.request(), "outcome": asdict(outcome)}
    text = json.dumps(document, indent=1, allow_nan=False) + "\n"
    aside = task.folder / UNFINISHED / f"{task.item.name}.{secrets.token_hex(4)}"
    try:
        aside.parent.mkdir(exist_ok=True)
        aside.write_text(text, encoding="utf-8")
        aside.replace(task.outcome_file)
    except OSError as error:
        with suppress(OSError):
            aside.unlink()
        raise cannot_write(task.outcome_file, error) from error


def is_done(task: BatchTask) -> bool:
    """Whether an earlier batch has done this task, and its results are still there.

    A file is taken to be as it was where its size and its time of change are.
    """
    if task.call.is_repeated or not task.input_state:
        return False
    try:
        document = json.loads(read_regular(task.outcome_file, _BYTES_MAX))
        same = document["request"] == json.loads(json.dumps(task.request()))
        failed = document["outcome"]["error"] is not None
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False
    is_there = task.call.command in ("info", "evaluate") or (task.output / MANIFEST_NAME).is_file()
    return bool(same and not failed and is_there)


class StoredOutcomes(Sequence[Outcome]):
    """The outcomes of a batch, each read when it is asked for: they take no memory."""

    def __init__(self, files: Sequence[Path]) -> None:
        self._files = files

    def __len__(self) -> int:
        return len(self._files)

    @overload
    def __getitem__(self, index: int) -> Outcome: ...

    @overload
    def __getitem__(self, index: slice) -> "StoredOutcomes": ...

    def __getitem__(self, index: int | slice) -> "Outcome | StoredOutcomes":
        """Raises ExportError where the file cannot be read."""
        if isinstance(index, slice):
            return StoredOutcomes(self._files[index])
        file = self._files[index]
        try:
            document = json.loads(read_regular(file, _BYTES_MAX))
            return _OUTCOME.validate_python(document["outcome"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError, ValidationError) as error:
            raise ExportError(
                "cannot be read as an outcome.", file=file, advice="Remove it and call again."
            ) from error
