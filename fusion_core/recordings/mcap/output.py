"""Writer of one MCAP file of ROS 2 messages, which appears complete or not at all."""

from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from mcap.writer import CompressionType, Writer

from fusion_core.files.atomic import AtomicFile, cannot_write
from fusion_core.model.errors import ExportError
from fusion_core.recordings.containers import Payload

_CHUNK_BYTES = 1 << 20
# The format counts channels in 16 bits, and 0 is none.
_MAX_CHANNELS = (1 << 16) - 1
# Schema encodings by the format of a definition; without a definition there is no encoding.
_ENCODINGS = {"msg": "ros2msg", "idl": "ros2idl"}
# A late subscriber must still get /tf_static (QoS durability "transient local", depth 1).
_LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    "  deadline:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  liveliness: 1\n"
    "  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n"
    "  avoid_ros_namespace_conventions: false"
)


class McapOutput:
    """Profile ros2, zstd chunks, an index, and the message definitions.

    The file appears under its name when ``close`` (or the ``with`` block) ends well, and then
    replaces what was there; after an error nothing is left behind. The same calls give the same
    bytes. Raises ExportError where the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._channels: dict[tuple[str, str, str, str], int] = {}
        self._schemas: dict[tuple[str, str, str], int] = {}
        self._making = AtomicFile(path)
        self._file = self._making.temporary.open("wb")
        self._open = True
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._call(self._writer.start, profile="ros2", library="scanloom")

    def channel(
        self,
        topic: str,
        message_type: str,
        definition: str,
        definition_format: Literal["msg", "idl"] = "msg",
    ) -> int:
        """The number of a channel of CDR messages; the same arguments give the same channel.

        An empty ``definition`` means that none is known.
        """
        encoding = _ENCODINGS[definition_format] if definition else ""
        schema = (message_type, encoding, definition)
        if (topic, *schema) not in self._channels:
            if len(self._channels) == _MAX_CHANNELS:
                raise ExportError(
                    f"cannot hold more than {_MAX_CHANNELS} channels.",
                    file=self.path,
                    advice="Write fewer topics.",
                )
            if schema not in self._schemas:
                self._schemas[schema] = self._call(
                    self._writer.register_schema, message_type, encoding, definition.encode()
                )
            latched = {"offered_qos_profiles": _LATCHED} if topic == "/tf_static" else {}
            self._channels[topic, *schema] = self._call(
                self._writer.register_channel, topic, "cdr", self._schemas[schema], latched
            )
        return self._channels[topic, *schema]

    def write(self, channel: int, data: Payload, *, log_time_ns: int, publish_time_ns: int) -> None:
        """Write a message; times are 0 or more."""
        self._call(
            self._writer.add_message,
            channel,
            log_time=log_time_ns,
            publish_time=publish_time_ns,
            data=bytes(data),
        )

    def close(self) -> None:
        """Finish the file and give it its name."""
        if self._open:
            self._call(self._publish)
            self._open = False
            self._making.close()

    def abort(self) -> None:
        """Leave nothing behind."""
        if self._open:
            self._open = False
            # The file is discarded in any case.
            with suppress(OSError):
                self._file.close()
            self._making.close()

    def __enter__(self) -> "McapOutput":
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def _publish(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
        self._file.close()
        self._making.publish()

    def _call(self, write: Any, *args: Any, **kwargs: Any) -> Any:
        """Call the writer: any call may write a chunk to disk, and fail with an OSError."""
        if not self._open:
            raise ValueError(f"{self.path} is closed")
        try:
            return write(*args, **kwargs)
        except OSError as error:
            self.abort()
            raise cannot_write(self.path, error) from error
        except ExportError:
            self.abort()
            raise
