"""Integrity check: reads a whole recording, and reports unreadable messages and damage."""

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import chain

from fusion_core.model.progress import Progress
from fusion_core.model.recording import Recording
from fusion_core.recordings.containers import ChecksumReport
from fusion_core.recordings.indexed import IndexedRecording

_PROGRESS_STEP = 100
_READING = "reading every message"


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicIntegrity:
    """The numbers of readable and unreadable messages of a topic.

    Messages of types that are not decoded are read as bytes.
    """

    name: str
    read: int
    unreadable: int


@dataclass(frozen=True, slots=True, kw_only=True)
class IntegrityReport:
    """``checksums``: how many were right. ``unguarded``: how many parts have no checksum.

    ``damage`` has a line for each defect other than unreadable messages.
    """

    topics: tuple[TopicIntegrity, ...]
    checksums: int
    unguarded: int
    damage: tuple[str, ...]

    @property
    def is_damaged(self) -> bool:
        return bool(self.damage) or any(topic.unreadable for topic in self.topics)


def check_integrity(recording: Recording, progress: Progress) -> IntegrityReport:
    """Read and decode every message once, and verify all checksums.

    Messages that fail are named in the recording's ``warnings``, one line for each topic.
    """
    verified = ChecksumReport()
    damage = []
    undecoded = {topic.name for topic in recording.topics if topic.role == "other"}
    if isinstance(recording, IndexedRecording):
        damage += [
            line for line in recording.warnings if line not in recording.unreadable_topic_warnings
        ]
        verified = recording.verify()
        damage += verified.damage
    total = sum(topic.count for topic in recording.topics)
    read = Counter[str]()
    progress(0, total, _READING)
    decoded = [topic.name for topic in recording.topics if topic.name not in undecoded]
    names: Iterator[str] = (message.topic for message in recording.messages(decoded))
    if isinstance(recording, IndexedRecording):
        names = chain(names, _iterate_undecoded_topics(recording, undecoded))
        undecoded = set()
    for done, name in enumerate(names, 1):
        read[name] += 1
        if done % _PROGRESS_STEP == 0:
            progress(done, total, _READING)
    progress(total, total, _READING)
    return IntegrityReport(
        topics=tuple(
            TopicIntegrity(
                name=topic.name,
                read=read[topic.name],
                unreadable=0 if topic.name in undecoded else topic.count - read[topic.name],
            )
            for topic in recording.topics
        ),
        checksums=verified.checksums,
        unguarded=verified.unguarded,
        damage=tuple(damage),
    )


def _iterate_undecoded_topics(
    recording: IndexedRecording, topics: Collection[str]
) -> Iterator[str]:
    for message in recording.serialized_messages(topics):
        yield recording.channels[message.channel].topic
