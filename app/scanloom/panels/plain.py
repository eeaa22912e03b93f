"""Names from recordings in Markdown: they may hold anything, and must be read as they are."""

import re

_MEANS_SOMETHING = re.compile(r"([!-/:-@\[-`{-~])")


def plain_markdown(text: str) -> str:
    """Markdown that shows ``text`` itself; without this, viser would run HTML in it."""
    return _MEANS_SOMETHING.sub(r"\\\1", " ".join(text.split()))
