"""The label store of a recording: beside it, or where ``--labels`` names it."""

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path

from fusion_core.annotation.action import Action
from fusion_core.annotation.address import parse_address
from fusion_core.annotation.identity import Author, RecordingIdentity, checked_name
from fusion_core.annotation.input_cache import known_digests
from fusion_core.annotation.store import LabelStore
from fusion_core.exporting.manifest import InputDigest, digest_input
from fusion_core.files.inputs import require_apart
from fusion_core.model.errors import RecordingError
from fusion_core.model.progress import Progress, silent
from fusion_core.workflows.source import paths_of

__all__ = [
    "SUFFIX",
    "Action",
    "Author",
    "LabelStore",
    "checked_name",
    "default_address",
    "open_labels",
    "recording_identity",
]

SUFFIX = ".labels.sqlite"


def open_labels(
    recording: Path,
    address: Path | str | None = None,
    *,
    create: bool,
    progress: Progress = silent,
    accept: Callable[[RecordingIdentity], object] = lambda recording: None,
) -> LabelStore:
    """Open the labels of a recording, made if they are missing and ``create``.

    ``address``: as LabelStore.open has it; None for ``default_address``. ``accept`` is given the
    recording before the store is opened or made; what it raises is raised. The recording's files
    are hashed, but for those that the store has seen as they are. Raises RecordingError where one
    cannot be read, ExportError where the store would lie inside the recording, and as
    LabelStore.open.
    """
    if not recording.exists():
        raise RecordingError("does not exist.", file=recording, advice="Check the path.")
    inputs = paths_of(recording)
    place = parse_address(default_address(recording) if address is None else address)
    if isinstance(place, Path):
        # Its own labels would make it another recording.
        require_apart(place, inputs)
    known = known_digests(place)
    digests = [digest_input(path, progress, known) for path in inputs]
    identity = recording_identity(digests)
    accept(identity)
    store = LabelStore.open(place, identity, create=create)
    store.remember_digests(known)
    return store


def default_address(recording: Path) -> Path:
    """Beside the file or folder, under its name; links to recordings share its labels."""
    target = recording.resolve()
    return target.with_name(target.name + SUFFIX)


def recording_identity(inputs: Sequence[InputDigest]) -> RecordingIdentity:
    """What tells recordings apart: the digest of the one file, or of the list of all files' names
    and digests. A file that is renamed stays the same recording."""
    first, *others = inputs
    if not others and list(first.sha256) == [first.name]:
        return RecordingIdentity(first.name, first.sha256[first.name])
    digest = hashlib.sha256()
    for given in inputs:
        for below, sha256 in sorted(given.sha256.items()):
            digest.update(f"{sha256}  {below}\n".encode())
    return RecordingIdentity(first.name, digest.hexdigest())
