"""The Recording panel: streams, pairing in time, and clock offset."""

import viser

from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.workflows.info import describe_recording
from fusion_core.workflows.stream_gaps import stream_gaps
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.page.update_widget import update_widget
from scanloom.page_parts import Panel
from scanloom.panels.depth_cameras import DepthCameras
from scanloom.panels.pairing_plot import PairingPlot
from scanloom.panels.stream_table import stream_table
from scanloom.panels.widgets.controls import Controls

_PAIR_BY = ("nearest", "interpolated", "rates")
_NOT_NAMED = "found by type"
_CUT, _UNCUT = "Cut a LiDAR from the depth image", "Show the depth images alone"
_CLOCK = MOUNT_PARAMETERS.index("clock_offset_ms")


class RecordingPanel(Panel):
    """Choice of the recording's streams, and their properties."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        self._controls = Controls(gui, session)
        # The listed recording and its number of warnings: further reading may find more.
        self._listed: tuple[object, int] = None, 0
        self._streams = gui.add_html("")
        self._cut = gui.add_button(
            _CUT,
            visible=False,
            hint="Takes one row of each depth image for the scan of a LiDAR, to try all steps "
            "without one",
        )
        with gui.add_folder("Streams to use", expand_by_default=False):
            self._lidar = gui.add_dropdown("LiDAR", (_NOT_NAMED,), hint="The topic of its scans")
            self._virtual = self._controls.optional_number(
                "Virtual LiDAR, row",
                "virtual_row",
                hint="A row of the depth image, from the top, taken for the scan of a LiDAR; "
                "empty: none",
            )
            self._cameras = DepthCameras(gui, session)
        self._clocks = gui.add_folder("Clocks", expand_by_default=False)
        with self._clocks:
            self._clock = gui.add_markdown("")
            self._apply = gui.add_checkbox(
                "Apply the clock offset",
                session.view.apply_clock_offset,
                hint="Subtracts the estimated delay of the camera, in ms, from its stamps",
            )
            self._pairing = PairingPlot(gui)
        self._alignment = gui.add_folder("Alignment")
        with self._alignment:
            self._aligned = gui.add_markdown("")
            self._controls.dropdown("time", "pair_by", "Scan of a depth image", _PAIR_BY)
            again = gui.add_button(
                "Align again with these settings",
                hint="Finds the offset and the mount again, over the whole recording",
            )
        self._controls.bind_field(self._apply, "apply_clock_offset", bool)
        self._controls.bind_field(
            self._lidar,
            "lidar_topic",
            lambda topic: None if topic == _NOT_NAMED else topic,
            lambda topic: topic or _NOT_NAMED,
        )
        again.on_click(lambda _: session.align_again())
        self._cut.on_click(lambda _: self._cut_lidar())

    def show(self, frame_view: FrameView) -> None:
        """Display the streams of a new recording, and the clock offset."""
        view = frame_view.view
        self._offer(frame_view)
        self._controls.show(view)
        self._cameras.show(frame_view)
        if view.panel == "Recording":
            self._show_streams(frame_view)
            self._pairing.show(frame_view)
        chain = frame_view.chain
        sd_ms = None if chain is None else chain.alignment.mount.sd[_CLOCK]
        update_widget(
            self._clock, content="" if chain is None else _clock_offset_text(chain.alignment.mount)
        )
        # An applied offset can always be removed.
        update_widget(self._apply, disabled=sd_ms is None and not view.apply_clock_offset)
        aligned = ""
        if chain is not None:
            changed = " Settings changed since." if view.needs_alignment() else ""
            aligned = (
                f"{chain.alignment.frames} frames are averaged in the recording's field.{changed}"
            )
        update_widget(self._aligned, content=aligned)

    def _cut_lidar(self) -> None:
        """Take the middle row of the displayed depth image for the scan of a LiDAR, or no more."""
        if self._session.view.virtual_row is not None:
            self._session.change(virtual_row=None, frame_index=0)
            return
        raw = None if self._session.frame_view is None else self._session.frame_view.raw
        if raw is not None:
            row = raw.paired.image.depth_m.shape[0] // 2
            self._session.change(virtual_row=row, frame_index=0)

    def _offer(self, frame_view: FrameView) -> None:
        """Update what can be chosen in this recording."""
        opened = frame_view.open_recording.opened
        lidars = [topic.name for topic in opened.recording.topics if topic.role == "lidar"]
        update_widget(self._lidar, options=(_NOT_NAMED, *lidars), disabled=not lidars)
        update_widget(self._virtual, disabled=opened.session is None)
        # Without intrinsics a row has no azimuths.
        is_calibrated = opened.session is not None and opened.session.rig.cameras[0].calibrated
        can_cut = is_calibrated and opened.streams.lidar is None
        is_cut = frame_view.view.virtual_row is not None
        update_widget(self._cut, visible=can_cut, label=_UNCUT if is_cut else _CUT)
        for folder in (self._clocks, self._alignment):
            update_widget(folder, visible=frame_view.open_recording.can_be_fused)

    def _show_streams(self, frame_view: FrameView) -> None:
        opened = frame_view.open_recording.opened
        listed = opened, len(opened.recording.warnings)
        if self._listed != listed:
            self._listed = listed
            described = describe_recording(opened.recording)
            if opened.why_not_fused:
                # The description rests on the topics alone; a sensor may be unreadable.
                described["can"] = [opened.why_not_fused, *opened.streams.notes]
            gaps = stream_gaps(opened.recording)
            update_widget(self._streams, content=stream_table(described, gaps))


def _clock_offset_text(mount: Mount) -> str:
    offset = "not observable in this recording"
    sd_ms = mount.sd[_CLOCK]
    if sd_ms is not None:
        low_ms, high_ms = mount.clock_offset_ms - 2.0 * sd_ms, mount.clock_offset_ms + 2.0 * sd_ms
        offset = f"**{mount.clock_offset_ms:.1f} ms**, 95 % in [{low_ms:.1f}, {high_ms:.1f}] ms"
    return f"Camera stamp − LiDAR stamp of the same instant: {offset}.".replace("-", "−")
