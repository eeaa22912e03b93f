"""A command's inputs are never overwritten, moved or removed."""

import os
from collections.abc import Collection, Iterator
from pathlib import Path

from fusion_core.model.errors import ExportError


def require_apart(output: Path, inputs: Collection[Path]) -> None:
    """Raise ExportError where ``output``, a file or folder to be written, is an input, lies inside
    one or holds one, with links followed."""
    target = real_path(output)
    for given in inputs:
        for place in _real_paths(given):
            if place == target:
                problem = f"is read as the input {given.name}"
            elif place in target.parents:
                problem = f"lies inside the input {given.name}"
            elif target in place.parents:
                problem = f"holds the input {given.name}"
            else:
                continue
            raise ExportError(
                f"{problem}, which is never changed.",
                file=output,
                advice="Choose another place for the output.",
            )


def _real_paths(given: Path) -> Iterator[Path]:
    """Where an input is with links followed, where it is named, and where links inside it lead."""
    yield real_path(given)
    yield real_path(given.parent) / given.name
    for folder, folders, files in os.walk(given):
        for name in (*folders, *files):
            path = Path(folder) / name
            if path.is_symlink():
                yield real_path(path)


def real_path(path: Path) -> Path:
    """The path with links resolved, as far as it exists and its links do not form a loop."""
    return Path(os.path.realpath(path))
