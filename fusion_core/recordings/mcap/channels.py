"""The channels of an MCAP file, from its schema and channel records."""

import struct
from dataclasses import replace
from io import BytesIO
from typing import TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel as ChannelRecord
from mcap.records import Schema

from fusion_core.recordings.containers import Channel, ros2_type_name

DEFINING = (Opcode.SCHEMA, Opcode.CHANNEL)

_ROS_SCHEMAS = ("ros1msg", "ros2msg", "ros2idl", "omgidl")
_MAX_CHANNELS = 4096
_MAX_NAME_BYTES = 1024
# A channel's record holds the quality of service of every publisher besides its names.
_MAX_RECORD_BYTES = 1 << 20

_Definition = TypeVar("_Definition", Schema, ChannelRecord)


class McapChannels:
    """Channels in the order in which the file names them, each once.

    The summary repeats the definitions, and damaged chunks may still contain some. Such records are
    kept as fallbacks, used where a definition is not found elsewhere.
    """

    def __init__(self) -> None:
        self.channels: list[Channel] = []
        self._numbers: dict[int, int] = {}
        self._schemas: dict[int, Schema] = {}
        self._fallback_schemas: dict[int, Schema] = {}
        self._fallback_channels: dict[int, ChannelRecord] = {}

    def define(self, opcode: int, content: bytes) -> None:
        """Add a schema or a channel. Raises ValueError for one that cannot be read."""
        record = _parse(opcode, content)
        if isinstance(record, Schema):
            if len(self._schemas) == _MAX_CHANNELS:
                raise ValueError(f"there are more than {_MAX_CHANNELS} schemas")
            self._schemas[record.id] = record
        elif len(self.channels) == _MAX_CHANNELS:
            raise ValueError(f"there are more than {_MAX_CHANNELS} channels")
        else:
            self._add(record)

    def define_fallback(self, opcode: int, content: bytes) -> None:
        """Add a schema or a channel as a fallback. Raises ValueError as ``define``."""
        record = _parse(opcode, content)
        if max(len(self._fallback_schemas), len(self._fallback_channels)) == _MAX_CHANNELS:
            raise ValueError(f"there are more than {_MAX_CHANNELS} channels")
        if isinstance(record, Schema):
            self._fallback_schemas.setdefault(record.id, record)
        else:
            self._fallback_channels.setdefault(record.id, record)

    def contradicts(self, opcode: int, content: bytes) -> bool:
        """Whether a schema or a channel differs from the fallback with its number.

        A channel's metadata (its publishers) may differ: a writer can complete it at the end.
        """
        try:
            record = _parse(opcode, content)
        except ValueError:
            return False
        if isinstance(record, Schema):
            return self._fallback_schemas.get(record.id, record) != record
        fallback = self._fallback_channels.get(record.id, record)
        return replace(fallback, metadata={}) != replace(record, metadata={})

    def add_fallbacks(self) -> None:
        """Add the fallback channels, of which some may have no message."""
        for channel_id in self._fallback_channels:
            self.channel_number(channel_id)

    def channel_number(self, channel_id: int) -> int | None:
        """The place of a channel in ``channels``, None where no record defines it."""
        is_final = channel_id in self._numbers or len(self.channels) == _MAX_CHANNELS
        if not is_final and channel_id in self._fallback_channels:
            self._add(self._fallback_channels[channel_id])
        return self._numbers.get(channel_id)

    def _add(self, record: ChannelRecord) -> None:
        if record.id in self._numbers:
            return
        schema = self._schemas.get(record.schema_id, self._fallback_schemas.get(record.schema_id))
        readable = schema is not None and schema.encoding in _ROS_SCHEMAS
        name = "" if schema is None else schema.name
        self._numbers[record.id] = len(self.channels)
        self.channels.append(
            Channel(
                topic=record.topic,
                message_type=ros2_type_name(name) if readable else name,
                serialization=record.message_encoding,
                definition=schema.data.decode(errors="replace") if schema and readable else "",
                definition_format="idl" if schema and schema.encoding.endswith("idl") else "msg",
            )
        )


def _parse(opcode: int, content: bytes) -> Schema | ChannelRecord:
    if len(content) > _MAX_RECORD_BYTES:
        raise ValueError(f"it is of {len(content)} bytes")
    stream = ReadDataStream(BytesIO(content))
    try:
        if opcode == Opcode.SCHEMA:
            schema: Schema = Schema.read(stream)
            return _require_sane_names(schema, schema.name, schema.encoding)
        channel: ChannelRecord = ChannelRecord.read(stream)
        return _require_sane_names(channel, channel.topic, channel.message_encoding)
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise ValueError("its fields are damaged") from error


def _require_sane_names(record: _Definition, *names: str) -> _Definition:
    for name in names:
        if len(name.encode()) > _MAX_NAME_BYTES or not name.isprintable():
            raise ValueError("its name is too long or has control characters")
    return record
