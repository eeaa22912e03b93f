"""What an output folder was made of, and when it may be skipped, replaced or must be refused.

``manifest.json`` names the project's version, the libraries' versions, the seed, the digest of the
settings, and the SHA-256 of every input and result. Names only: no absolute path, clock or host.
"""

import hashlib
import json
import platform
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path, PurePosixPath

from fusion_core.exporting.atomic import write_text
from fusion_core.model.errors import ExportError, RecordingError
from fusion_core.model.progress import Progress, silent

MANIFEST_NAME = "manifest.json"

_PROJECT = "scanloom"
_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "numba", "gtsam")
# Results are made in here and moved up when all are whole. A killed run leaves it behind.
_WORK_NAME = ".scanloom-unfinished"
_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class InputDigest:
    """An input by its name and content. ``sha256`` has one entry for each file of a folder."""

    name: str
    sha256: dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class OutputPlan:
    """What a run into ``folder`` is to do.

    ``skip``: the folder already holds these results. ``earlier``: the files of the last run, which
    the new results replace.
    """

    folder: Path
    skip: bool
    inputs: tuple[InputDigest, ...]
    settings_sha256: str
    seed: int
    earlier: tuple[str, ...]


def plan_output(
    folder: Path,
    *,
    inputs: Sequence[Path],
    settings_text: str,
    seed: int,
    force: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> OutputPlan:
    """Decide about an output folder, without changing it.

    A folder whose manifest has the same version, settings, seed and inputs, and whose files are
    still as written, is skipped unless ``force``. Raises ExportError for a folder that holds files
    of which its manifest knows nothing, unless ``overwrite``, and for one inside an input.
    """
    if folder.exists() and not folder.is_dir():
        raise ExportError("is not a folder.", file=folder, advice="Name another output folder.")
    for path in inputs:
        if folder.resolve().is_relative_to(path.resolve()):
            raise ExportError(
                f"lies inside the input {path.name}, which is never changed.",
                file=folder,
                advice="Name another output folder.",
            )
    digests = tuple(digest_input(path, progress) for path in inputs)
    settings_sha256 = hashlib.sha256(settings_text.encode("utf-8")).hexdigest()
    manifest = _read_manifest(folder)
    results = _result_digests(manifest)
    same_work = {
        "version": project_version(),
        "seed": seed,
        "settings_sha256": settings_sha256,
        "inputs": [_input_record(digest) for digest in digests],
    }
    skip = (
        not force
        and bool(results)
        and all(manifest.get(key) == value for key, value in same_work.items())
        and _files_match(folder, results)
    )
    unknown = [name for name in _file_names(folder) if name not in results]
    if unknown and not skip and not overwrite:
        shown = ", ".join(unknown[:3]) + (f" and {len(unknown) - 3} more" if unknown[3:] else "")
        raise ExportError(
            f"holds files that no run here has written: {shown}.",
            file=folder,
            advice="Name another output folder, or use --overwrite.",
        )
    return OutputPlan(
        folder=folder,
        skip=skip,
        inputs=digests,
        settings_sha256=settings_sha256,
        seed=seed,
        earlier=tuple(results),
    )


@contextmanager
def results_folder(plan: OutputPlan) -> Iterator[Path]:
    """Yield an empty folder to write all results into; they replace the earlier ones together.

    When the block ends, the files of the last run that are no longer results are removed, the
    manifest is written and the new files are moved to ``plan.folder``. When it raises, the earlier
    results stay as they were. Raises ExportError where the folder cannot be made.
    """
    work = plan.folder / _WORK_NAME
    is_new = not plan.folder.exists()
    try:
        shutil.rmtree(work, ignore_errors=True)
        work.mkdir(parents=True)
    except OSError as error:
        raise ExportError(
            f"cannot be made: {error.strerror}.",
            file=plan.folder,
            advice="Name another output folder.",
        ) from error
    try:
        yield work
        _publish(plan, work)
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if is_new and not any(plan.folder.iterdir()):
            plan.folder.rmdir()


def write_manifest(plan: OutputPlan, results: Path) -> Path:
    """Write ``manifest.json`` to ``plan.folder`` for the files below ``results``."""
    manifest = {
        "project": _PROJECT,
        "version": project_version(),
        "versions": {
            "python": ".".join(platform.python_version_tuple()[:2]),
            **{name: version(name) for name in _LIBRARIES},
        },
        "seed": plan.seed,
        "settings_sha256": plan.settings_sha256,
        "inputs": [_input_record(digest) for digest in plan.inputs],
        "files": {name: sha256_of_file(results / name) for name in _file_names(results)},
    }
    path = plan.folder / MANIFEST_NAME
    write_text(path, json.dumps(manifest, indent=2, ensure_ascii=False) + "\n")
    return path


def project_version() -> str:
    """The installed version; a source tree that is not installed says so."""
    try:
        return version(_PROJECT)
    except PackageNotFoundError:
        return "0+not-installed"


def digest_input(path: Path, progress: Progress = silent) -> InputDigest:
    """Hash an input file, or every file below an input folder.

    Raises RecordingError where it cannot be read.
    """
    name = path.resolve().name
    files = {below: path / below for below in _files_below(path)} or {name: path}
    sha256 = {}
    try:
        total = sum(file.stat().st_size for file in files.values())
        done = 0
        for below, file in files.items():
            sha256[below] = sha256_of_file(file)
            done += file.stat().st_size
            progress(done, total, "hashing the input")
    except OSError as error:
        raise RecordingError(f"cannot be read: {error.strerror}.", file=path) from error
    return InputDigest(name, sha256)


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's content, read in chunks."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while chunk := stream.read(_CHUNK_BYTES):
            digest.update(chunk)
    return digest.hexdigest()


def _input_record(digest: InputDigest) -> dict[str, object]:
    return {"name": digest.name, "sha256": digest.sha256}


def _files_below(folder: Path) -> list[str]:
    """Files below a folder, relative and sorted; a link to a folder counts as a file."""
    return sorted(
        file.relative_to(folder).as_posix()
        for file in folder.rglob("*")
        if file.is_symlink() or not file.is_dir()
    )


def _file_names(folder: Path) -> list[str]:
    """Files of an output folder, without its manifest and unfinished work."""
    return [
        name
        for name in _files_below(folder)
        if name != MANIFEST_NAME and PurePosixPath(name).parts[0] != _WORK_NAME
    ]


def _read_manifest(folder: Path) -> dict[str, object]:
    """The folder's manifest; empty where there is none, or none that says what it should."""
    try:
        manifest = json.loads((folder / MANIFEST_NAME).read_text("utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise ExportError(
            "cannot be read as a manifest.",
            file=folder / MANIFEST_NAME,
            advice="Name another output folder, or remove this file.",
        ) from error
    return manifest if isinstance(manifest, dict) else {}


def _result_digests(manifest: dict[str, object]) -> dict[str, str]:
    """The files that a manifest names. One that leads out of the folder is not a result."""
    files = manifest.get("files")
    if not isinstance(files, dict):
        return {}
    return {
        name: digest
        for name, digest in files.items()
        if isinstance(digest, str)
        and not PurePosixPath(name).is_absolute()
        and ".." not in PurePosixPath(name).parts
    }


def _files_match(folder: Path, results: dict[str, str]) -> bool:
    return all(
        (folder / name).is_file() and sha256_of_file(folder / name) == digest
        for name, digest in results.items()
    )


def _publish(plan: OutputPlan, work: Path) -> None:
    # In this order, a run that is killed in between leaves a folder whose manifest knows each
    # file but finds some missing or changed: the next run replaces it.
    names = _file_names(work)
    for name in plan.earlier:
        stale = plan.folder / name
        if name not in names and stale.resolve().is_relative_to(plan.folder.resolve()):
            stale.unlink(missing_ok=True)
    write_manifest(plan, work)
    for name in names:
        target = plan.folder / name
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            (work / name).replace(target)
        except OSError as error:
            raise ExportError(f"cannot be written: {error.strerror}.", file=target) from error
