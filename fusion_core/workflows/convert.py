"""Any recording as one MCAP file of ROS 2 messages, for other tools to open."""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fusion_core.files.inputs import require_apart
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.errors import ExportError, RecordingError
from fusion_core.model.progress import Progress
from fusion_core.model.recording import Message, Recording, Role, Topic
from fusion_core.model.sensors import (
    DepthImage,
    PoseSample,
    SensorValue,
)
from fusion_core.recordings.indexed import IndexedRecording, SerializedMessage
from fusion_core.recordings.mcap.output import McapOutput
from fusion_core.recordings.messages.bad_message import BadMessage
from fusion_core.recordings.messages.ros2_channels import Ros2Channel, describe_ros2_channel
from fusion_core.recordings.messages.types import UnreadableType
from fusion_core.recordings.ros2_writer import Ros2McapWriter
from fusion_core.recordings.skipped import SkippedMessages
from fusion_core.recordings.topics import unknown_topic_error
from fusion_core.workflows.source import RoomChoice, input_files, open_source

# Messages between two reports of progress.
_PROGRESS_STEP = 100
_LAST_NS = (1 << 63) - 1

_Found = TypeVar("_Found", Message, SerializedMessage)


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertOptions:
    """What to convert: ``topics`` (all if empty) with ``start_s`` <= time < ``end_s``.

    Times count from the recording's first message; 0 <= ``start_s`` < ``end_s``. ``room`` is a room
    of a data set.
    """

    room: RoomChoice | None = None
    topics: Sequence[str] = ()
    start_s: float | None = None
    end_s: float | None = None
    overwrite: bool = False


def convert(
    path: Path, output: Path, options: ConvertOptions, progress: Progress
) -> dict[str, Any]:
    """Write the recording ``path`` to ``output`` (.mcap) and report what was written, as JSON.

    Messages in CDR keep their bytes, those of ROS 1 are rewritten in CDR, both whatever their
    type; the values of formats without messages become messages of their kind. Static transforms
    from before ``start_s`` are kept and logged at the start, as a recorder that was started there
    would have received them. A message or topic that cannot be converted is left out and named in
    the result.

    Raises ExportError where ``output`` is refused or cannot be written, RecordingError where the
    recording cannot be read or gives no message, MissingStream for an unknown topic.
    """
    _check_output(output, overwrite=options.overwrite)
    with open_source(path, options.room) as recording:
        require_apart(output, [path, *input_files(recording)])
        selection = _select(recording, options)
        account = _Account(selection, progress)
        if selection.first_ns < 0:
            first_s = selection.first_ns / NS_PER_S
            account.note(f"The log begins at {first_s:.3f} s; what is before 0 is logged at 0.")
        if isinstance(recording, IndexedRecording):
            _copy(recording, selection, output, account)
            unrelated = recording.unreadable_topic_warnings
        else:
            _write_values(recording, selection, output, account)
            unrelated = ()
        notes = [line for line in recording.warnings if line not in unrelated] + account.notes
        return {"file": str(output), "format": recording.format, **account.result(), "notes": notes}


def _check_output(output: Path, *, overwrite: bool) -> None:
    if output.suffix != ".mcap":
        raise ExportError("is no name for a recording.", file=output, advice="End it in .mcap.")
    if output.is_dir():
        raise ExportError("is a folder.", file=output, advice="Choose another name.")
    if output.exists() and not overwrite:
        raise ExportError("exists.", file=output, advice="Choose another name, or --overwrite.")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Selection:
    """The chosen topics, the range of log times, and how many messages of each topic these are.

    ``first_ns`` is the recording's first log time. ``latched`` topics give what was logged before
    ``start_ns`` too.
    """

    topics: tuple[Topic, ...]
    latched: frozenset[str]
    first_ns: int
    start_ns: int | None
    end_ns: int | None
    counts: dict[str, int]


