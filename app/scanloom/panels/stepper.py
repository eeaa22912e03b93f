"""The steps of the work, one of them open, and what the open one has found in a sentence."""

import html
from collections.abc import Mapping

import viser

from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.bridge import PageBridge, press_attributes
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.verdict_html import verdict_html
from scanloom.panels.widgets.help import help_text
from scanloom.scene.verdict import verdict_of
from scanloom.state.possible_steps import reasons_by_step
from scanloom.state.view import PANELS, PanelName


class StepperPanel(Panel):
    """Buttons of the steps, the verdict, and one step's folder at a time.

    A step that has nothing to work on in this recording is grey. It opens all the same: the verdict
    is then the reason, and there is no folder.

    Not viser's tabs: the server can neither open them nor read which is open.
    """

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._gui = gui
        self._open = session.view.panel
        self._folders: dict[PanelName, viser.GuiFolderHandle] = {}
        self._helps: dict[PanelName, viser.GuiMarkdownHandle] = {}
        self._steps = gui.add_html(_steps_html(self._open, {}))
        self._verdict = gui.add_html("")

        def open_step(name: str) -> None:
            if name in PANELS:
                session.change(panel=name)

        bridge.on_press("step", open_step)

    def folder(self, name: PanelName) -> viser.GuiFolderHandle:
        """Add a step's folder, without a frame of its own."""
        folder = self._gui.add_folder(None, visible=name == self._open)
        self._folders[name] = folder
        return folder

    def add_help(self, name: PanelName) -> None:
        """Add the help of a step at the end of its folder. It is sent when the step is shown first:
        browsers take long to set its text and formula, and a person waits for the first frame."""
        with self._folders[name], self._gui.add_folder("About this step", expand_by_default=False):
            self._helps[name] = self._gui.add_markdown("")

    def show(self, frame_view: FrameView) -> None:
        """Mark the view's step, say what it has found, and show its folder alone."""
        opened, reasons = frame_view.view.panel, reasons_by_step(frame_view.open_recording)
        update_widget(self._steps, content=_steps_html(opened, reasons))
        update_widget(self._verdict, content=verdict_html(verdict_of(frame_view)))
        if opened in self._helps:
            update_widget(self._helps[opened], content=help_text(opened))
        for name, folder in self._folders.items():
            update_widget(folder, visible=name == opened and name not in reasons)


def _steps_html(opened: PanelName, reasons: Mapping[PanelName, str]) -> str:
    buttons = []
    for number, name in enumerate(PANELS, start=1):
        state = ' aria-current="step"' if name == opened else ""
        hint = f"Alt + {number}"
        if name in reasons:
            state += ' aria-disabled="true"'
            hint = f"{reasons[name]} ({hint})"
        buttons.append(
            f'<button {press_attributes("step", name)}{state} aria-label="{name}" '
            f'title="{html.escape(hint)}">'
            f"<span>{number}</span>{html.escape(name)}</button>"
        )
    return f'<nav class="scanloom-steps" aria-label="Steps">{"".join(buttons)}</nav>'
