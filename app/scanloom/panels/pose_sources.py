"""Where a pose of the camera can come from, as buttons: the way back after an adjustment."""

import html
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import viser

from fusion_core.model.errors import SettingsError
from fusion_core.model.names import printable
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.bridge import PageBridge, press_attributes
from scanloom.page.update_widget import update_widget
from scanloom.state.calibration_view import pose_of
from scanloom.state.hand_pose import HandPose

_PRESS = "pose source"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Source:
    """``extrinsics``: the view's, with which the pose is this source's."""

    label: str
    help: str
    extrinsics: HandPose | str | None


class PoseSources:
    """Buttons for the poses that there are, the one in use pressed."""

    def __init__(self, gui: viser.GuiApi, bridge: PageBridge, session: ClientSession) -> None:
        self._session = session
        self._sources: dict[str, _Source] = {}
        self._html = gui.add_html("")
        bridge.on_press(_PRESS, self._take)

    def show(self, frame_view: FrameView) -> None:
        """Offer what this recording has."""
        self._sources = _sources_of(frame_view, self._session.library.given_file)
        update_widget(self._html, content=_html(self._sources, frame_view.view.extrinsics))

    def _take(self, name: str) -> None:
        # A browser may send any value.
        source = self._sources.get(name)
        if source is not None:
            self._session.change(extrinsics=source.extrinsics)


def _sources_of(frame_view: FrameView, file: Path | None) -> dict[str, _Source]:
    found: dict[str, _Source] = {}
    opened, name = frame_view.open_recording, frame_view.view.recording
    is_given = opened.can_be_fused and opened.fuse_session.rig.given is not None
    has_file = file is not None and (is_given or frame_view.view.extrinsics == "recording")
    if has_file and file is not None:
        found["file"] = _Source(
            label=f"From {printable(file.name)}",
            help=f"The file that the workbench was started with, for {printable(name)}",
            extrinsics=None,
        )
    found["estimated"] = _Source(
        label="Estimated",
        help="Found from the recording's own scans and images",
        extrinsics="recording" if has_file else None,
    )
    base = opened.chain
    recorded = None if base is None else base.session.rig.recorded_mount
    if base is not None and recorded is not None:
        # Where it cannot be set by hand, it is not offered.
        with suppress(SettingsError):
            found["recorded"] = _Source(
                label="Recorded",
                help="By the recording's own transforms (tf_static), as they are",
                extrinsics=pose_of(base, recorded),
            )
    return found


def _html(sources: dict[str, _Source], extrinsics: HandPose | str | None) -> str:
    buttons = "".join(
        f'<button {press_attributes(_PRESS, name)} title="{html.escape(source.help)}" '
        f'aria-pressed="{str(source.extrinsics == extrinsics).lower()}">'
        f"<bdi>{html.escape(source.label)}</bdi></button>"
        for name, source in sources.items()
    )
    return (
        '<div class="scanloom-row" role="group" aria-label="Reset the pose"><span>Reset</span>'
        f"{buttons}</div>"
    )