def _select(recording: Recording, options: ConvertOptions) -> _Selection:
    known = {topic.name: topic for topic in recording.topics}
    for name in options.topics:
        if name not in known:
            raise unknown_topic_error(name, recording.topics, recording.path)
    topics = tuple(known[name] for name in sorted(set(options.topics) or known))
    times = {topic.name: recording.received_ns(topic.name) for topic in recording.topics}
    first_ns = min((int(own[0]) for own in times.values() if len(own)), default=0)
    start_ns, end_ns = (_time_ns(first_ns, bound) for bound in (options.start_s, options.end_s))
    last_ns = max((int(own[-1]) for own in times.values() if len(own)), default=first_ns)
    if start_ns is not None and start_ns > last_ns:
        raise RecordingError(
            f"ends {(last_ns - first_ns) / NS_PER_S:.3f} s after its first message.",
            file=recording.path,
            advice="Choose an earlier --start.",
        )
    latched = frozenset(topic.name for topic in topics if topic.role == "tf_static")
    counts = {}
    for topic in topics:
        first, last = 0, topic.count
        if start_ns is not None and topic.name not in latched:
            first = int(np.searchsorted(times[topic.name], start_ns))
        if end_ns is not None:
            last = int(np.searchsorted(times[topic.name], end_ns))
        counts[topic.name] = last - first
    return _Selection(
        topics=topics,
        latched=latched,
        first_ns=first_ns,
        start_ns=start_ns,
        end_ns=end_ns,
        counts=counts,
    )


def _time_ns(first_ns: int, after_s: float | None) -> int | None:
    if after_s is None:
        return None
    return min(first_ns + round(min(after_s * NS_PER_S, _LAST_NS)), _LAST_NS)


class _Account:
    """Counts of the selected messages: written, left out, and why."""

    def __init__(self, selection: _Selection, progress: Progress) -> None:
        self.notes: list[str] = []
        self._selection = selection
        self._progress = progress
        self._total = sum(selection.counts.values())
        self._done = 0
        self._seen = Counter[str]()
        self._written = Counter[str]()
        self._types: dict[str, list[str]] = defaultdict(list)
        self._reasons: dict[str, str] = {}
        self._span_ns: tuple[int, int] | None = None
        self._skipped = SkippedMessages(self.notes)

    def type(self, topic: str, message_type: str) -> None:
        """Messages of this type are written for a topic."""
        if message_type not in self._types[topic]:
            self._types[topic].append(message_type)

    def note(self, line: str) -> None:
        if line not in self.notes:
            self.notes.append(line)

    def skip(self, topic: str, reason: str) -> None:
        self._reasons[topic] = reason

    def written(self, topic: str, log_time_ns: int) -> None:
        self._count(topic)
        self._written[topic] += 1
        first, last = self._span_ns or (log_time_ns, log_time_ns)
        self._span_ns = min(first, log_time_ns), max(last, log_time_ns)

    def lost(self, topic: str, problem: str) -> None:
        count = self._selection.counts[topic]
        self._skipped.add(topic, self._seen[topic], count, RecordingError(problem))
        self._count(topic)

    def require_messages(self, path: Path) -> None:
        """Raise RecordingError where there was something to write and nothing was."""
        if self._span_ns is not None or not any(topic.count for topic in self._selection.topics):
            return
        reasons = [f"{topic}: {reason}." for topic, reason in self._reasons.items()] + self.notes
        if not any(self._selection.counts.values()):
            reasons = ["no message of the chosen topics was logged in that time."]
        raise RecordingError(
            f"gives nothing to write: {reasons[0] if reasons else 'no message can be read.'}",
            file=path,
            advice="Choose other topics or another time.",
        )

    def result(self) -> dict[str, Any]:
        """The topics written and skipped, in counts, and the first and last log time."""
        counts = self._selection.counts
        first_ns, last_ns = self._span_ns or (None, None)
        written = [topic for topic in self._selection.topics if topic.name not in self._reasons]
        return {
            "start_ns": first_ns,
            "end_ns": last_ns,
            "topics": [
                {
                    "name": topic.name,
                    "type": " and ".join(self._types[topic.name]) or topic.type,
                    "count": self._written[topic.name],
                    "left_out": counts[topic.name] - self._written[topic.name],
                }
                for topic in written
            ],
            "skipped": [
                {
                    "name": topic.name,
                    "type": topic.type,
                    "count": counts[topic.name],
                    "reason": self._reasons[topic.name],
                }
                for topic in self._selection.topics
                if topic.name in self._reasons
            ],
            "written": self._written.total(),
            "left_out": sum(counts.values()) - self._written.total(),
        }

    def _count(self, topic: str) -> None:
        self._seen[topic] += 1
        self._done += 1
        if self._done % _PROGRESS_STEP == 0:
            self._progress(self._done, self._total, "messages")


