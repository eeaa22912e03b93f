"""The help texts of the panels, each with its formula, and of the keys."""

from functools import cache

from scanloom.resources import static_path
from scanloom.state.view import PanelName


@cache
def help_text(panel: PanelName) -> str:
    """Markdown for ``gui.add_markdown``. Its formula, if any, is an SVG in the text's colour."""
    name = panel.lower()
    text = _read(f"help/{name}.md")
    link = f"![Formula]({name}.svg)"
    return text.replace(link, _read(f"help/{name}.svg").strip()) if link in text else text


def keys_text() -> str:
    """The table of the keys, as Markdown."""
    return _read("help/keys.md")


def _read(name: str) -> str:
    return static_path(name).read_text(encoding="utf-8")
