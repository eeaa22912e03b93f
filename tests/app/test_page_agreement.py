"""The benchmark's measure of whether all views show one frame."""

from typing import Any

import numpy as np

from tests.app.viser_client import Received
from tests.benchmarks.page_agreement import PageContent


def picture(widget: str, frame: int, at_s: float) -> Received:
    message = {"type": "GuiUpdateMessage", "uuid": widget, "updates": {"_data": b"%d" % frame}}
    return Received(message, at_s, 100)


def node(name: str, frame: int, at_s: float) -> Received:
    points = np.full((3, 3), float(frame))
    message: dict[str, Any] = {
        "type": "PointCloudMessage",
        "name": name,
        "props": {"points": points},
    }
    return Received(message, at_s, 100)


def visible(name: str, at_s: float, *, is_visible: bool) -> Received:
    message = {"type": "SetSceneNodeVisibilityMessage", "name": name, "visible": is_visible}
    return Received(message, at_s, 100)


def shown(frame: int, at_s: float) -> list[Received]:
    return [picture("depth", frame, at_s), picture("field", frame, at_s), node("/a", frame, at_s)]


def learned(frames: int = 20) -> PageContent:
    content = PageContent()
    for frame in range(frames):
        content.learn(shown(frame, 0.0), frame)
    return content


def test_whole_frames_agree() -> None:
    found = learned().judge([*shown(3, 1.0), *shown(4, 2.0), *shown(7, 3.0)])
    assert (found.worst, found.frames, found.batches) == (0, (3, 4, 7), 3)
    assert (found.parts, found.most_messages) == (3, 3)


def test_a_view_that_lags_behind_is_found() -> None:
    late = [*shown(3, 1.0), *shown(9, 2.0)[:2], node("/a", 9, 2.5)]
    found = learned().judge(late)
    assert found.worst == 6
    assert found.frames[-1] == 9


def test_what_is_hidden_may_be_old() -> None:
    content = learned()
    hidden = [*shown(3, 1.0), visible("/a", 2.0, is_visible=False), *shown(9, 2.0)[:2]]
    assert content.judge(hidden).worst == 0
    assert content.judge([visible("/a", 3.0, is_visible=True), *shown(9, 3.0)[:2]]).worst == 6


def test_content_of_several_frames_tells_nothing_against_either() -> None:
    content = PageContent()
    for frame in range(20):
        content.learn([picture("text", frame // 2 * 2, 0.0), picture("depth", frame, 0.0)], frame)
    found = content.judge([picture("text", 4, 1.0), picture("depth", 5, 1.0)])
    assert found.worst == 0
    assert found.frames == (5,)


def test_what_never_changes_is_no_view_of_the_frame() -> None:
    content = PageContent()
    for frame in range(20):
        content.learn([picture("legend", 0, 0.0), *shown(frame, 0.0)], frame)
    assert content.judge(shown(2, 1.0)).parts == 3
