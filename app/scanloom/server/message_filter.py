"""What browsers may send: messages of the kinds that are used here, and new values of widgets that
are there, of their kind and in their range.

viser sets any attribute of a widget that a message names, and casts a value without a look at the
widget's range; a message that it cannot read ends the connection with a traceback. So a check
stands in front of it. What a value means is checked once more where it is used
(``scanloom.state.view``).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import msgspec
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

# The answer to the first question, which ends a browser's time of waiting.
_ANSWER = messages.LocalStorageGetItemResponseMessage
_USED: dict[str, type[Any]] = {
    kind.__name__: kind
    for kind in (
        _ANSWER,
        messages.ViewerCameraMessage,
        messages.GuiUpdateMessage,
        messages.CommandTriggerMessage,
        messages.SceneNodeClickMessage,
        messages.ScenePointerMessage,
    )
}
_MOST_PIXELS = 2**20
# No message of a browser is longer: a view that it kept, or a text that was typed. Their text is
# in UTF-8, a character up to 4 bytes long.
MOST_BYTES = 2**18


@dataclass(frozen=True, slots=True)
class MessageCheck:
    """What to do with a message: hand it on where it ``is_wanted``, and else tell of its
    ``problem``, if any. ``answers``: it says what the browser keeps."""

    is_wanted: bool = False
    answers: bool = False
    problem: str = ""


def check_message(data: str | bytes) -> MessageCheck:
    """What to do with a message, before viser reads it: it must be of a kind that is used, with all
    the values of that kind and no other, and no number that is none."""
    if not isinstance(data, bytes):
        return MessageCheck(problem="a text where viser sends bytes")
    try:
        values = msgspec.msgpack.decode(data)
        name = values.pop("type")
        kind = _USED.get(name)
    except (msgspec.DecodeError, RecursionError, AttributeError, KeyError, TypeError, ValueError):
        return MessageCheck(problem="what is no message of viser's")
    if kind is None:
        known = name in messages.Message._subclass_from_type_string()
        # A page may send more than is made use of.
        return MessageCheck(
            problem="" if known else f"a message of the unknown kind {_short(name)}"
        )
    problem = _problem_of_message(values, kind)
    if problem:
        return MessageCheck(problem=f"a {name}: {problem}")
    return MessageCheck(is_wanted=True, answers=kind is _ANSWER)


def _problem_of_message(values: dict[Any, Any], kind: type[Any]) -> str | None:
    """Why viser could not make use of a message, None where it can."""
    unknown = values.keys() - {field.name for field in fields(kind)}
    if unknown:
        return f"it knows no {_short(next(iter(unknown)))}"
    try:
        message = msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        return str(error)
    if kind is not messages.GuiUpdateMessage and not _is_finite(values):
        return "a number in it is not finite"
    if isinstance(message, messages.ViewerCameraMessage):
        sides = message.image_height, message.image_width
        # A window may be as small as nothing.
        if not all(0 <= side <= _MOST_PIXELS for side in sides):
            return f"a picture of {sides[1]} x {sides[0]} pixels"
    return None


def _is_finite(value: object) -> bool:
    if isinstance(value, dict):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def restrict_gui_updates(gui: viser.GuiApi, refused: Callable[[int, str], None]) -> None:
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


def disable_share_tunnel(server: viser.ViserServer) -> None:
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
