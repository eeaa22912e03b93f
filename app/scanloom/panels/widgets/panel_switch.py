"""Buttons that switch between the panels."""

import viser

from scanloom.client_session import ClientSession, Panel
from scanloom.frame_view import FrameView
from scanloom.panels.widgets.controls import update_widget
from scanloom.panels.widgets.help import help_text
from scanloom.state.view import PANELS, PanelName


class PanelSwitch(Panel):
    """Shows one panel's folder at a time.

    Not viser's tabs: the server can neither open them nor read which is open.
    """

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._gui = gui
        self._open = session.view.panel
        self._folders: dict[PanelName, viser.GuiFolderHandle] = {}
        buttons = gui.add_button_group("Panel", PANELS)

        @buttons.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            session.change(panel=buttons.value)

    def folder(self, name: PanelName) -> viser.GuiFolderHandle:
        """Add a panel's folder, with its help at the top."""
        folder = self._gui.add_folder(name, visible=name == self._open)
        self._folders[name] = folder
        with folder, self._gui.add_folder("About this panel", expand_by_default=False):
            self._gui.add_markdown(help_text(name))
        return folder

    def show(self, frame_view: FrameView) -> None:
        """Show the view's panel and hide the others."""
        for name, folder in self._folders.items():
            update_widget(folder, visible=name == frame_view.view.panel)
