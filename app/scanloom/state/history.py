"""Undo and redo of changes of the settings."""

from scanloom.state.view import View

# Steps of undo; a view takes a few kilobytes.
_MAX_STEPS = 200
# Changes of one setting within this time belong to one drag of its slider.
_DRAG_S = 1.0


class History:
    """The views before each change, the latest last."""

    def __init__(self) -> None:
        self._before: list[View] = []
        self._after: list[View] = []
        self._dragged, self._dragged_s = "", 0.0

    def add(self, view: View, dragged: str = "", at_s: float = 0.0) -> None:
        """Record ``view``, which is about to change.

        ``dragged``: the setting that a slider changes at the time ``at_s``; the changes of one drag
        are one step.
        """
        goes_on = dragged == self._dragged != "" and at_s - self._dragged_s < _DRAG_S
        self._dragged, self._dragged_s = dragged, at_s
        self._after = []
        if not goes_on:
            self._before = [*self._before[-_MAX_STEPS + 1 :], view]

    def undo(self, view: View) -> View | None:
        """``view`` with the settings before its last change, None if there was none."""
        if not self._before:
            return None
        self._dragged = ""
        self._after.append(view)
        return _with_settings_of(view, self._before.pop())

    def redo(self, view: View) -> View | None:
        """``view`` with the settings that were undone last, None if there are none."""
        if not self._after:
            return None
        self._dragged = ""
        self._before.append(view)
        return _with_settings_of(view, self._after.pop())


def _with_settings_of(view: View, other: View) -> View:
    """``view`` with the settings of ``other``; recording, frame and panel are kept."""
    return view.model_copy(
        update={
            "preset": other.preset,
            "settings": other.settings,
            "alignment_settings": other.alignment_settings,
            "picked_offset": other.picked_offset,
            "lock_picked_offset": other.lock_picked_offset,
            "apply_clock_offset": other.apply_clock_offset,
        }
    )
