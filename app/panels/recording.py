"""The Recording panel: which recording, its streams, its pairs in time, and the clock offset."""

import html
from typing import Any

import viser

from app.desk import Desk
from app.panels.controls import Controls, put
from app.shown import Shown
from fusion_core.workflows.inspect import describe

_NOT_NAMED = "found by type"


class RecordingPanel:
    """Chooses the recording and its streams, and shows what they are."""

    def __init__(self, gui: viser.GuiApi, desk: Desk) -> None:
        self._desk = desk
        self._described = ""
        self._opened: object = None
        names = tuple(desk.library.names())
        self._name = gui.add_dropdown("Recording", names, initial_value=desk.view.recording)
        self._progress_text = gui.add_html("", visible=False)
        self._progress = gui.add_progress_bar(0.0, visible=False)
        self._streams = gui.add_html("")
        with gui.add_folder("Streams to use", expand_by_default=False):
            self._lidar = gui.add_dropdown("LiDAR", (_NOT_NAMED,))
            self._depth = gui.add_dropdown("Depth", (_NOT_NAMED,))
            self._virtual = gui.add_number(
                "Virtual LiDAR, row", -1, min=-1, step=1, hint="A row of the depth image; -1: none"
            )
        with gui.add_folder("Clocks"):
            self._clock = gui.add_markdown("")
            self._apply = gui.add_checkbox("Apply the clock offset", desk.view.apply_clock_offset)
        with gui.add_folder("Alignment"):
            self._aligned = gui.add_markdown("")
            again = gui.add_button("Align again with these settings")
        self._controls = Controls(gui, desk)
        self._controls.bind(self._apply, "apply_clock_offset", bool)
        again.on_click(lambda _: desk.align_again())

        @self._name.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                desk.change(
                    recording=self._name.value,
                    number=0,
                    picked=None,
                    lidar_topic=None,
                    depth_topics=(),
                    virtual_row=None,
                    beam=None,
                )

        @self._lidar.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                topic = self._lidar.value
                desk.change(lidar_topic=None if topic == _NOT_NAMED else topic)

        @self._depth.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                topic = self._depth.value
                desk.change(depth_topics=() if topic == _NOT_NAMED else (topic,), number=0)

        @self._virtual.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                row = int(self._virtual.value)
                desk.change(virtual_row=None if row < 0 else row)

    def show(self, shown: Shown) -> None:
        """Streams once for each recording; progress and clock as they come."""
        view = shown.view
        self._controls.show(view)
        put(self._name, value=view.recording)
        self._show_streams(shown)
        self._show_progress(shown)
        chain = shown.chain
        if chain is None:
            return
        mount = chain.alignment.mount
        sd_ms = mount.sd[-1]
        offset = "not observable in this recording"
        if sd_ms is not None:
            low, high = mount.clock_offset_ms - 2.0 * sd_ms, mount.clock_offset_ms + 2.0 * sd_ms
            offset = f"**{mount.clock_offset_ms:.1f} ms**, 95 % in [{low:.1f}, {high:.1f}] ms"
        put(self._clock, content=f"Camera stamp − LiDAR stamp of one instant: {offset}.")
        frames = f"{chain.alignment.frames} frames made the recording's field."
        changed = " Settings changed since." if view.needs_alignment() else ""
        put(self._aligned, content=frames + changed)

    def _show_streams(self, shown: Shown) -> None:
        if self._opened is shown.opened:
            return
        self._opened = shown.opened
        recording = shown.opened.session.recording
        put(self._streams, content=_stream_table(describe(recording)))
        topics = recording.topics
        lidars = [topic.name for topic in topics if topic.role == "lidar"]
        depths = [topic.name for topic in topics if topic.role == "depth"]
        view = shown.view
        put(self._lidar, options=(_NOT_NAMED, *lidars))
        put(self._lidar, value=view.lidar_topic or _NOT_NAMED)
        put(self._depth, options=(_NOT_NAMED, *depths))
        put(self._depth, value=view.depth_topics[0] if len(view.depth_topics) == 1 else _NOT_NAMED)
        put(self._virtual, value=-1 if view.virtual_row is None else view.virtual_row)

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
        said = f"Aligning the recording: {step.what}, {step.done} of {step.total or '?'}"
        put(self._progress_text, content=f'<div style="padding:0 0.5em">{html.escape(said)}</div>')


def _stream_table(described: dict[str, Any]) -> str:
    """Streams with counts and rates, what can be done, and warnings, as HTML."""
    cell = "<td style='padding:0.1em 0.5em 0.1em 0;vertical-align:top;overflow-wrap:anywhere'>"
    rows = "".join(
        f"<tr>{cell}{html.escape(topic['name'])}</td>{cell}{topic['role'].replace('_', ' ')}</td>"
        f"{cell}{topic['count']}</td>{cell}{_rate(topic['rate_hz'])}</td></tr>"
        for topic in described["topics"]
    )
    head = "".join(f"<th align='left'>{name}</th>" for name in ("stream", "role", "count", "Hz"))
    lines = [html.escape(line) for line in described["can"]]
    lines += [f"<b>Warning:</b> {html.escape(line)}" for line in described["warnings"]]
    duration_s = described["duration_s"]
    time = "" if duration_s is None else f", {duration_s:.1f} s"
    return (
        "<div style='padding:0 0.5em;font-size:0.85em'>"
        f"<div>{html.escape(described['format'])}{time}</div>"
        f"<table style='width:100%;font-size:0.95em'><tr>{head}</tr>{rows}</table>"
        + "".join(f"<p style='margin:0.3em 0'>{line}</p>" for line in lines)
        + "</div>"
    )


def _rate(rate_hz: float | None) -> str:
    return "–" if rate_hz is None else f"{rate_hz:.1f}"
