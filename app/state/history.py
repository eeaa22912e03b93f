"""What a person changed in the settings, to undo and to redo."""

from app.state.view import View

_MOST = 200


class History:
    """The settings before each change, the latest last."""

    def __init__(self) -> None:
        self._before: list[View] = []
        self._after: list[View] = []

    def add(self, view: View) -> None:
        """``view`` is about to be changed."""
        self._before = [*self._before[-_MOST + 1 :], view]
        self._after = []

    def undo(self, view: View) -> View | None:
        """``view`` with the settings before its last change, None where there was none."""
        if not self._before:
            return None
        self._after.append(view)
        return _with_settings_of(view, self._before.pop())

    def redo(self, view: View) -> View | None:
        """``view`` with the settings that the last undo took back."""
        if not self._after:
            return None
        self._before.append(view)
        return _with_settings_of(view, self._after.pop())


def _with_settings_of(view: View, other: View) -> View:
    """Where a person is stays; what they set goes."""
    return view.model_copy(
        update={
            "preset": other.preset,
            "settings": other.settings,
            "picked": other.picked,
            "lock_picked": other.lock_picked,
            "apply_clock_offset": other.apply_clock_offset,
        }
    )
