"""A CARMEN log with every kind of line."""

from collections.abc import Callable
from pathlib import Path

from tests.recordings import carmen_logs
from tests.recordings.samples.sample import Sample, Written


def build_carmen(file: Path, compress: Callable[[bytes], bytes] = bytes) -> Sample:
    text, given = carmen_logs.small_log()
    file.write_bytes(compress(text.encode()))
    return Sample(file, [Written(topic, value.received_ns, value) for topic, value in given])
