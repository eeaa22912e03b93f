"""Whose labels they are, and of which recording."""

import unicodedata
from dataclasses import dataclass
from typing import Literal

from fusion_core.model.errors import SettingsError
from fusion_core.model.names import escape_undecodable, printable

LabelSource = Literal["human", "automatic", "imported"]

_MAX_NAME_CHARS = 80
_MAX_TEXT_CHARS = 10_000


@dataclass(frozen=True, slots=True)
class RecordingIdentity:
    """A recording by its content. ``name`` is for people; recordings of equal ``sha256`` are one.

    Raises ValueError where ``sha256`` is no SHA-256 in hexadecimal digits.
    """

    name: str
    sha256: str

    def __post_init__(self) -> None:
        if len(self.sha256) != 64 or set(self.sha256) - set("0123456789abcdef"):
            raise ValueError("sha256 has 64 hexadecimal digits")
        object.__setattr__(self, "name", escape_undecodable(self.name))


@dataclass(frozen=True, slots=True)
class Author:
    """Who labels, and on what grounds.

    ``settings_sha256``: digest of the settings that the shown classes came from, or "". Raises
    SettingsError where a text cannot stand in the journal.
    """

    annotator: str
    source: LabelSource = "human"
    settings_sha256: str = ""
    comment: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "annotator", checked_name(self.annotator, "an annotator"))
        for text in (self.settings_sha256, self.comment):
            require_storable(text)


def checked_name(name: str, what: Literal["a layer", "an annotator"]) -> str:
    """A layer's or annotator's name without spaces around it, in Unicode's composed form, so that
    names that look alike are alike.

    Raises SettingsError where it is empty, longer than 80 characters or not printable.
    """
    trimmed = unicodedata.normalize("NFC", name.strip())
    if not trimmed or len(trimmed) > _MAX_NAME_CHARS or not trimmed.isprintable():
        raise SettingsError(
            f"{printable(name[: _MAX_NAME_CHARS + 1])!r} cannot be the name of {what}.",
            advice=f"Give 1 to {_MAX_NAME_CHARS} printable characters.",
        )
    return trimmed


def is_storable(text: str) -> bool:
    """Whether a text is short enough, and without what a database cannot keep: NUL, and halves of
    characters."""
    return len(text) <= _MAX_TEXT_CHARS and "\0" not in text and escape_undecodable(text) == text


def require_storable(text: str) -> None:
    """Raise SettingsError where a text cannot be kept."""
    if not is_storable(text):
        raise SettingsError(
            f"{printable(text[:_MAX_NAME_CHARS])!r} cannot be kept in a label store.",
            advice=f"Give at most {_MAX_TEXT_CHARS} characters of valid Unicode.",
        )
