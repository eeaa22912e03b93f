"""The help of the panels and the keys, in plain words, each panel's with its formula."""

from scanloom.resources import static_path
from scanloom.state.view import PanelName


def help_text(panel: PanelName) -> str:
    """Markdown for ``gui.add_markdown``. The formula in it is an SVG in the colour of the text."""
    name = panel.lower()
    formula = _read(f"help/{name}.svg").strip()
    return _read(f"help/{name}.md").replace(f"![Formula]({name}.svg)", formula)


def keys_text() -> str:
    """The table of the keys, as markdown."""
    return _read("help/keys.md")


def _read(name: str) -> str:
    return static_path(name).read_text(encoding="utf-8")
