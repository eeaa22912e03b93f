"""What browsers may send: new values of widgets that are there, of their kind and in their range.

viser sets any attribute of a widget that a message names, and casts a value without a look at the
widget's range. So a check stands in front of it. What a value means is checked once more where it
is used (``app.state.view``).
"""

import math
from collections.abc import Callable
from typing import Any

import viser
from viser import _messages as messages

_MOST_CHARACTERS = 10_000
_MOST_SHOWN = 40
# Browsers round a number to the digits that viser shows, which are 7 at most.
_ROUNDING = 1e-7
# The workbench has no upload buttons and no forms. viser would keep what it is sent for them.
_NEVER = (
    messages.FileTransferStartUpload,
    messages.FileTransferPart,
    messages.GuiFormDirtyMessage,
    messages.GuiFormSubmitMessage,
)


def only_values(gui: viser.GuiApi, refused: Callable[[int, str], None]) -> None:
    """Let browsers change nothing of ``gui`` but the values of its widgets.

    A value must be of the widget's kind, finite, within its range or among its options, and of at
    most 10,000 characters. Anything else changes nothing; ``refused`` gets the client's id and a
    line that says why. It is called on the server's event loop and must not wait. Call this before
    the first widget is added.
    """
    taken = gui._websock_interface
    take = gui._handle_gui_updates

    async def take_checked(client_id: Any, message: messages.GuiUpdateMessage) -> None:
        known = isinstance(message.uuid, str)
        handle = gui._gui_input_handle_from_uuid.get(message.uuid) if known else None
        if handle is None:
            return
        problem = _problem(handle, message.updates)
        if problem is None:
            await take(client_id, message)
        else:
            label = getattr(handle._impl.props, "label", type(handle).__name__)
            refused(client_id, f"{label!r}: {problem}")

    taken.unregister_handler(messages.GuiUpdateMessage, take)
    taken.register_handler(messages.GuiUpdateMessage, take_checked)
    for kind in _NEVER:
        taken.unregister_handler(kind)


def without_sharing(server: viser.ViserServer) -> None:
    """Take from browsers the power to open, and to close, a tunnel for the whole internet."""
    for kind in (messages.ShareUrlRequest, messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(kind)


def _problem(handle: Any, updates: object) -> str | None:
    """Why ``updates`` of a widget may not be taken, None where they may."""
    if not isinstance(updates, dict) or list(updates) != ["value"]:
        return "only its value can be changed"
    props = handle._impl.props
    # A progress bar has a value, and is nothing to be worked by hand.
    if not isinstance(props, messages.GuiBaseProps) or props.disabled:
        return "it cannot be changed now"
    new, current = updates["value"], handle._impl.value
    low, high = getattr(props, "min", None), getattr(props, "max", None)
    if not isinstance(current, tuple):
        options = getattr(props, "options", None)
        if options is not None and new not in options:
            return f"{_short(new)} is none of its options"
        return _problem_of_one(new, current, low, high)
    count = len(current)
    if not isinstance(new, list | tuple) or len(new) != count:
        return f"it takes {count} values"
    # Vectors have a range for each component, sliders of several handles one for all.
    lows = low if isinstance(low, tuple) else (low,) * count
    highs = high if isinstance(high, tuple) else (high,) * count
    problems = map(_problem_of_one, new, current, lows, highs)
    return next((problem for problem in problems if problem is not None), None)


def _problem_of_one(
    new: object, current: object, low: float | None, high: float | None
) -> str | None:
    """Why ``new`` may not take the place of ``current``, None where it may."""
    match current:
        case bool():
            return None if isinstance(new, bool) else f"{_short(new)} is neither true nor false"
        case str():
            if not isinstance(new, str):
                return f"{_short(new)} is no text"
            too_long = len(new) > _MOST_CHARACTERS
            return f"a text of more than {_MOST_CHARACTERS:,} characters" if too_long else None
        case int() | float():
            if isinstance(new, bool) or not isinstance(new, int | float) or not math.isfinite(new):
                return f"{_short(new)} is no number"
            if isinstance(current, int) and new != int(new):
                return f"{new:g} is no whole number"
            if low is not None and new < low - _ROUNDING:
                return f"{new:g} is less than {low:g}"
            if high is not None and new > high + _ROUNDING:
                return f"{new:g} is more than {high:g}"
            return None
    return "it cannot be changed"


def _short(value: object) -> str:
    """A value in a few characters of one line, whatever it is."""
    if isinstance(value, str | bytes):
        return repr(value[:_MOST_SHOWN]) + ("…" if len(value) > _MOST_SHOWN else "")
    return repr(value) if isinstance(value, int | float) else f"a value of {type(value).__name__}"
