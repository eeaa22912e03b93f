"""Names of files as text that can be shown and written.

A file's name is bytes. Python has those that are no UTF-8 as lone surrogates, which no encoder
takes: neither a terminal nor JSON, a picture or a browser.
"""

from typing import Any


def readable(text: str) -> str:
    r"""The text with ``\xff`` in the place of each byte that is no UTF-8; other text as it is."""
    try:
        raw = text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        # Surrogates that are no bytes of a name.
        raw = text.encode("utf-8", "backslashreplace")
    return raw.decode("utf-8", "backslashreplace")


def readable_values(value: Any) -> Any:
    """Dictionaries, lists and tuples, as JSON has them, with every text in them readable."""
    if isinstance(value, str):
        return readable(value)
    if isinstance(value, dict):
        return {readable_values(key): readable_values(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [readable_values(inner) for inner in value]
    return value