def _copy(
    recording: IndexedRecording, selection: _Selection, output: Path, account: _Account
) -> None:
    channels = _channels(recording, selection, account)
    names = {recording.channels[number].topic for number in channels}
    with McapOutput(output) as mcap:
        places = {
            number: mcap.channel(
                recording.channels[number].topic,
                channel.message_type,
                channel.definition,
                channel.definition_format,
            )
            for number, channel in channels.items()
        }
        for log_time_ns, message in _selected(recording.serialized_messages, names, selection):
            topic = recording.channels[message.channel].topic
            channel = channels.get(message.channel)
            try:
                if channel is None:
                    raise ValueError("it is of another type, which cannot be written")
                cdr = channel.to_cdr(message.payload)
            except ValueError as error:
                account.lost(topic, f"{error}.")
                continue
            published_ns = message.published_ns
            if published_ns is None:
                published_ns = channel.stamp_ns(cdr)
            if published_ns is None or published_ns < 0:
                published_ns = log_time_ns
            mcap.write(
                places[message.channel], cdr, log_time_ns=log_time_ns, publish_time_ns=published_ns
            )
            account.written(topic, log_time_ns)
        account.require_messages(recording.path)


def _channels(
    recording: IndexedRecording, selection: _Selection, account: _Account
) -> dict[int, Ros2Channel]:
    """The channels of the selected topics that can be written, by their number."""
    chosen = {topic.name for topic in selection.topics}
    channels: dict[int, Ros2Channel] = {}
    reasons: dict[str, str] = {}
    for number, channel in enumerate(recording.channels):
        if channel.topic not in chosen:
            continue
        try:
            channels[number] = describe_ros2_channel(channel)
        except UnreadableType as error:
            reasons[channel.topic] = str(error)
        else:
            account.type(channel.topic, channels[number].message_type)
            if channels[number].note:
                account.note(f"{channel.topic}: {channels[number].note}.")
    written = {recording.channels[number].topic for number in channels}
    for topic, reason in sorted(reasons.items()):
        if topic in written:
            account.note(f"{topic}: messages of one of its types are left out: {reason}.")
        else:
            account.skip(topic, reason)
    return channels


def _write_values(
    recording: Recording, selection: _Selection, output: Path, account: _Account
) -> None:
    if recording.stamps_are_nominal:
        account.note("The recording has no clock: its times count frames from 0.")
    roles = {topic.name: topic.role for topic in selection.topics}
    with Ros2McapWriter(output) as writer:
        for log_time_ns, message in _selected(recording.messages, roles, selection):
            value = replace(message.value, received_ns=log_time_ns)
            try:
                writer.write(message.topic, value, odometry=roles[message.topic] == "odometry")
            except BadMessage as error:
                account.lost(message.topic, f"{error}.")
                continue
            account.type(message.topic, writer.message_type(message.topic))
            for loss in _losses(message.topic, roles[message.topic], value):
                account.note(loss)
            account.written(message.topic, log_time_ns)
        account.require_messages(recording.path)


def _losses(topic: str, role: Role, value: SensorValue) -> Iterator[str]:
    """What of a value its message cannot hold."""
    if isinstance(value, DepthImage) and value.quantum_m is not None:
        yield f"{topic}: that depth comes in steps of {value.quantum_m:g} m is not in the file."
    if isinstance(value, PoseSample) and value.child and role != "odometry":
        yield f"{topic}: that the poses are those of {value.child} is not in the file."


def _selected(
    read: Callable[[Collection[str], int | None, int | None], Iterator[_Found]],
    topics: Collection[str],
    selection: _Selection,
) -> Iterator[tuple[int, _Found]]:
    """Log time and message, latched messages from before the start first."""
    start_ns, end_ns = selection.start_ns, selection.end_ns
    latched = [topic for topic in sorted(topics) if topic in selection.latched]
    if start_ns is not None:
        for message in read(latched, None, start_ns):
            yield max(start_ns, 0), message
    for message in read(sorted(topics), start_ns, end_ns):
        # Formats without a log have decoded messages, and those have a stamp.
        time_ns = message.stamp_ns if message.received_ns is None else message.received_ns
        yield max(time_ns, 0), message
