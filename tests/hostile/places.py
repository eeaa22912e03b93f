"""Places of an output in relation to an input: equal to it, inside, around, beside, and by links.

The input lies three folders deep, and around it there is room for links.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

# Each file or link of an input: its inode and the digest of its content.
Snapshot = dict[Path, tuple[int, str]]


def _link_to_its_folder(given: Path) -> Path:
    link = given.parent.parent / "linked"
    link.symlink_to(given.parent, target_is_directory=True)
    return link


def _link_to_it(given: Path) -> Path:
    link = given.parent.parent / "link.mcap"
    link.symlink_to(given)
    return link


def _second_name(given: Path) -> Path:
    if given.is_dir():
        return given.parent / "second.mcap"
    second = given.parent.parent / "second.mcap"
    second.hardlink_to(given)
    return second


def _folder_of_links_to(given: Path, names: tuple[str, ...]) -> Path:
    folder = given.parent.parent / "other"
    folder.mkdir()
    for name in names:
        (folder / name).symlink_to(given)
    return folder


PLACES: dict[str, Callable[[Path], Path]] = {
    "itself": lambda given: given,
    "its folder": lambda given: given.parent,
    "a folder above": lambda given: given.parent.parent,
    "inside": lambda given: given / "out.mcap",
    "beside": lambda given: given.parent / "out.mcap",
    "itself by dots": lambda given: given.parent / ".." / given.parent.name / given.name,
    "a link to it": _link_to_it,
    "a link to its folder": _link_to_its_folder,
    "itself through a link": lambda given: _link_to_its_folder(given) / given.name,
    "a second name": _second_name,
    "a folder with a link to it": lambda given: _folder_of_links_to(given, ("fused.mcap",)),
    "a folder with links to its folder": lambda given: _folder_of_links_to(
        given.parent, ("figures", ".scanloom-unfinished")
    ),
}


def snapshot(*inputs: Path) -> Snapshot:
    """Inputs, with all that is in them."""
    paths = {path for given in inputs for path in (given, *given.rglob("*")) if not path.is_dir()}
    return {
        path: (path.lstat().st_ino, hashlib.sha256(path.read_bytes()).hexdigest())
        for path in sorted(paths)
    }
