"""The tools at the top of the page, and the preset with what differs from it."""

import html
from typing import get_args

import viser

from fusion_core.model.names import printable
from fusion_core.workflows.fuse.settings import PresetName
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.bridge import PageBridge, press_attributes
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.widgets.controls import Controls
from scanloom.panels.widgets.help import keys_text
from scanloom.state.hand_pose import HandPose
from scanloom.state.view import View

_MAX_DIFFERENCES = 6


class HeaderPanel(Panel):
    """Recording's name, undo, redo, link, keys, colours and projector mode, in one row."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._gui, self._session = gui, session
        self._tools = gui.add_html("")
        self._differs = gui.add_html("")
        # Apart: it changes with each frame, and a button that is replaced misses its click.
        self._link = gui.add_html("")
        self._size = gui.add_html("")
        # None before the first view.
        self._is_dark: bool | None = None
        bridge.on_press("undo", lambda _: session.undo())
        bridge.on_press("redo", lambda _: session.redo())
        bridge.on_press("keys", lambda _: self._show_keys())
        bridge.on_press("colours", lambda _: self._switch_colours())
        bridge.on_press("projector", lambda _: self._switch_size())
        for label, key, action in (
            ("Large letters, for a projector", "P", self._switch_size),
            ("Light or dark", "L", self._switch_colours),
            ("Keys", "H", self._show_keys),
        ):
            bridge.add_key(label, key, action)

    def show(self, frame_view: FrameView) -> None:
        """Set the row of tools, and the page's colours and size."""
        view = frame_view.view
        update_widget(self._tools, content=_tools_html(view, is_dark=frame_view.is_dark))
        update_widget(self._differs, content=_differences(view))
        update_widget(self._link, content=_link_html(view))
        # The page's style sheet takes it for a sign.
        large = '<div class="scanloom-large"></div>' if view.large_text else ""
        update_widget(self._size, content=large)
        if frame_view.is_dark != self._is_dark:
            self._is_dark = frame_view.is_dark
            self._gui.configure_theme(
                control_width="large",
                show_logo=False,
                show_share_button=False,
                dark_mode=frame_view.is_dark,
            )

    def _switch_colours(self) -> None:
        self._session.change(color_scheme="light" if self._is_dark else "dark")

    def _switch_size(self) -> None:
        self._session.change(large_text=not self._session.view.large_text)

    def _show_keys(self) -> None:
        with self._gui.add_modal("Keys") as modal:
            self._gui.add_markdown(keys_text())
            close = self._gui.add_button("Close")
        close.on_click(lambda _: modal.close())


class PresetPanel(Panel):
    """The preset of the settings."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        preset = gui.add_dropdown(
            "Preset",
            get_args(PresetName),
            initial_value=session.view.preset,
            hint="ScanLoom's own settings, or those of Xu 2024",
        )
        reset = gui.add_button("Reset to this preset")
        reset.on_click(lambda _: session.apply_preset(session.view.preset))
        self._controls = Controls(gui, session)
        self._controls.bind(preset, lambda view: view.preset, session.apply_preset)

    def show(self, frame_view: FrameView) -> None:
        """Set the preset."""
        self._controls.show(frame_view.view)


def _tools_html(view: View, *, is_dark: bool) -> str:
    virtual = "" if view.virtual_row is None else f" · virtual LiDAR from row {view.virtual_row}"
    name = html.escape(printable(f"{view.recording}{virtual}"))
    tools = [
        _tool("undo", "↶", f"Undo {_undone(view)} (Ctrl + Z)"),
        _tool("redo", "↷", "Redo it (Ctrl + Shift + Z)"),
        _tool("link", "Link", "Copy a link to this view, with frame, step and settings"),
        _tool("colours", "☀" if is_dark else "☾", "Light or dark (L)"),
        _tool("projector", "A−" if view.large_text else "A+", "Large, for a projector (P)"),
        _tool("keys", "?", "Keys (H)"),
    ]
    opening = _tool("open", "Open…", "Open another recording (O)")
    label = f'<span title="{name}"><bdi>{name}</bdi></span>'
    return f'<div class="scanloom-tools">{opening}{label}{"".join(tools)}</div>'


def _undone(view: View) -> str:
    """What undo takes back in the view's step."""
    if view.panel == "Review":
        return "your last label"
    return "the last change of settings, frame, step or recording"


def _link_html(view: View) -> str:
    return f'<div data-view-link="{html.escape(f"/go?view={view.to_link()}")}"></div>'


def _tool(name: str, text: str, meaning: str) -> str:
    label = html.escape(meaning)
    return (
        f'<button {press_attributes(name)} title="{label}" aria-label="{label}">'
        f"{html.escape(text)}</button>"
    )


def _differences(view: View) -> str:
    """The settings that differ from the default ones, and a pose by hand, in a line each; nothing
    where none do."""
    changed = [
        f"{stage}.{name} = {value}" if stage else f"{name} = {value}"
        for stage, values in view.preset_overrides().items()
        for name, value in values.items()
    ]
    pose = view.hand_pose
    by_hand = "" if pose is None else f'<div class="scanloom-differs">{_pose_text(pose)}</div>'
    if not changed and view.preset == "default":
        return by_hand
    more = len(changed) - _MAX_DIFFERENCES
    tail = f" and {more} more" if more > 0 else ""
    differs = ", ".join(changed[:_MAX_DIFFERENCES]) + tail
    text = f"Settings: {view.preset}" + (f", with {differs}" if changed else "")
    return f'<div class="scanloom-differs">{html.escape(text)}</div>{by_hand}'


def _pose_text(pose: HandPose) -> str:
    """A pose that all steps use instead of the recording's own."""
    # Without the sign of a value that is zero in so many digits.
    return (
        f"Camera set by hand: yaw {pose.yaw_deg:z.2f}°, pitch {pose.pitch_deg:z.2f}°, roll "
        f"{pose.roll_deg:z.2f}°; {pose.forward_m:z.3f} m ahead, {pose.left_m:z.3f} m left, "
        f"{pose.up_m:z.3f} m up"
    ).replace("-", "−")
