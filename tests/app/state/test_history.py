"""What a person changed and where they were, to undo and to redo."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.state.hand_pose import HandPose
from scanloom.state.history import GESTURE, PASSING_FRAMES, History
from scanloom.state.view import View

START = View(recording="a")
CHANGES = st.lists(
    st.one_of(
        st.floats(0.1, 9.0).map(lambda epsilon: START.with_setting("noise", "epsilon", epsilon)),
        st.integers(1, 90).map(lambda number: START.changed(frame_index=number)),
        st.sampled_from(["Match", "Repair", "Map"]).map(lambda name: START.changed(panel=name)),
        st.sampled_from(["b", "c"]).map(START.of_recording),
    ),
    min_size=1,
    max_size=12,
)


def walked(history: History, views: list[View]) -> list[View]:
    """The views of a walk from START through these, without those that change nothing."""
    passed = [START]
    for view in views:
        history.add(passed[-1], view)
        if view != passed[-1]:
            passed.append(view)
    return passed


@given(views=CHANGES)
def test_undo_goes_all_the_way_back_and_redo_all_the_way_again(views: list[View]) -> None:
    history = History()
    passed = walked(history, views)
    at = passed[-1]
    for step, then in ((history.undo, passed[-2::-1]), (history.redo, passed[1:])):
        for expected in then:
            moved = step(at)
            assert moved == expected
            at = expected
        assert step(at) is None


@given(views=CHANGES)
def test_a_change_after_an_undo_leaves_nothing_to_redo(views: list[View]) -> None:
    history = History()
    undone = history.undo(walked(history, views)[-1])
    assert undone is not None
    history.add(undone, undone.changed(frame_index=99))
    assert history.redo(undone) is None


def test_how_things_are_shown_stays() -> None:
    history = History()
    history.add(START, START.changed(color_scheme="dark", selected_beam=3))
    shown = START.changed(color_scheme="dark", selected_beam=3, frame_index=5)
    history.add(START, shown)
    assert history.undo(shown) == shown.changed(frame_index=0)
    assert history.undo(START) is None


def test_what_was_left_already_is_no_step() -> None:
    """A recording that cannot be opened is left at once, without a change of the person's."""
    history = History()
    history.add(START, START.changed(panel="Match"))
    at = START.changed(panel="Match")
    history.add(at, at.of_recording("broken"))
    assert history.undo(at) == START


def test_a_drag_is_one_change() -> None:
    history = History()
    views = [START]
    for epsilon, dragged, at_s in (
        (1.1, "noise.epsilon", 10.0),
        (1.2, "noise.epsilon", 10.9),
        (1.3, "noise.epsilon", 11.8),
        (1.4, "noise.epsilon", 20.0),
        (1.5, "noise.other", 20.1),
        (1.6, "", 20.2),
        (1.7, "", 20.3),
    ):
        views.append(views[-1].with_setting("noise", "epsilon", epsilon))
        history.add(views[-2], views[-1], dragged, at_s)
    undone, view = [], views[-1]
    while (before := history.undo(view)) is not None:
        view = before
        undone.append(view.settings.noise.epsilon)
    assert undone == [1.6, 1.5, 1.4, 1.3, START.settings.noise.epsilon]
    # Back in the past, the same setting begins a drag of its own.
    other = view.with_setting("noise", "epsilon", 5.0)
    history.add(view, other, "noise.epsilon", 30.0)
    assert history.undo(other) == view
    history.add(view, other, "noise.epsilon", 30.1)
    assert history.undo(other) == view


def test_frames_pass_as_one_change_however_slowly() -> None:
    history = History()
    views = [START.changed(frame_index=number) for number in range(5)]
    for number in range(1, 4):
        history.add(views[number - 1], views[number], PASSING_FRAMES, 100.0 * number)
    history.add(views[3], views[4], "frame_index", 301.0)
    assert history.undo(views[4]) == views[3]
    assert history.undo(views[3]) == views[0]


def test_the_history_is_bounded() -> None:
    history = History()
    views = [START.with_setting("noise", "epsilon", 1.0 + i / 1000) for i in range(500)]
    view = walked(history, views)[-1]
    undone = 0
    while (before := history.undo(view)) is not None:
        view, undone = before, undone + 1
    assert undone == 200
    assert view.settings.noise.epsilon == pytest.approx(1.299)


def test_a_gesture_is_one_step_however_long_it_takes_and_the_next_is_another() -> None:
    history, at = History(), START
    for gesture, yaw_deg, at_s in ((0, 1.0, 0.0), (0, 2.0, 7.0), (1, 3.0, 7.5)):
        moved = at.changed(extrinsics=HandPose(yaw_deg=yaw_deg))
        history.add(at, moved, f"{GESTURE} {gesture}", at_s)
        at = moved
    undone = history.undo(at)
    assert undone is not None
    assert undone.hand_pose == HandPose(yaw_deg=2.0)
    assert history.undo(undone) == START
