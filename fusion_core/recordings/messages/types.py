"""Message definitions to deserialisers, one store of types for each definition.

A store of its own for each definition keeps files apart that define the same name differently,
and lets a definition that does not parse cost its own topic alone.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from fusion_core.recordings.containers import Channel, Payload
from fusion_core.recordings.messages.type_limits import ExcessiveType, require_bounded_type
from fusion_core.recordings.rosbag1.transforms import is_ros1_tf, read_transforms
from fusion_core.recordings.rosbag2.transforms import is_ros2_tf, read_cdr_transforms

Deserializer = Callable[[Payload], Any]

# What serialised bytes may be read with, and the definitions for files that carry none.
_DEFAULT_STORES = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}
READABLE_ENCODINGS = frozenset(_DEFAULT_STORES)


class UnreadableType(ValueError):
    """Messages of this channel cannot be deserialised; the text says why."""


@lru_cache(maxsize=128)
def deserializer(channel: Channel) -> Deserializer:
    """A function from the channel's bytes to an object with the fields of its type.

    Raises UnreadableType here, and ValueError from the function for bytes that do not fit.
    """
    store = type_store(channel)
    name = channel.message_type
    if channel.serialization == "ros1" and is_ros1_tf(store, name):
        return read_transforms
    if channel.serialization == "cdr" and is_ros2_tf(store, name):
        return read_cdr_transforms
    read = store.deserialize_cdr if channel.serialization == "cdr" else store.deserialize_ros1

    def deserialize(payload: Payload) -> Any:
        try:
            # Of bytes, rosbags would copy all that is behind their first four.
            return read(memoryview(payload), name)
        except (SerdeError, AssertionError, IndexError) as error:
            problem = " ".join(str(error).split())
            raise ValueError(f"its bytes are no {name} ({problem})") from error

    return deserialize


def type_store(channel: Channel) -> Typestore:
    """The channel's type and all that it is made of. Raises UnreadableType."""
    if channel.serialization not in _DEFAULT_STORES:
        raise UnreadableType(f"its encoding {channel.serialization!r} is neither CDR nor ROS 1")
    name = channel.message_type
    if not channel.definition:
        store = get_typestore(_DEFAULT_STORES[channel.serialization])
        if name not in store.types:
            raise UnreadableType(f"the file has no definition of {name}")
        return store
    store = get_typestore(Stores.EMPTY)
    try:
        if channel.definition_format == "idl":
            store.register(get_types_from_idl(channel.definition))
        else:
            store.register(get_types_from_msg(channel.definition, name))
        require_bounded_type(store.fielddefs, name)
        store.get_msgdef(name)
    except ExcessiveType as error:
        raise UnreadableType(f"its definition is out of all bounds ({error})") from error
    except (TypesysError, KeyError, ValueError) as error:
        raise UnreadableType(f"the definition of {name} does not parse") from error
    return store
