"""Deserialisers from message definitions, with a separate type store for each definition.

So files may define the same name differently, and a definition that does not parse affects its
own topic only.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
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
from fusion_core.recordings.messages import cdr_rows, ros1_rows
from fusion_core.recordings.messages.type_limits import ExcessiveType, require_bounded_type

Deserializer = Callable[[Payload], Any]

# Supported serialisations, and the definitions used for files without any.
_DEFAULT_STORES = {"cdr": Stores.ROS2_HUMBLE, "ros1": Stores.ROS1_NOETIC}
READABLE_ENCODINGS = frozenset(_DEFAULT_STORES)
# Bags from before 2011 have the header in the package roslib, from which REP 100 moved it. In a
# field without a package, "Header header", it is the same type by either name.
_OLD_HEADER = re.compile(r"\broslib/(?:msg/)?Header\b")
_HEADER = "std_msgs/Header"


class UnreadableType(ValueError):
    """Messages of this channel cannot be deserialised; the message says why."""


def find_deserializer(channel: Channel) -> Deserializer:
    """A function from a message's bytes to an object with the fields of its type, or to its row.

    Raises UnreadableType; the returned function raises ValueError for bytes that do not fit.
    """
    return find_type_deserializer(replace(channel, topic=""))


@lru_cache(maxsize=128)
def find_type_deserializer(channel: Channel) -> Deserializer:
    """``find_deserializer``, cached for all channels that differ only in their topics."""
    store = _type_store(channel)
    name = channel.message_type
    row_reader = _find_row_reader(store, name, channel.serialization)
    if row_reader is not None:
        return row_reader
    _require_code(store, name)
    read = store.deserialize_cdr if channel.serialization == "cdr" else store.deserialize_ros1

    def deserialize(payload: Payload) -> Any:
        try:
            # Given bytes, rosbags would copy everything after the first four.
            return read(memoryview(payload), name)
        except (SerdeError, AssertionError, IndexError) as error:
            problem = " ".join(str(error).split())
            raise ValueError(f"its bytes are no {name} ({problem})") from error

    return deserialize


def _find_row_reader(store: Typestore, name: str, serialization: str) -> Deserializer | None:
    """The row reader for a type whose definition has the standard layout of ROS; else None."""
    is_ros1 = serialization == "ros1"
    readers: Mapping[tuple[str, str], Deserializer]
    readers = ros1_rows.READERS if is_ros1 else cdr_rows.READERS
    if not any(name == known for known, _ in readers):
        return None
    layout = store.generate_msgdef(name)[1] if is_ros1 else store.hash_rihs01(name)
    return readers.get((name, layout))


def ros1_checksum(channel: Channel) -> str:
    """The MD5 sum that identifies the channel's type in ROS 1. Raises UnreadableType."""
    try:
        return _type_store(channel).generate_msgdef(channel.message_type)[1]
    except (TypesysError, KeyError, ValueError) as error:
        raise UnreadableType(f"the definition of {channel.message_type} does not parse") from error


def require_type_store(channel: Channel) -> Typestore:
    """The channel's type with all nested types. Raises UnreadableType."""
    store = _type_store(channel)
    _require_code(store, channel.message_type)
    return store


def _type_store(channel: Channel) -> Typestore:
    return _store_of_type(replace(channel, topic=""))


@lru_cache(maxsize=128)
def _store_of_type(channel: Channel) -> Typestore:
    """``_type_store``, cached for all channels that differ only in their topics: code is generated
    once, however many recordings have the type. The store is shared: nothing is added to it."""
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
            store.register(get_types_from_msg(_OLD_HEADER.sub(_HEADER, channel.definition), name))
        require_bounded_type(store.fielddefs, name)
    except ExcessiveType as error:
        raise UnreadableType(f"its definition is out of all bounds ({error})") from error
    except (TypesysError, KeyError, ValueError) as error:
        raise UnreadableType(f"the definition of {name} does not parse") from error
    return store


def _require_code(store: Typestore, name: str) -> None:
    """Generate the store's reader of the type. Raises UnreadableType if that fails."""
    try:
        store.get_msgdef(name)
    except (TypesysError, KeyError, ValueError) as error:
        raise UnreadableType(f"the definition of {name} does not parse") from error
