"""A name for each recording of a batch: readable, unique, and the same in any order."""

import hashlib
import re
import unicodedata
from collections import Counter
from collections.abc import Sequence

from fusion_core.model.names import escape_undecodable

# A folder's name has 255 bytes at most, and a character up to four of them.
_LENGTH_MAX = 45
_DIGEST_DIGITS = 8
_ALL_DIGITS = 64


def item_names(paths: Sequence[str]) -> tuple[str, ...]:
    """A name for each of ``paths``, which are relative, with "/", and differ from each other.

    A name is a file's name on any system, also where case is ignored: the parts of the path with
    "-" between them. Where several would share one, or it would be too long, it is its end
    and a digest of the path.
    """
    names = [_readable(path) or _with_digest(path, _DIGEST_DIGITS) for path in paths]
    shared = {name for name, count in Counter(map(str.casefold, names)).items() if count > 1}
    names = [
        _with_digest(path, _DIGEST_DIGITS) if name.casefold() in shared else name
        for path, name in zip(paths, names, strict=True)
    ]
    if len(set(map(str.casefold, names))) < len(names):
        # A file has the name of another with its digest.
        names = [_with_digest(path, _ALL_DIGITS) for path in paths]
    return tuple(names)


def _readable(path: str) -> str | None:
    """None where a name is too long or has nothing to show."""
    name = _shown(path)
    return name if 0 < len(name) <= _LENGTH_MAX else None


def _with_digest(path: str, digits: int) -> str:
    digest = hashlib.sha256(path.encode("utf-8", "surrogatepass")).hexdigest()[:digits]
    return f"{_shown(path)[-_LENGTH_MAX:]}-{digest}".lstrip("-.")


def _shown(path: str) -> str:
    text = unicodedata.normalize("NFC", escape_undecodable(path)).replace("/", "-")
    return re.sub(r"[^\w.-]+", "_", text).strip("-.")
