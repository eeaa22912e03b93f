"""What a person changed in the settings, to undo and to redo."""

from scanloom.state.view import View

_MOST = 200
# Values of one setting that follow each other this closely are one drag of its slider.
_DRAG_S = 1.0


class History:
    """The settings before each change, the latest last."""

    def __init__(self) -> None:
        self._before: list[View] = []
        self._after: list[View] = []
        self._dragged, self._dragged_s = "", 0.0

    def add(self, view: View, dragged: str = "", at_s: float = 0.0) -> None:
        """``view`` is about to be changed. ``dragged``: the setting that changes at the time
        ``at_s``, where it may be one value of many from one drag; the drag is one change."""
        goes_on = dragged == self._dragged != "" and at_s - self._dragged_s < _DRAG_S
        self._dragged, self._dragged_s = dragged, at_s
        self._after = []
        if not goes_on:
            self._before = [*self._before[-_MOST + 1 :], view]

    def undo(self, view: View) -> View | None:
        """``view`` with the settings before its last change, None where there was none."""
        if not self._before:
            return None
        self._dragged = ""
        self._after.append(view)
        return _with_settings_of(view, self._before.pop())

    def redo(self, view: View) -> View | None:
        """``view`` with the settings that the last undo took back."""
        if not self._after:
            return None
        self._dragged = ""
        self._before.append(view)
        return _with_settings_of(view, self._after.pop())


def _with_settings_of(view: View, other: View) -> View:
    """Where a person is stays; what they set goes."""
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
