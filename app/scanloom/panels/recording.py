"""The Recording panel: recording, streams, pairing in time, and clock offset."""

import html

import viser

from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.workflows.info import describe_recording
from fusion_core.workflows.stream_gaps import stream_gaps
from scanloom.client_session import ClientSession, Panel
from scanloom.frame_view import FrameView, alignment_progress_text
from scanloom.panels.depth_cameras import DepthCameras
from scanloom.panels.pairing_plot import PairingPlot
from scanloom.panels.stream_table import stream_table
from scanloom.panels.widgets.controls import Controls, update_widget

_PAIR_BY = ("nearest", "interpolated", "rates")
_NOT_NAMED = "found by type"
_NO_ROW = -1
_CLOCK = MOUNT_PARAMETERS.index("clock_offset_ms")


class RecordingPanel(Panel):
    """Choice of the recording and its streams, and their properties."""

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._session = session
        self._controls = Controls(gui, session)
        # The listed recording and its number of warnings: further reading may find more.
        self._listed: tuple[object, int] = None, 0
        self._names = tuple(session.recording_names())
        self._name = gui.add_dropdown("Recording", self._names, initial_value=self._names[0])
        self._progress_text = gui.add_html("", visible=False)
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._streams = gui.add_html("")
        with gui.add_folder("Streams to use", expand_by_default=False):
            self._lidar = gui.add_dropdown("LiDAR", (_NOT_NAMED,))
            virtual = gui.add_number(
                "Virtual LiDAR, row",
                _NO_ROW,
                min=_NO_ROW,
                step=1,
                hint="A row of the depth image; -1: none",
            )
            self._cameras = DepthCameras(gui, session)
        with gui.add_folder("Clocks"):
            self._clock = gui.add_markdown("")
            self._apply = gui.add_checkbox(
                "Apply the clock offset", session.view.apply_clock_offset
            )
            self._pairing = PairingPlot(gui)
        with gui.add_folder("Alignment"):
            self._aligned = gui.add_markdown("")
            self._controls.dropdown("time", "pair_by", "Scan of a depth image", _PAIR_BY)
            again = gui.add_button("Align again with these settings")
        self._controls.bind_field(self._apply, "apply_clock_offset", bool)
        self._controls.bind(self._name, lambda view: view.recording, self._open)
        self._controls.bind_field(
            self._lidar,
            "lidar_topic",
            lambda topic: None if topic == _NOT_NAMED else topic,
            lambda topic: topic or _NOT_NAMED,
        )
        self._controls.bind_field(
            virtual,
            "virtual_row",
            lambda row: None if row < 0 else int(row),
            lambda row: _NO_ROW if row is None else row,
        )
        again.on_click(lambda _: session.align_again())

    def show(self, frame_view: FrameView) -> None:
        """Display the streams of a new recording, and the progress and clock offset."""
        view = frame_view.view
        self._offer(frame_view)
        self._controls.show(view)
        self._cameras.show(frame_view)
        self._show_progress(frame_view)
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

    def _open(self, name: str) -> None:
        self._session.change(
            recording=name,
            frame_index=0,
            picked_offset=None,
            lidar_topic=None,
            depth_topics=(),
            virtual_row=None,
            selected_beam=None,
        )

    def _offer(self, frame_view: FrameView) -> None:
        """Update the list of recordings. A link may name one in a subfolder."""
        name = frame_view.view.recording
        update_widget(
            self._name, options=self._names if name in self._names else (*self._names, name)
        )
        topics = frame_view.open_recording.fuse_session.recording.topics
        lidars = [topic.name for topic in topics if topic.role == "lidar"]
        update_widget(self._lidar, options=(_NOT_NAMED, *lidars))

    def _show_streams(self, frame_view: FrameView) -> None:
        recording = frame_view.open_recording.fuse_session.recording
        listed = recording, len(recording.warnings)
        if self._listed != listed:
            self._listed = listed
            update_widget(
                self._streams,
                content=stream_table(describe_recording(recording), stream_gaps(recording)),
            )

    def _show_progress(self, frame_view: FrameView) -> None:
        open_recording = frame_view.open_recording
        waiting = open_recording.chain is None and open_recording.failure is None
        update_widget(self._progress, visible=waiting)
        update_widget(self._progress_text, visible=waiting)
        if not waiting:
            return
        step = open_recording.progress
        percent = 100.0 * step.done / step.total if step.total else 0.0
        update_widget(self._progress, value=min(percent, 100.0))
        text = alignment_progress_text(open_recording)
        update_widget(
            self._progress_text, content=f'<div style="padding:0 0.5em">{html.escape(text)}</div>'
        )


def _clock_offset_text(mount: Mount) -> str:
    offset = "not observable in this recording"
    sd_ms = mount.sd[_CLOCK]
    if sd_ms is not None:
        low_ms, high_ms = mount.clock_offset_ms - 2.0 * sd_ms, mount.clock_offset_ms + 2.0 * sd_ms
        offset = f"**{mount.clock_offset_ms:.1f} ms**, 95 % in [{low_ms:.1f}, {high_ms:.1f}] ms"
    return f"Camera stamp − LiDAR stamp of the same instant: {offset}.".replace("-", "−")
