"""The list of earlier results of a recording, of which one may be opened."""

import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import viser

from fusion_core.model.names import printable
from scanloom.page.update_widget import update_widget

_NONE = "none chosen"


class EarlierRunsChoice:
    """A dropdown of saved results; ``open_folder`` is called in viser's threads with the folder
    that a person has chosen. Hidden while there is none."""

    def __init__(self, gui: viser.GuiApi, open_folder: Callable[[Path], None]) -> None:
        self._lock = threading.RLock()
        self._folders: dict[str, Path] = {}
        self._choice = gui.add_dropdown(
            "Earlier results",
            (_NONE,),
            visible=False,
            hint="Runs of this recording that were saved to the output folder: choose one to see "
            "it again",
        )

        @self._choice.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            # Without a client it was ``offer`` that set the value.
            if event.client is None:
                return
            with self._lock:
                folder = self._folders.get(self._choice.value)
                update_widget(self._choice, value=_NONE)
            if folder is not None:
                open_folder(folder)

    def offer(self, folders: Sequence[Path], *, is_at_work: bool) -> None:
        """Offer these folders, by their names; nothing while a run works."""
        with self._lock:
            self._folders = {printable(folder.name): folder for folder in folders}
            update_widget(self._choice, options=(_NONE, *self._folders))
            update_widget(self._choice, visible=bool(folders), disabled=is_at_work)
