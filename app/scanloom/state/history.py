"""Undo and redo: of settings, and of where a person was."""

from scanloom.state.view import View

# Steps of undo; a view takes a few kilobytes.
_MAX_STEPS = 200
# Changes of one kind within this time belong to one drag of a slider.
_DRAG_S = 1.0
# Frames that pass one after the other, by keys or by playing, are one change however long it takes.
PASSING_FRAMES = "passing frames"
# So do the changes of one gesture in the scene; each has a number.
GESTURE = "gesture"
# The rest is how things are shown, and what was pointed at.
_FIELDS = (
    "recording",
    "lidar_topic",
    "depth_topics",
    "virtual_row",
    "extrinsics",
    "frame_index",
    "panel",
    "preset",
    "settings",
    "alignment_settings",
    "picked_offset",
    "lock_picked_offset",
    "apply_clock_offset",
    "map_mode",
    "slam",
)


class History:
    """The views before each change, the latest last."""

    def __init__(self) -> None:
        self._before: list[View] = []
        self._after: list[View] = []
        self._dragged, self._dragged_s = "", 0.0

    def add(self, before: View, after: View, dragged: str = "", at_s: float = 0.0) -> None:
        """Record a change, if it is one that undo takes back.

        ``dragged``: what a slider changes at the time ``at_s``; the changes of one drag are one
        step.
        """
        if after == _with_fields_of(after, before):
            return
        is_one = dragged == PASSING_FRAMES or dragged.startswith(GESTURE)
        is_soon = is_one or at_s - self._dragged_s < _DRAG_S
        goes_on = is_soon and dragged == self._dragged != ""
        self._dragged, self._dragged_s = dragged, at_s
        self._after = []
        if not goes_on:
            self._before = [*self._before[-_MAX_STEPS + 1 :], before]

    def undo(self, view: View) -> View | None:
        """``view`` as it was before the last change, None if there was none."""
        return self._go(view, self._before, self._after)

    def redo(self, view: View) -> View | None:
        """``view`` as it was before the last undo, None if there was none."""
        return self._go(view, self._after, self._before)

    def _go(self, view: View, taken: list[View], kept: list[View]) -> View | None:
        self._dragged = ""
        while taken:
            found = _with_fields_of(view, taken.pop())
            # A recording that could not be opened was left already.
            if found != view:
                kept.append(view)
                return found
        return None


def _with_fields_of(view: View, other: View) -> View:
    """``view`` with what undo brings back as it is in ``other``."""
    return view.model_copy(update={name: getattr(other, name) for name in _FIELDS})
