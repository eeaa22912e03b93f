"""The widgets of the open dialog."""

from collections.abc import Callable

import viser

from scanloom.page.update_widget import update_widget
from scanloom.panels.opening_html import upload_html
from scanloom.state.folder_listing import FolderPlace


class OpeningWindow:
    """A modal with what the dialog shows; ``on_find`` is called with the text looked for."""

    def __init__(
        self, gui: viser.GuiApi, upload_limit_bytes: int, on_find: Callable[[str], None]
    ) -> None:
        self._modal = gui.add_modal("Open a recording")
        with self._modal:
            self._status = gui.add_html("")
            self._top = gui.add_html("")
            self._find = gui.add_text("Find", "", hint="Only names with this text in them")
            self._rows = gui.add_html("")
            gui.add_html(upload_html(upload_limit_bytes))

        @self._find.on_update
        def _(event: viser.GuiEvent[viser.GuiTextHandle]) -> None:
            if event.client is not None:
                on_find(self._find.value)

    def set_find(self, place: FolderPlace | None) -> None:
        """Show the text that is looked for in a folder."""
        update_widget(self._find, visible=place is not None)
        update_widget(self._find, value="" if place is None else place.find)

    def show(self, *, status: str, top: str, rows: str) -> None:
        """Show these parts."""
        update_widget(self._status, content=status)
        update_widget(self._top, content=top)
        update_widget(self._rows, content=rows)

    def close(self) -> None:
        """Close it for good."""
        self._modal.close()
