"""Validates messages from browsers before viser handles them.

Accepted are the message types that the workbench uses, and values of existing widgets that have the
widget's type and lie in its range. viser itself sets any attribute that a message names, does not
check ranges, and ends the connection with a traceback on a malformed message. The meaning of a
value is validated where it is used (``scanloom.state.view``).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import msgspec
import viser
from viser import _messages as messages

# Set by hand, well above any text that is typed into the workbench.
_MAX_CHARACTERS = 10_000
_MAX_QUOTED_CHARACTERS = 40
# Browsers round numbers to the displayed digits, at most 7.
_RANGE_TOLERANCE = 1e-7
# The workbench has no upload buttons and no forms; viser would store uploads in memory.
_UNUSED_MESSAGES = (
    messages.FileTransferStartUpload,
    messages.FileTransferPart,
    messages.GuiFormDirtyMessage,
    messages.GuiFormSubmitMessage,
)

# The answer to the server's first request; it ends the pending state of a connection.
_STORAGE_RESPONSE = messages.LocalStorageGetItemResponseMessage
_ACCEPTED_MESSAGES: dict[str, type[Any]] = {
    kind.__name__: kind
    for kind in (
        _STORAGE_RESPONSE,
        messages.ViewerCameraMessage,
        messages.GuiUpdateMessage,
        messages.CommandTriggerMessage,
        messages.SceneNodeClickMessage,
        messages.ScenePointerMessage,
        messages.TransformControlsDragStartMessage,
        messages.TransformControlsUpdateMessage,
        messages.TransformControlsDragEndMessage,
    )
}
# Set by hand, far above any screen.
_MAX_IMAGE_SIDE_PX = 2**20
# The longest valid messages hold a stored view or a typed text of _MAX_CHARACTERS, in UTF-8 with up
# to 4 bytes a character.
MAX_MESSAGE_BYTES = 2**18


@dataclass(frozen=True, slots=True)
class MessageCheck:
    """The result of validating a message.

    ``is_accepted``: viser may handle it. ``problem``: why not; empty for a known message type that
    is not used. ``is_storage_response``: it answers a request for the browser's stored items.
    """

    is_accepted: bool = False
    is_storage_response: bool = False
    problem: str = ""


def check_message(data: str | bytes) -> MessageCheck:
    """Validate a raw message: an accepted type, exactly the fields of that type, finite numbers."""
    if not isinstance(data, bytes):
        return MessageCheck(problem="a text where viser sends bytes")
    try:
        values = msgspec.msgpack.decode(data)
        name = values.pop("type")
        kind = _ACCEPTED_MESSAGES.get(name)
    except (msgspec.DecodeError, RecursionError, AttributeError, KeyError, TypeError, ValueError):
        return MessageCheck(problem="what is no message of viser's")
    if kind is None:
        known = name in messages.Message._subclass_from_type_string()
        # Pages also send known messages that the workbench does not use.
        return MessageCheck(
            problem="" if known else f"a message of the unknown kind {_quoted(name)}"
        )
    problem = _problem_of_message(values, kind)
    if problem:
        return MessageCheck(problem=f"a {name}: {problem}")
    return MessageCheck(is_accepted=True, is_storage_response=kind is _STORAGE_RESPONSE)


def _problem_of_message(values: dict[Any, Any], kind: type[Any]) -> str | None:
    """Why a message is invalid, None if it is valid."""
    unknown = values.keys() - {field.name for field in fields(kind)}
    if unknown:
        return f"it knows no {_quoted(next(iter(unknown)))}"
    try:
        message = msgspec.convert(values, kind)
    except msgspec.ValidationError as error:
        return str(error)
    if kind is not messages.GuiUpdateMessage and not _is_finite(values):
        return "a number in it is not finite"
    if isinstance(message, messages.ViewerCameraMessage):
        sides = message.image_height, message.image_width
        # A hidden window has no pixels.
        if not all(0 <= side <= _MAX_IMAGE_SIDE_PX for side in sides):
            return f"a picture of {sides[1]} x {sides[0]} pixels"
    return None


def _is_finite(value: object) -> bool:
    if isinstance(value, dict):
        return all(map(_is_finite, value.values()))
    if isinstance(value, list):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def restrict_gui_updates(gui: viser.GuiApi, on_refusal: Callable[[int, str], None]) -> None:
    """Restrict browsers to changing the values of ``gui``'s widgets.

    A value must have the widget's type, be finite, lie in its range or among its options, and have
    at most 10,000 characters. Other updates are ignored, and ``on_refusal`` is called with the
    client's id and the reason, on the server's event loop, which it must not block. Call this
    before the first widget is added.
    """
    taken = gui._websock_interface
    take = gui._handle_gui_updates

    async def take_checked(client_id: Any, message: messages.GuiUpdateMessage) -> None:
        known = isinstance(message.uuid, str)
        handle = gui._gui_input_handle_from_uuid.get(message.uuid) if known else None
        if handle is None:
            return
        problem = _problem_of_update(handle, message.updates)
        if problem is None:
            await take(client_id, message)
        else:
            label = getattr(handle._impl.props, "label", type(handle).__name__)
            on_refusal(client_id, f"{label!r}: {problem}")

    taken.unregister_handler(messages.GuiUpdateMessage, take)
    taken.register_handler(messages.GuiUpdateMessage, take_checked)
    for kind in _UNUSED_MESSAGES:
        taken.unregister_handler(kind)


def disable_share_tunnel(server: viser.ViserServer) -> None:
    """Keep browsers from opening or closing viser's tunnel to the public internet."""
    for kind in (messages.ShareUrlRequest, messages.ShareUrlDisconnect):
        server._websock_server.unregister_handler(kind)


