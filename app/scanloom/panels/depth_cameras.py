"""Which depth cameras are used: those found by type, or any that are chosen by hand."""

from collections.abc import Sequence

import viser

from scanloom.client_session import Desk
from scanloom.frame_view import Shown
from scanloom.panels.controls import Controls
from scanloom.state.opened import Opened
from scanloom.state.view import View


class DepthCameras:
    """A box for each depth topic, and one for those found by type.

    viser has no list to choose several of, and its widgets are made once: each recording gets boxes
    of its own.
    """

    def __init__(self, gui: viser.GuiApi, desk: Desk) -> None:
        self._gui = gui
        self._desk = desk
        self._recording: object = None
        self._topics: tuple[str, ...] = ()
        self._used: tuple[str, ...] = ()
        self._boxes: list[viser.GuiCheckboxHandle] = []
        self._controls = Controls(gui, desk)
        self._folder = gui.add_folder("Depth cameras", expand_by_default=True)

    def show(self, shown: Shown) -> None:
        """Boxes once for each recording; what is checked is what the view asks for."""
        opened = shown.opened
        if self._recording is not opened.session.recording:
            self._recording = opened.session.recording
            self._make_boxes(shown.view, opened)
        self._used = opened.session.streams.depth
        self._controls.show(shown.view)

    def _make_boxes(self, view: View, opened: Opened) -> None:
        for box in self._boxes:
            box.remove()
        self._topics = tuple(
            topic.name for topic in opened.session.recording.topics if topic.role == "depth"
        )
        self._used = opened.session.streams.depth
        self._controls = Controls(self._gui, self._desk)
        with self._folder:
            by_type = self._gui.add_checkbox(
                "Found by type",
                not view.depth_topics,
                hint="Each camera once: packed copies of its images are left out",
            )
            self._boxes = [by_type]
            self._controls.tie(by_type, lambda v: not v.depth_topics, self._take_found)
            for topic, label in zip(self._topics, own_parts(self._topics), strict=True):
                self._boxes.append(self._add_box(topic, label, view))

    def _add_box(self, topic: str, label: str, view: View) -> viser.GuiCheckboxHandle:
        box = self._gui.add_checkbox(label, topic in self._chosen(view), hint=topic)
        self._controls.tie(
            box,
            lambda v: topic in self._chosen(v),
            lambda checked: self._take(topic, checked),
        )
        return box

    def _chosen(self, view: View) -> tuple[str, ...]:
        return view.depth_topics or self._used

    def _take_found(self, checked: bool) -> None:
        self._choose(() if checked else self._used)

    def _take(self, topic: str, checked: bool) -> None:
        others = set(self._chosen(self._desk.view)) - {topic}
        chosen = others | {topic} if checked else others
        if not chosen:
            self._desk.tell("One depth camera is needed", "Check another one first.")
            self._desk.refresh()
            return
        # In the recording's order: the same cameras are the same choice.
        self._choose(tuple(name for name in self._topics if name in chosen))

    def _choose(self, topics: tuple[str, ...]) -> None:
        self._desk.change(depth_topics=topics, number=0)


def own_parts(topics: Sequence[str]) -> list[str]:
    """What tells topics apart: their names without the last parts that all of them share."""
    parts = [topic.split("/") for topic in topics]
    shared = 0
    while len(parts) > 1 and all(len(own) > shared + 2 for own in parts):
        if len({own[-1 - shared] for own in parts}) > 1:
            break
        shared += 1
    return ["/".join(own[: len(own) - shared]) for own in parts]
