"""The Recording panel: which recording, its streams, its pairs in time, and the clock offset."""

import html

import viser

from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.workflows.info import describe
from fusion_core.workflows.stream_gaps import stream_gaps
from scanloom.client_session import Desk
from scanloom.frame_view import Shown, aligning_words
from scanloom.panels.controls import Controls, put
from scanloom.panels.depth_cameras import DepthCameras
from scanloom.panels.pairing_plot import PairingPlot
from scanloom.panels.stream_table import stream_table

_NOT_NAMED = "found by type"
_NO_ROW = -1
_CLOCK = MOUNT_PARAMETERS.index("clock_offset_ms")


class RecordingPanel:
    """Chooses the recording and its streams, and shows what they are."""

    def __init__(self, gui: viser.GuiApi, desk: Desk) -> None:
        self._desk = desk
        # The recording and how many of its warnings are listed: reading on may find more.
        self._listed: tuple[object, int] = None, 0
        self._names = tuple(desk.library.names())
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
            self._cameras = DepthCameras(gui, desk)
        with gui.add_folder("Clocks"):
            self._clock = gui.add_markdown("")
            self._apply = gui.add_checkbox("Apply the clock offset", desk.view.apply_clock_offset)
            self._pairing = PairingPlot(gui)
        with gui.add_folder("Alignment"):
            self._aligned = gui.add_markdown("")
            again = gui.add_button("Align again with these settings")
        self._controls = Controls(gui, desk)
        self._controls.bind(self._apply, "apply_clock_offset", bool)
        self._controls.tie(self._name, lambda view: view.recording, self._open)
        self._controls.bind(
            self._lidar,
            "lidar_topic",
            lambda topic: None if topic == _NOT_NAMED else topic,
            lambda topic: topic or _NOT_NAMED,
        )
        self._controls.bind(
            virtual,
            "virtual_row",
            lambda row: None if row < 0 else int(row),
            lambda row: _NO_ROW if row is None else row,
        )
        again.on_click(lambda _: desk.align_again())

    def show(self, shown: Shown) -> None:
        """Streams once for each recording; progress and clock as they come."""
        view = shown.view
        self._offer(shown)
        self._controls.show(view)
        self._cameras.show(shown)
        self._show_progress(shown)
        if view.panel == "Recording":
            self._show_streams(shown)
            self._pairing.show(shown)
        chain = shown.chain
        sd_ms = None if chain is None else chain.alignment.mount.sd[_CLOCK]
        put(self._clock, content="" if chain is None else _clock_words(chain.alignment.mount))
        # What was applied can be taken back in any case.
        put(self._apply, disabled=sd_ms is None and not view.apply_clock_offset)
        aligned = ""
        if chain is not None:
            changed = " Settings changed since." if view.needs_alignment() else ""
            aligned = f"{chain.alignment.frames} frames made the recording's field.{changed}"
        put(self._aligned, content=aligned)

    def _open(self, name: str) -> None:
        self._desk.change(
            recording=name,
            number=0,
            picked=None,
            lidar_topic=None,
            depth_topics=(),
            virtual_row=None,
            beam=None,
        )

    def _offer(self, shown: Shown) -> None:
        """What there is to choose from. A link may name a recording in an inner folder."""
        name = shown.view.recording
        put(self._name, options=self._names if name in self._names else (*self._names, name))
        topics = shown.opened.session.recording.topics
        lidars = [topic.name for topic in topics if topic.role == "lidar"]
        put(self._lidar, options=(_NOT_NAMED, *lidars))

    def _show_streams(self, shown: Shown) -> None:
        recording = shown.opened.session.recording
        listed = recording, len(recording.warnings)
        if self._listed != listed:
            self._listed = listed
            put(self._streams, content=stream_table(describe(recording), stream_gaps(recording)))

    def _show_progress(self, shown: Shown) -> None:
        opened = shown.opened
        waiting = opened.chain is None and opened.failure is None
        put(self._progress, visible=waiting)
        put(self._progress_text, visible=waiting)
        if not waiting:
            return
        step = opened.progress
        share = 100.0 * step.done / step.total if step.total else 0.0
        put(self._progress, value=min(share, 100.0))
        said = aligning_words(opened)
        put(self._progress_text, content=f'<div style="padding:0 0.5em">{html.escape(said)}</div>')


def _clock_words(mount: Mount) -> str:
    offset = "not observable in this recording"
    sd_ms = mount.sd[_CLOCK]
    if sd_ms is not None:
        low_ms, high_ms = mount.clock_offset_ms - 2.0 * sd_ms, mount.clock_offset_ms + 2.0 * sd_ms
        offset = f"**{mount.clock_offset_ms:.1f} ms**, 95 % in [{low_ms:.1f}, {high_ms:.1f}] ms"
    return f"Camera stamp − LiDAR stamp of one instant: {offset}.".replace("-", "−")
