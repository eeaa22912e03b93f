"""The contract of every reader, tested on every format."""

import hashlib
import json
import os
import random
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fusion_core.model.errors import MissingStream, RecordingError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.info import describe_recording


def clocks(messages: Any, has_log: bool) -> list[tuple[str, int | None, int]]:
    return [(m.topic, m.received_ns if has_log else None, m.stamp_ns) for m in messages]


def digest(path: Path) -> dict[str, tuple[str, int]]:
    files = [path] if path.is_file() else sorted(path.rglob("*"))
    # The folder around a lone file too: nothing may be left beside it.
    files += sorted(path.parent.iterdir())
    return {
        str(file): (hashlib.sha256(file.read_bytes()).hexdigest(), file.stat().st_mtime_ns)
        for file in files
        if file.is_file()
    }


def test_order_clocks_and_values(sample: Any, same_value: Callable[[Any, Any], bool]) -> None:
    with open_recording(sample.path) as recording:
        found = list(recording.messages())
        assert len(recording.warnings) == len(sample.warnings)
        for warning, said in zip(recording.warnings, sample.warnings, strict=True):
            assert said in warning
    assert clocks(found, sample.has_log) == clocks(sample.expected, sample.has_log)
    for message, written in zip(found, sample.expected, strict=True):
        assert same_value(message.value, written.value), (message, written)


def test_index_counts_within_topic(sample: Any) -> None:
    with open_recording(sample.path) as recording:
        for topic in recording.topics:
            indexes = [m.index for m in recording.messages([topic.name])]
            assert indexes == list(range(topic.count))


def test_topics_and_types(sample: Any) -> None:
    with open_recording(sample.path) as recording:
        counts = {topic.name: topic.count for topic in recording.topics}
        types = {topic.name: topic.type for topic in recording.topics}
    written = [m.topic for m in sample.written]
    assert counts == {name: written.count(name) for name in written}
    if sample.types:
        assert types == sample.types


def test_log_times(sample: Any) -> None:
    with open_recording(sample.path) as recording:
        for topic in recording.topics:
            expected = [m.received_ns for m in sample.expected if m.topic == topic.name]
            found = recording.received_ns(topic.name)
            assert found.dtype == np.int64
            assert found.tolist() == expected
        times = [m.received_ns for m in sample.expected]
        span = (times[0], times[-1]) if not sample.nominal else (None, None)
        assert (recording.start_ns, recording.end_ns) == span
        assert recording.stamps_are_nominal is sample.nominal


def test_ranges_are_half_open(sample: Any) -> None:
    times = sorted({m.received_ns for m in sample.written})
    bounds = [None, times[0] - 1, *times[:: max(1, len(times) // 5)], times[-1], times[-1] + 1]
    topics = sorted({m.topic for m in sample.written})[:2]
    with open_recording(sample.path) as recording:
        for start in bounds:
            for end in bounds:
                found = recording.messages(topics, start, end)
                expected = [
                    m
                    for m in sample.expected
                    if m.topic in topics
                    and (start is None or m.received_ns >= start)
                    and (end is None or m.received_ns < end)
                ]
                assert clocks(found, sample.has_log) == clocks(expected, sample.has_log)


def test_index_within_a_range_is_that_of_the_topic(sample: Any) -> None:
    middle = sample.expected[len(sample.expected) // 2].received_ns
    with open_recording(sample.path) as recording:
        whole = {(m.topic, m.index): m.stamp_ns for m in recording.messages()}
        for m in recording.messages(start_ns=middle):
            assert whole[m.topic, m.index] == m.stamp_ns


def test_random_access_equals_iteration(
    sample: Any, same_value: Callable[[Any, Any], bool]
) -> None:
    with open_recording(sample.path) as recording:
        iterated = list(recording.messages())
        random.Random(7).shuffle(iterated)
        for message in iterated:
            assert same_value(recording.read(message.topic, message.index), message)


def test_index_beyond_the_count(sample: Any) -> None:
    with open_recording(sample.path) as recording:
        topic = recording.topics[0]
        for index in (-1, topic.count):
            with pytest.raises(IndexError, match=str(topic.count)):
                recording.read(topic.name, index)


def test_unknown_topic_lists_what_there_is(sample: Any) -> None:
    with open_recording(sample.path) as recording:
        there = recording.topics[-1].name
        for read in (
            lambda: recording.read("/nothing", 0),
            lambda: recording.messages(["/nothing"]),
            lambda: recording.received_ns("/nothing"),
        ):
            with pytest.raises(MissingStream, match=there):
                read()


def test_static_transforms_before_seeking(sample: Any) -> None:
    with open_recording(sample.path) as recording:
        if "/tf_static" not in {topic.name for topic in recording.topics}:
            pytest.skip("the format has no transforms")
        late = recording.messages(start_ns=sample.expected[-1].received_ns)
        first = next(late)
        static = list(recording.messages(["/tf_static"]))
        assert len(static) == 1
        written = next(m for m in sample.expected if m.topic == "/tf_static")
        assert static[0].value.transforms[0].child == written.value.transforms[0].child
        times = recording.received_ns(first.topic)
        assert times[first.index] == sample.expected[-1].received_ns


def test_a_closed_recording_cannot_be_read(sample: Any) -> None:
    recording = open_recording(sample.path)
    topic = recording.topics[0].name
    running = recording.messages()
    next(running)
    recording.close()
    recording.close()
    with pytest.raises(RecordingError, match="closed"):
        recording.read(topic, 0)
    with pytest.raises(RecordingError, match="closed"):
        recording.messages()
    with pytest.raises(RecordingError, match="closed"):
        recording.received_ns(topic)
    with pytest.raises(RecordingError, match="closed"):
        next(running)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs the list of open files")
def test_closing_frees_the_files(sample: Any) -> None:
    before = len(os.listdir("/proc/self/fd"))  # noqa: PTH208  # The listing itself opens one.
    with open_recording(sample.path) as recording:
        next(recording.messages())
    assert len(os.listdir("/proc/self/fd")) == before  # noqa: PTH208


def test_two_readers_at_once(sample: Any) -> None:
    expected = clocks(sample.expected, sample.has_log)
    with open_recording(sample.path) as first, open_recording(sample.path) as second:
        iterators = [first.messages(), first.messages(), second.messages()]
        taken: list[list[Any]] = [[], [], []]
        for _ in expected:
            for messages, kept in zip(iterators, taken, strict=True):
                kept.append(next(messages))
    assert [clocks(kept, sample.has_log) for kept in taken] == [expected] * 3


def test_threads_share_a_recording(sample: Any) -> None:
    expected = clocks(sample.expected, sample.has_log)
    results: list[list[Any]] = []
    with open_recording(sample.path) as recording:
        threads = [
            threading.Thread(target=lambda: results.append(list(recording.messages())))
            for _ in range(4)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert [clocks(found, sample.has_log) for found in results] == [expected] * 4


def test_the_file_is_unchanged(sample: Any) -> None:
    before = digest(sample.path)
    with open_recording(sample.path) as recording:
        describe_recording(recording)
        list(recording.messages())
    assert digest(sample.path) == before


def test_description_is_plain_json(sample: Any) -> None:
    with open_recording(sample.path) as recording:
        description = json.loads(json.dumps(describe_recording(recording), allow_nan=False))
    assert list(description) == [
        "format",
        "start_ns",
        "end_ns",
        "duration_s",
        "topics",
        "can",
        "warnings",
    ]
    assert {tuple(topic) for topic in description["topics"]} == {
        ("name", "type", "role", "count", "rate_hz")
    }
    assert (description["start_ns"] is None) is sample.nominal
    assert description["can"]