def _problem_of_update(handle: Any, updates: object) -> str | None:
    """Why ``updates`` of a widget are invalid, None if they are valid."""
    if not isinstance(updates, dict) or list(updates) != ["value"]:
        return "only its value can be changed"
    props = handle._impl.props
    # A progress bar has a value, but is no input.
    if not isinstance(props, messages.GuiBaseProps) or props.disabled:
        return "it cannot be changed now"
    new, current = updates["value"], handle._impl.value
    low, high = getattr(props, "min", None), getattr(props, "max", None)
    if not isinstance(current, tuple):
        options = getattr(props, "options", None)
        if options is not None and new not in options:
            return f"{_quoted(new)} is none of its options"
        return _problem_of_value(new, current, low, high)
    count = len(current)
    if not isinstance(new, list | tuple) or len(new) != count:
        return f"it takes {count} values"
    # Vectors have a range for each component, sliders of several handles one for all.
    lows = low if isinstance(low, tuple) else (low,) * count
    highs = high if isinstance(high, tuple) else (high,) * count
    problems = map(_problem_of_value, new, current, lows, highs)
    return next((problem for problem in problems if problem is not None), None)


def _problem_of_value(
    new: object, current: object, low: float | None, high: float | None
) -> str | None:
    """Why ``new`` may not replace ``current``, None if it may."""
    match current:
        case bool():
            return None if isinstance(new, bool) else f"{_quoted(new)} is neither true nor false"
        case str():
            if not isinstance(new, str):
                return f"{_quoted(new)} is no text"
            too_long = len(new) > _MAX_CHARACTERS
            return f"a text of more than {_MAX_CHARACTERS:,} characters" if too_long else None
        case int() | float():
            if isinstance(new, bool) or not isinstance(new, int | float) or not math.isfinite(new):
                return f"{_quoted(new)} is no number"
            if isinstance(current, int) and new != int(new):
                return f"{new:g} is no whole number"
            if low is not None and new < low - _RANGE_TOLERANCE:
                return f"{new:g} is less than {low:g}"
            if high is not None and new > high + _RANGE_TOLERANCE:
                return f"{new:g} is more than {high:g}"
            return None
    return "it cannot be changed"


def _quoted(value: object) -> str:
    """A value of any type, shortened to one line for a message."""
    if isinstance(value, str | bytes):
        return repr(value[:_MAX_QUOTED_CHARACTERS]) + (
            "…" if len(value) > _MAX_QUOTED_CHARACTERS else ""
        )
    return repr(value) if isinstance(value, int | float) else f"a value of {type(value).__name__}"
