"""A bar above all steps while the recording is being aligned: what is shown meanwhile, how far the
alignment is and how long it still takes."""

import html

import viser

from scanloom.frame_view import FrameView, alignment_progress_text, failure_summary
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel

_BOX = "padding:0.3em 0.8em 0.5em;font-size:0.85em;overflow-wrap:anywhere"
# Grey on any ground: the page may be light or dark.
_TRACK = "height:6px;border-radius:3px;background:rgba(128,136,144,0.3);overflow:hidden"
_FILLED = "#1c7ed6"


class AlignmentBar(Panel):
    """Shows a bar during the alignment, and the reason where it has failed."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._bar = gui.add_html("")

    def show(self, frame_view: FrameView) -> None:
        """Update the bar; once the recording is aligned, nothing is displayed."""
        update_widget(self._bar, content=_content(frame_view))

    def show_progress(self, frame_view: FrameView) -> None:
        """Update the bar."""
        self.show(frame_view)


def shown_meanwhile_text(frame_view: FrameView) -> str:
    """What the picture is worth without an alignment; empty where there is no such picture."""
    if frame_view.raw is None:
        return ""
    if frame_view.raw.is_mount_recorded:
        return "Shown as recorded, with the mount that the recording names."
    return (
        "Shown as recorded. How the camera is mounted is not known yet: it is drawn level, at the "
        "LiDAR and looking straight ahead."
    )


def _content(frame_view: FrameView) -> str:
    if frame_view.chain is not None:
        return "<div data-alignment='done'></div>"
    if not frame_view.open_recording.can_be_fused:
        # The verdict says why.
        return "<div data-alignment='none'></div>"
    if not frame_view.is_being_aligned:
        reason = "" if frame_view.failure is None else failure_summary(frame_view.failure)
        return (
            f"<div data-alignment='failed' style='{_BOX}'>"
            f"<b>Not aligned.</b> {html.escape(reason)} "
            f"{html.escape(shown_meanwhile_text(frame_view))}</div>"
        )
    progress = frame_view.open_recording.progress
    percent = 100.0 * progress.fraction
    return (
        f"<div data-alignment='running' style='{_BOX}'>"
        f"<div>{html.escape(alignment_progress_text(frame_view.open_recording))}</div>"
        f"<div role='progressbar' aria-valuemin='0' aria-valuemax='100' "
        f"aria-valuenow='{percent:.0f}' style='{_TRACK};margin:0.3em 0'>"
        f"<div style='width:{percent:.0f}%;height:100%;background:{_FILLED}'></div></div>"
        f"<div style='opacity:0.75'>{html.escape(shown_meanwhile_text(frame_view))}</div></div>"
    )
