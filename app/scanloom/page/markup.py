"""Building blocks of the panels' HTML and Markdown.

All arguments are plain text and are escaped: names from recordings may contain markup.
"""

import html
import re

from fusion_core.model.names import escape_undecodable, printable

# All of ASCII's punctuation: CommonMark 2.4 lets each be escaped.
_PUNCTUATION = re.compile(r"([!-/:-@\[-`{-~])")
_BOX = (
    "width:100%;box-sizing:border-box;border:1px solid #c4ccd6;border-radius:4px;padding:0.4em;"
    "font-family:ui-monospace,monospace;font-size:0.8em;resize:vertical;"
    # Break lines anywhere, like a terminal.
    "word-break:break-all"
)

# The names of report lines take 11 columns.
_REPORT_LINE = (
    "padding-left:11ch;text-indent:-11ch;white-space:pre-wrap;overflow-wrap:anywhere;"
    "font-family:ui-monospace,monospace;font-size:0.9em"
)

# A name is cut in the middle; the whole one is its title, as far as that can be read.
_MAX_NAME_CHARACTERS, _MAX_TITLE_CHARACTERS = 90, 600


def name_html(name: str, *, is_broken: bool = False) -> str:
    """A name as text, isolated from the direction of writing around it. ``is_broken``: over lines
    where there is no room, after a slash or an underscore."""
    whole = printable(name)
    shown = whole
    if len(whole) > _MAX_NAME_CHARACTERS:
        half = _MAX_NAME_CHARACTERS // 2
        shown = f"{whole[: half - 1]}…{whole[-half:]}"
    title = html.escape(whole[:_MAX_TITLE_CHARACTERS])
    text = html.escape(shown)
    if is_broken:
        text = re.sub("([/_])", r"\1<wbr>", text)
    return f'<bdi title="{title}">{text}</bdi>'


def paragraph(text: str) -> str:
    """A paragraph in small type."""
    return (
        "<div style='padding:0.2em 0.8em;font-size:0.85em;overflow-wrap:anywhere'>"
        f"{html.escape(escape_undecodable(text))}</div>"
    )


def caption(text: str) -> str:
    """A line over a picture, as low as it can be: the picture gets the height."""
    return f'<div class="scanloom-caption">{html.escape(escape_undecodable(text))}</div>'


def text_box(text: str) -> str:
    """A read-only field to copy from; viser's own text fields are editable."""
    rows = min(2 + len(text) // 60, 8)
    return (
        f"<div style='padding:0.2em 0.5em'><textarea readonly spellcheck='false' rows='{rows}' "
        f"style='{_BOX}'>{html.escape(escape_undecodable(text))}</textarea></div>"
    )


def report_line(text: str) -> str:
    """A line of a report in a monospaced font; wrapped text is indented past the line's name."""
    return f"<div style='{_REPORT_LINE}'>{html.escape(text)}</div>"


def escape_markdown(text: str) -> str:
    """Markdown that shows ``text`` as it is, on one line. viser would run HTML in it."""
    return _PUNCTUATION.sub(r"\\\1", " ".join(text.split()))
