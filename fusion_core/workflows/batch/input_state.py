"""The files that a task reads, as they stand: what is unchanged is not done again."""

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from fusion_core.exporting.manifest import files_below
from fusion_core.files.file_state import FileState
from fusion_core.model.errors import RecordingError
from fusion_core.workflows.batch.items import BatchItem
from fusion_core.workflows.batch.remote import remote_state
from fusion_core.workflows.batch.task import BatchCall
from fusion_core.workflows.source import paths_of

# Rooms of a data set follow one another; a command reads three files at most besides.
_KEPT = 8


class InputStates:
    """Of one batch. What several tasks read, as a data set of rooms, is looked at once."""

    def __init__(self) -> None:
        self._state_of = lru_cache(maxsize=_KEPT)(_state_of)

    def of(self, item: BatchItem, call: BatchCall) -> str:
        """A digest of names, sizes and times of change; "" where a file cannot be looked at."""
        try:
            if item.is_remote:
                states = [remote_state(item.place)]
            else:
                states = [self._state_of(path) for path in paths_of(Path(item.place))]
            states += [self._state_of(path) for path in call.files(item)]
        except (OSError, RecordingError):
            return ""
        return _digest(states)


def _state_of(path: Path) -> str:
    names = files_below(path) if path.is_dir() else []
    files = {name: path / name for name in names} or {path.name: path}
    return _digest([repr(FileState.of(file, name)) for name, file in files.items()])


def _digest(texts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode("utf-8", "surrogatepass")).hexdigest()
