"""What a person changed, to undo and to redo."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.state.history import History
from scanloom.state.view import View

CHANGES = st.lists(st.floats(0.1, 9.0), min_size=1, max_size=12)


def walked(history: History, start: View, epsilons: list[float]) -> list[View]:
    """The views of a walk through these settings; each is at a place of its own."""
    views = [start]
    for number, epsilon in enumerate(epsilons):
        history.add(views[-1])
        views.append(
            views[-1].with_setting("noise", "epsilon", epsilon).changed(frame_index=number)
        )
    return views


@given(epsilons=CHANGES)
def test_undo_goes_all_the_way_back_and_redo_all_the_way_again(epsilons: list[float]) -> None:
    history = History()
    views = walked(history, View(recording="a"), epsilons)
    at = views[-1]
    for step, then in ((history.undo, views[-2::-1]), (history.redo, views[1:])):
        for expected in then:
            moved = step(at)
            assert moved is not None
            assert moved.settings == expected.settings
            assert moved.frame_index == at.frame_index
            at = moved
        assert step(at) is None


@given(epsilons=CHANGES)
def test_a_change_after_an_undo_leaves_nothing_to_redo(epsilons: list[float]) -> None:
    history = History()
    views = walked(history, View(recording="a"), epsilons)
    undone = history.undo(views[-1])
    assert undone is not None
    history.add(undone)
    assert history.redo(undone) is None


def test_a_drag_is_one_change() -> None:
    history = History()
    views = [View(recording="a")]
    for epsilon, dragged, at_s in (
        (1.1, "noise.epsilon", 10.0),
        (1.2, "noise.epsilon", 10.9),
        (1.3, "noise.epsilon", 11.8),
        (1.4, "noise.epsilon", 20.0),
        (1.5, "noise.other", 20.1),
        (1.6, "", 20.2),
        (1.7, "", 20.3),
    ):
        history.add(views[-1], dragged, at_s)
        views.append(views[-1].with_setting("noise", "epsilon", epsilon))
    undone, view = [], views[-1]
    while (before := history.undo(view)) is not None:
        view = before
        undone.append(view.settings.noise.epsilon)
    assert undone == [1.6, 1.5, 1.4, 1.3, views[0].settings.noise.epsilon]
    # Back in the past, the same setting begins a drag of its own.
    history.add(view, "noise.epsilon", 30.0)
    history.undo(view)
    history.add(view, "noise.epsilon", 30.1)
    assert history.undo(view) is not None


def test_the_history_is_bounded() -> None:
    history = History()
    view = walked(history, View(recording="a"), [1.0 + i / 1000 for i in range(500)])[-1]
    undone = 0
    while (before := history.undo(view)) is not None:
        view, undone = before, undone + 1
    assert undone == 200
    assert view.settings.noise.epsilon == pytest.approx(1.299)
