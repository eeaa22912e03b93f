"""The top of the page: recording, preset and differences from it, undo, link."""

import html
from typing import get_args

import viser

from fusion_core.workflows.fuse.settings import PresetName
from scanloom.client_session import ClientSession, Panel
from scanloom.frame_view import FrameView
from scanloom.panels.widgets.controls import Controls, update_widget
from scanloom.panels.widgets.help import keys_text
from scanloom.state.view import View

_MAX_DIFFERENCES = 6


class HeaderPanel(Panel):
    """Preset, reset, undo, redo and link."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._gui, self._session = gui, session
        self._title = gui.add_html("")
        presets = get_args(PresetName)
        preset = gui.add_dropdown(
            "Preset",
            presets,
            initial_value=session.view.preset,
            hint="ScanLoom's own settings, or those of Xu 2024",
        )
        self._differs = gui.add_html("")
        buttons = gui.add_button_group("Settings", ("Undo", "Redo", "Reset", "Link", "Keys"))

        self._controls = Controls(gui, session)
        self._controls.bind(preset, lambda view: view.preset, session.apply_preset)

        @buttons.on_click
        def _(_: viser.GuiEvent[viser.GuiButtonGroupHandle]) -> None:
            match buttons.value:
                case "Undo":
                    session.undo()
                case "Redo":
                    session.redo()
                case "Reset":
                    session.apply_preset(session.view.preset)
                case "Link":
                    self._show_link()
                case "Keys":
                    self._show_dialogue("Keys", keys_text())

    def show(self, frame_view: FrameView) -> None:
        """Set title, preset and differences."""
        view = frame_view.view
        self._controls.show(view)
        update_widget(self._title, content=_title(view))
        update_widget(self._differs, content=_differences(view))

    def _show_link(self) -> None:
        link = f"/go?view={self._session.view.to_link()}"
        text = "Add this to the server's address. It restores recording, time, settings and panel."
        self._show_dialogue("A link to this view", text, link=link)

    def _show_dialogue(self, title: str, text: str, *, link: str | None = None) -> None:
        """Open a modal dialogue with a text, and a link to copy."""
        gui = self._gui
        with gui.add_modal(title) as modal:
            gui.add_markdown(text)
            if link is not None:
                gui.add_text("Link", link, multiline=True)
            close = gui.add_button("Close")
        close.on_click(lambda _: modal.close())


def _title(view: View) -> str:
    virtual = "" if view.virtual_row is None else f" · virtual LiDAR from row {view.virtual_row}"
    name = html.escape(view.recording)
    return (
        '<div style="padding:0.2em 0.5em"><b>ScanLoom</b> '
        f'<span style="opacity:0.75">{name}{virtual}</span></div>'
    )


def _differences(view: View) -> str:
    """The settings that differ from the preset, in one line."""
    changed = [
        f"{stage}.{name} = {value}" if stage else f"{name} = {value}"
        for stage, values in view.preset_overrides().items()
        for name, value in values.items()
    ]
    text = f"settings of the preset {view.preset}"
    if changed:
        more = len(changed) - _MAX_DIFFERENCES
        tail = f" and {more} more" if more > 0 else ""
        text = "differs: " + ", ".join(changed[:_MAX_DIFFERENCES]) + tail
    return f'<div style="padding:0 0.5em;font-size:0.85em;opacity:0.75">{html.escape(text)}</div>'
