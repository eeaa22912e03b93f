"""File names as text that can be displayed and encoded.

A file name is bytes. Python represents bytes that are not UTF-8 as lone surrogates, which cannot
be encoded for a terminal, JSON, an image or a browser.
"""

from typing import Any


def escape_undecodable(text: str) -> str:
    r"""The text with ``\xff`` in place of each byte that is not UTF-8; other text unchanged."""
    try:
        raw = text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        # Surrogates that do not represent bytes.
        raw = text.encode("utf-8", "backslashreplace")
    return raw.decode("utf-8", "backslashreplace")


def printable(text: str) -> str:
    """``text`` on one line, with control characters and direction marks written as escapes.

    Topic and file names come out of recordings. A terminal obeys escape sequences, and a mark that
    turns the direction of writing disguises a name.
    """
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode()
        for char in escape_undecodable(text)
    )


def escape_undecodable_values(value: Any) -> Any:
    """``escape_undecodable`` for every text in nested dictionaries, lists and tuples."""
    if isinstance(value, str):
        return escape_undecodable(value)
    if isinstance(value, dict):
        return {
            escape_undecodable_values(key): escape_undecodable_values(inner)
            for key, inner in value.items()
        }
    if isinstance(value, list | tuple):
        return [escape_undecodable_values(inner) for inner in value]
    return value
