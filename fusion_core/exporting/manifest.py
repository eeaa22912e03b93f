"""``manifest.json``: what the results in a folder were computed from, and their digests.

It names the command, the project's version, the libraries' versions, the seed, the digest of the
settings and of the labels, and the SHA-256 of every input and result. Names only: no absolute path,
clock or host. A file that differs from its manifest is not a result: code that reads results calls
``require_intact`` first.
"""

import hashlib
import json
import platform
from collections.abc import Collection, MutableMapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path, PurePosixPath
from typing import Any, Self

from fusion_core.files.file_state import FileState
from fusion_core.files.regular_file import open_regular, read_regular
from fusion_core.model.errors import ExportError, RecordingError, ScanLoomError
from fusion_core.model.names import escape_undecodable
from fusion_core.model.progress import Progress, silent
from fusion_core.model.project import PROJECT, project_version

MANIFEST_NAME = "manifest.json"

_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "numba", "gtsam")
_CHUNK_BYTES = 1 << 20
# A data set of a million files has a line for each.
_MAX_BYTES = 256 << 20


@dataclass(frozen=True, slots=True)
class InputDigest:
    """An input by its name and content. ``sha256`` has one entry for each file of a folder."""

    name: str
    sha256: dict[str, str]


@dataclass(frozen=True, slots=True)
class LabelsDigest:
    """A layer of labels by its name and content."""

    name: str
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RunIdentity:
    """What determines a run's results: runs of equal identity give the same bytes.

    ``labels``: a person's, None where the run takes none.
    """

    command: str
    inputs: tuple[InputDigest, ...]
    settings_sha256: str
    seed: int
    labels: LabelsDigest | None = None

    def to_json(self) -> dict[str, Any]:
        """As a manifest has it; without labels there is no such entry."""
        document: dict[str, Any] = {
            "project": PROJECT,
            "command": self.command,
            "version": project_version(),
            "seed": self.seed,
            "settings_sha256": self.settings_sha256,
            "inputs": [{"name": digest.name, "sha256": digest.sha256} for digest in self.inputs],
        }
        if self.labels is not None:
            document["labels"] = asdict(self.labels)
        return document


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """A folder's manifest. ``content`` is None where there is none; ``document`` is empty then, and
    where a file of this name is not a manifest of this project."""

    folder: Path
    content: bytes | None
    document: dict[str, Any]

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Raises ExportError where it cannot be read."""
        file = folder / MANIFEST_NAME
        try:
            content = read_regular(file, _MAX_BYTES) if file.exists() else None
            document = {} if content is None else json.loads(content.decode("utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise ExportError(
                "cannot be read as a manifest.",
                file=file,
                advice="Name another folder, or remove this file.",
            ) from error
        is_own = isinstance(document, dict) and document.get("project") == PROJECT
        return cls(folder=folder, content=content, document=document if is_own else {})

    @property
    def command(self) -> str | None:
        """The command that wrote the results; None where it is not known."""
        command = self.document.get("command")
        return command if isinstance(command, str) else None

    @property
    def results(self) -> dict[str, str]:
        """SHA-256 of each result. Names that lead out of the folder are ignored."""
        files = self.document.get("files")
        if not isinstance(files, dict):
            return {}
        return {
            name: sha256
            for name, sha256 in files.items()
            if isinstance(sha256, str)
            and not PurePosixPath(name).is_absolute()
            and ".." not in PurePosixPath(name).parts
        }

    def matches(self, run: RunIdentity) -> bool:
        """Whether the folder holds the results of this run, all as written."""
        own, wanted = self.document, run.to_json()
        return (
            bool(self.results)
            and own.get("labels") == wanted.get("labels")
            and all(own.get(key) == value for key, value in wanted.items())
            and all(map(self.is_intact, self.results))
        )

    def is_intact(self, name: str) -> bool:
        """Whether a result is still what the run wrote."""
        file = self.folder / name
        return file.is_file() and sha256_of_file(file) == self.results[name]


def manifest_text(run: RunIdentity, results: Path, names: Sequence[str]) -> str:
    """The manifest of the files ``names`` below ``results``."""
    document = run.to_json() | {
        "versions": {
            "python": ".".join(platform.python_version_tuple()[:2]),
            **{name: version(name) for name in _LIBRARIES},
        },
        "files": {name: sha256_of_file(results / name) for name in names},
    }
    return json.dumps(document, indent=2, ensure_ascii=False) + "\n"


def require_intact(folder: Path, names: Collection[str], command: str | None = None) -> None:
    """Raise ScanLoomError where one of the files ``names`` differs from the folder's manifest, or
    the folder's results are not those of ``command``.

    A run that was killed while it put its results in place leaves such files. Names that the
    manifest lacks, and folders without a manifest, are not checked.
    """
    manifest = Manifest.read(folder)
    if command is not None and manifest.command not in (None, command):
        raise ScanLoomError(
            f"holds results of {manifest.command}, not of {command}.",
            file=folder,
            advice=f"Give a folder that scanloom {command} has written.",
        )
    for name in manifest.results:
        if name in names and not manifest.is_intact(name):
            raise ScanLoomError(
                "is not as the run that made this folder wrote it.",
                file=folder / name,
                advice="Call that run again: it was interrupted, or the file was changed.",
            )


def digest_input(
    path: Path,
    progress: Progress = silent,
    known: MutableMapping[FileState, str] | None = None,
) -> InputDigest:
    """Hash an input file, or every file below an input folder.

    ``known``: digests of files that are not read again; those of the others are added. Raises
    RecordingError where a file cannot be read.
    """
    name = escape_undecodable(path.resolve().name)
    files = {escape_undecodable(below): path / below for below in files_below(path)} or {name: path}
    sha256 = {} if known is None else known
    try:
        # As they stand before they are read: a file that is still written is read again next time.
        states = {below: FileState.of(file, below) for below, file in files.items()}
        unknown = [state for state in states.values() if state not in sha256]
        total = sum(state.size for state in unknown)
        done = 0
        for state in unknown:
            sha256[state] = sha256_of_file(files[state.name])
            done += state.size
            progress(done, total, "hashing the input")
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}.", file=path) from error
    return InputDigest(name, {below: sha256[state] for below, state in states.items()})


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's content, read in chunks."""
    digest = hashlib.sha256()
    with open_regular(path) as stream:
        while chunk := stream.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def files_below(folder: Path) -> list[str]:
    """Files below a folder, relative and sorted; a link to a folder counts as a file."""
    return sorted(
        file.relative_to(folder).as_posix()
        for file in folder.rglob("*")
        if file.is_symlink() or not file.is_dir()
    )
