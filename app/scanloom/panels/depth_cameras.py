"""Choice of the depth cameras: those found by type, or chosen by hand."""

from collections.abc import Sequence

import viser

from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView
from scanloom.panels.widgets.controls import Controls
from scanloom.state.open_recording import OpenRecording
from scanloom.state.view import View


class DepthCameras:
    """A box for each depth topic, and one for those found by type.

    viser has no multiple choice, and the number of widgets is fixed: the boxes are created anew for
    each recording.
    """

    def __init__(self, gui: viser.GuiApi, session: ClientSession) -> None:
        self._gui = gui
        self._session = session
        self._recording: object = None
        self._topics: tuple[str, ...] = ()
        self._used: tuple[str, ...] = ()
        self._boxes: list[viser.GuiCheckboxHandle] = []
        self._controls = Controls(gui, session)
        self._folder = gui.add_folder("Depth cameras", expand_by_default=True)

    def show(self, frame_view: FrameView) -> None:
        """Create the boxes of a new recording, and check those of the view."""
        open_recording = frame_view.open_recording
        if self._recording is not open_recording.recording:
            self._recording = open_recording.recording
            self._make_boxes(frame_view.view, open_recording)
        self._used = open_recording.opened.streams.depth
        self._controls.show(frame_view.view)

    def _make_boxes(self, view: View, open_recording: OpenRecording) -> None:
        for box in self._boxes:
            box.remove()
        self._topics = tuple(
            topic.name for topic in open_recording.recording.topics if topic.role == "depth"
        )
        self._used = open_recording.opened.streams.depth
        self._controls = Controls(self._gui, self._session)
        with self._folder:
            by_type = self._gui.add_checkbox(
                "Found by type",
                not view.depth_topics,
                hint="Each camera once: packed copies of its images are left out",
            )
            self._boxes = [by_type]
            self._controls.bind(by_type, lambda v: not v.depth_topics, self._choose_by_type)
            for topic, label in zip(self._topics, distinct_labels(self._topics), strict=True):
                self._boxes.append(self._add_box(topic, label, view))

    def _add_box(self, topic: str, label: str, view: View) -> viser.GuiCheckboxHandle:
        box = self._gui.add_checkbox(label, topic in self._chosen(view), hint=topic)
        self._controls.bind(
            box,
            lambda v: topic in self._chosen(v),
            lambda checked: self._toggle(topic, checked),
        )
        return box

    def _chosen(self, view: View) -> tuple[str, ...]:
        return view.depth_topics or self._used

    def _choose_by_type(self, checked: bool) -> None:
        self._choose(() if checked else self._used)

    def _toggle(self, topic: str, checked: bool) -> None:
        others = set(self._chosen(self._session.view)) - {topic}
        chosen = others | {topic} if checked else others
        if not chosen:
            self._session.notify("One depth camera is needed", "Check another one first.")
            self._session.refresh()
            return
        # In the recording's order, so that the same cameras are the same choice.
        self._choose(tuple(name for name in self._topics if name in chosen))

    def _choose(self, topics: tuple[str, ...]) -> None:
        self._session.change(depth_topics=topics, frame_index=0)


def distinct_labels(topics: Sequence[str]) -> list[str]:
    """The shortest distinct labels of topics: their names without the last parts common to all."""
    parts = [topic.split("/") for topic in topics]
    shared = 0
    while len(parts) > 1 and all(len(own) > shared + 2 for own in parts):
        if len({own[-1 - shared] for own in parts}) > 1:
            break
        shared += 1
    return ["/".join(own[: len(own) - shared]) for own in parts]
