"""Text of a file inside an error message."""


def quote_clipped(text: str, max_characters: int = 40) -> str:
    """The text in quotes and escaped, cut after ``max_characters``: a file may hold any length."""
    return repr(text if len(text) <= max_characters else f"{text[:max_characters]}…")
