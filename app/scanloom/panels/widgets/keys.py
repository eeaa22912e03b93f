"""A key of the page: an action with a name, which stands in the list of commands, too."""

from collections.abc import Callable

import viser


def add_key(
    gui: viser.GuiApi, label: str, key: str, action: Callable[[], None], modifier: str | None = None
) -> None:
    """Call ``action`` when a key is pressed, or the command of this label is chosen. ``key`` and
    ``modifier`` are of viser's lists."""
    command = gui.add_command(label, hotkey=key, modifier=modifier)  # type: ignore[arg-type]  # lists of literals
    command.on_trigger(lambda _: action())
