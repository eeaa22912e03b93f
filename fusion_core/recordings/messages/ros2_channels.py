"""Conversion of channels to ROS 2: type, definition, and messages in CDR.

CDR messages are unchanged. ROS 1 messages are converted: types that exist in ROS 2 get its
definition, others keep their own with ROS 2's std_msgs/Header, which has no ``seq``.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import FieldDesc
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_typestore
from rosbags.typesys.store import Typestore

from fusion_core.model.conventions import NS_PER_S
from fusion_core.recordings.containers import Channel, Payload
from fusion_core.recordings.messages.types import UnreadableType, require_type_store

_ROS2 = get_typestore(Stores.ROS2_HUMBLE)
_ROS1_NAMES = {
    "tf/msg/tfMessage": "tf2_msgs/msg/TFMessage",
    "roslib/msg/Clock": "rosgraph_msgs/msg/Clock",
}
_HEADER = "std_msgs/msg/Header"
# The placeholder field of empty types in ROS 2, whose messages cannot be empty.
_NO_FIELDS = "uint8 structure_needs_at_least_one_member\n"
# Bytes of CDR before the first field, and before the first element of a sequence.
_ENCAPSULATION_BYTES = 4
_COUNT_BYTES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Channel:
    """A channel as written to a ROS 2 file.

    ``definition`` is empty if none is known. ``to_cdr`` converts a message to CDR and raises
    ValueError for bytes that do not fit the type. ``stamp_ns`` reads the sensor's stamp from CDR,
    None if the type or the message has none. ``note`` describes differences to the source type.
    """

    message_type: str
    definition: str
    definition_format: Literal["msg", "idl"] = "msg"
    to_cdr: Callable[[Payload], Payload]
    stamp_ns: Callable[[Payload], int | None]
    note: str = ""


def describe_ros2_channel(channel: Channel) -> Ros2Channel:
    """The channel as ROS 2. Raises UnreadableType if its messages cannot be converted to CDR."""
    if channel.serialization == "cdr":
        return _describe_cdr_channel(channel)
    return _describe_converted_channel(channel, _ros1_store(channel))


def _describe_cdr_channel(channel: Channel) -> Ros2Channel:
    name = channel.message_type
    if not name:
        raise UnreadableType("the file does not name the type of its messages")
    try:
        store = require_type_store(channel)
    except UnreadableType:
        # Pass the messages through: other tools may know the type.
        store = None
    definition = channel.definition
    if not definition and store is not None:
        definition = _definition(store, name)
    return Ros2Channel(
        message_type=name,
        definition=definition,
        definition_format=channel.definition_format,
        to_cdr=lambda payload: payload,
        stamp_ns=_no_stamp if store is None else _stamp_finder(store, name),
    )


def _ros1_store(channel: Channel) -> Typestore:
    try:
        return require_type_store(channel)
    except UnreadableType:
        if channel.serialization != "ros1" or channel.definition:
            raise
        # The definition of a type without fields is empty.
        return require_type_store(replace(channel, definition=_NO_FIELDS))


def _describe_converted_channel(channel: Channel, source: Typestore) -> Ros2Channel:
    old = channel.message_type
    new = _ROS1_NAMES.get(old, old)
    note = ""
    try:
        target = _with_types_of(source, get_typestore(Stores.ROS2_HUMBLE))
        rewrite: Callable[[Payload], Payload] = partial(target.ros1_to_cdr, typename=new)
        if not is_same_wireformat(source, target, old, new):
            if _is_extension(target, new, source, old):
                rewrite = _migration(source, target, old, new)
                note = f"{new} has fields in ROS 2 that ROS 1 lacks; they stay empty"
            else:
                target, new = _with_types_of(source, _header_store()), old
                rewrite = partial(target.ros1_to_cdr, typename=new)
                note = f"{new} is not what ROS 2 knows by this name; its own definition is kept"
        definition = _definition(target, new)
    except (TypesysError, KeyError, ValueError) as error:
        raise UnreadableType(f"the definition of {old} does not suit ROS 2 ({error})") from error
    return Ros2Channel(
        message_type=new,
        definition=definition,
        to_cdr=partial(_convert_checked, rewrite, old),
        stamp_ns=_stamp_finder(target, new),
        note=note,
    )


def _with_types_of(source: Typestore, store: Typestore) -> Typestore:
    """``store`` with those types of ``source`` that it lacks."""
    types = source.fielddefs.items()
    store.register({name: entry for name, entry in types if name not in store.fielddefs})
    return store


def _header_store() -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register({_HEADER: _ROS2.fielddefs[_HEADER]})
    return store


def _is_extension(target: Typestore, new: str, source: Typestore, old: str) -> bool:
    """Whether each field of the old type is in the new one, as it was or extended likewise.

    Names may differ in upper and lower case: ROS 1 has CameraInfo.K, ROS 2 has k.
    """
    fields = {label.lower(): field for label, field in target.fielddefs[new][1]}
    for label, field in source.fielddefs[old][1]:
        extended = fields.get(label.lower())
        if extended is None or extended[0] != field[0]:
            return False
        if field[0] == Nodetype.ARRAY and extended[1][1] != field[1][1]:
            return False
        (new_kind, new_part), (kind, part) = _element(extended), _element(field)
        if kind != new_kind:
            return False
        if kind != Nodetype.NAME:
            if part != new_part:
                return False
        elif part != _HEADER and not _is_extension(target, new_part, source, part):
            return False
    return True


def _element(field: FieldDesc) -> tuple[Nodetype, Any]:
    """Kind and type of a field, or of the elements if it is an array."""
    if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        kind, content = field[1][0]
        return Nodetype(kind), content
    return Nodetype(field[0]), field[1]


def _migration(
    source: Typestore, target: Typestore, old: str, new: str
) -> Callable[[Payload], Payload]:
    cache: dict[str, object] = {}

    def migrate(payload: Payload) -> Payload:
        return migrate_bytes(source, target, old, new, cache, payload, src_is2=False, dst_is2=True)

    return migrate


def _convert_checked(rewrite: Callable[[Payload], Payload], name: str, payload: Payload) -> Payload:
    try:
        return rewrite(payload)
    except (SerdeError, AssertionError, IndexError, struct.error) as error:
        problem = " ".join(str(error).split())
        raise ValueError(f"its bytes are no {name} ({problem})") from error


def _definition(store: Typestore, name: str) -> str:
    text, _ = store.generate_msgdef(name, ros_version=2)
    return text or _NO_FIELDS


def _stamp_finder(store: Typestore, name: str) -> Callable[[Payload], int | None]:
    """Returns a reader of the stamp, for types that begin with a header or a list of transforms."""
    fields: Any = store.fielddefs[name][1]
    if not fields:
        return _no_stamp
    _, (kind, content) = fields[0]
    if kind == Nodetype.NAME and content == _HEADER:
        return partial(_stamp_ns, _ENCAPSULATION_BYTES)
    if kind == Nodetype.SEQUENCE and content[0] == (
        Nodetype.NAME,
        "geometry_msgs/msg/TransformStamped",
    ):
        return _first_stamp_ns
    return _no_stamp


def _no_stamp(cdr: Payload) -> int | None:
    return None


def _first_stamp_ns(cdr: Payload) -> int | None:
    return _stamp_ns(_ENCAPSULATION_BYTES + _COUNT_BYTES, cdr)


def _stamp_ns(offset: int, cdr: Payload) -> int | None:
    """The stamp, 32-bit seconds and nanoseconds, at ``offset``; None if the message is shorter."""
    end = offset + 8
    if len(cdr) < end or cdr[0] != 0 or cdr[1] not in (0, 1):
        return None
    seconds, nanoseconds = struct.unpack_from("<iI" if cdr[1] else ">iI", cdr, offset)
    return int(seconds * NS_PER_S + nanoseconds)
