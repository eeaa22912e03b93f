"""Recordings at addresses such as ``s3://bucket/robot/run.mcap``: listed, and copied to be read."""

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import fsspec.core

from fusion_core.model.errors import RecordingError, ScanLoomError
from fusion_core.recordings.rosbag2.metadata import METADATA
from fusion_core.workflows.batch.cache import RemoteCache, cache_space
from fusion_core.workflows.batch.suffixes import has_recording_suffix

_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]*://", re.ASCII)
_MAGIC = re.compile(r"[*?\[]")
_EXTRAS = {"s3": "s3", "s3a": "s3", "gs": "gs", "gcs": "gs"}
# What tells one version of a file from the next, in the words of the stores.
_VERSION_KEYS = ("size", "ETag", "etag", "md5Hash", "mtime", "LastModified", "updated", "created")


def is_address(text: str) -> bool:
    """Whether a text is an address, rather than a path of this machine."""
    return _ADDRESS.match(text) is not None


def find_remote(address: str) -> list[tuple[str, str]]:
    """The recordings that an address stands for, each with the folder that was searched.

    The address is that of a recording, of a folder that is searched, or a pattern. Files are
    recognised by a recording's suffix, and folders by a recorder's description: their content is
    not read. Raises RecordingError where there is none.
    """
    with _reached(address) as (files, path):
        if _MAGIC.search(path):
            root = path[: path.rindex("/", 0, _first_magic(path) + 1)]
            found = [
                each
                for match in sorted(files.glob(path))
                for each in (_search(files, match) if files.isdir(match) else _own(match))
            ]
        elif files.isfile(path):
            root, found = _parent(path), [path]
        elif files.isdir(path):
            found = _search(files, path)
            root = _parent(path) if found == [path] else path
        else:
            raise RecordingError("does not exist.", file=address, advice="Check the address.")
        if not found:
            raise RecordingError(
                "has no file with a recording's suffix (.bag, .mcap, .db3).", file=address
            )
        unstrip = files.unstrip_protocol
        return [(unstrip(each), unstrip(root)) for each in found]


def remote_state(address: str) -> str:
    """What tells this version of a remote recording from another one. Raises RecordingError."""
    with _reached(address) as (files, path):
        return repr(sorted((name, _version(entry)) for name, entry in _parts(files, path).items()))


@contextmanager
def local_copy(address: str, cache: RemoteCache) -> Iterator[Path]:
    """The recording at ``address``, copied for as long as the block runs.

    Waits until others have left room in the cache. Raises RecordingError where it cannot be read,
    or is larger than the whole cache.
    """
    with _reached(address) as (files, path):
        sizes = {name: int(entry["size"]) for name, entry in _parts(files, path).items()}
    needed = sum(sizes.values())
    if needed > cache.bytes_max:
        raise RecordingError(
            f"has {needed:,} bytes, and the cache {cache.bytes_max:,}.",
            file=address,
            advice="Give a larger --cache-gib.",
        )
    with cache_space(cache, needed) as folder:
        copy = folder / PurePosixPath(path).name
        with _reached(address) as (files, path):
            for name, size in sizes.items():
                target = copy / name if name else copy
                target.parent.mkdir(parents=True, exist_ok=True)
                files.get_file(f"{path}/{name}" if name else path, str(target))
                if target.stat().st_size != size:
                    raise RecordingError("was changed while it was copied.", file=address)
        yield copy


@contextmanager
def _reached(address: str) -> Iterator[tuple[Any, str]]:
    """The store of an address, and the path in it; what fails in the block names the address."""
    scheme = address.split("://")[0]
    try:
        # A chain of stores could lead to any file of this machine.
        if "::" in address:
            raise RecordingError("is a chain of addresses.", file=address)
        files, path = fsspec.core.url_to_fs(address)
        yield files, path.rstrip("/")
    except ScanLoomError:
        raise
    except ImportError as error:
        extra = _EXTRAS.get(scheme)
        raise RecordingError(
            f"needs a package that is not installed: {error}",
            file=address,
            advice=f"Install scanloom[{extra}]." if extra else "Install it.",
        ) from error
    except FileNotFoundError as error:
        raise RecordingError(
            "does not exist.", file=address, advice="Check the address."
        ) from error
    except Exception as error:  # Each store raises errors of its own.
        raise RecordingError(
            f"cannot be read: {type(error).__name__}: {error}.",
            file=address,
            advice="Check the address, the network and the credentials.",
        ) from error


def _search(files: Any, folder: str) -> list[str]:
    """Recordings below a folder, in the order of their names."""
    paths = [path for path in sorted(files.find(folder)) if not _is_hidden(path, folder)]
    described = {_parent(path) for path in paths if PurePosixPath(path).name == METADATA}
    single = [
        path
        for path in paths
        if has_recording_suffix(path) and not any(path.startswith(f"{each}/") for each in described)
    ]
    return sorted([*described, *single])


def _own(path: str) -> list[str]:
    return [path] if has_recording_suffix(path) else []


def _is_hidden(path: str, folder: str) -> bool:
    return any(part.startswith(".") for part in path[len(folder) :].split("/"))


def _parts(files: Any, path: str) -> dict[str, Mapping[str, Any]]:
    """What is known of each file of a recording, by its path in it; a single one has none."""
    if files.isfile(path):
        return {"": files.info(path)}
    found = files.find(path, detail=True)
    if not found:
        raise FileNotFoundError(path)
    return {name[len(path) + 1 :]: entry for name, entry in found.items()}


def _version(entry: Mapping[str, Any]) -> list[str]:
    return [f"{key}={entry[key]}" for key in _VERSION_KEYS if key in entry]


def _parent(path: str) -> str:
    return path.rpartition("/")[0]


def _first_magic(path: str) -> int:
    found = _MAGIC.search(path)
    return len(path) if found is None else found.start()


def default_cache_folder() -> Path:
    """Of this user: in a folder that all share, others could put a link in its place."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "scanloom"
