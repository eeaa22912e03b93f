"""rosbag2 folders compressed by file and by message, as rosbags writes them."""

import shutil
import sqlite3
import tempfile
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.rosbag2 import compressed_storage
from fusion_core.recordings.rosbag2.compressed_storage import StorageFile
from fusion_core.recordings.rosbag2.storage import is_rosbag2_folder

PACKED = [f"rosbag2 {s} packed by {m}" for s in ("sqlite3", "mcap") for m in ("file", "message")]


@pytest.fixture(autouse=True)
def temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where files are unpacked to."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def same_messages(path: Path, sample: Any, same_value: Callable[[Any, Any], bool]) -> None:
    with open_recording(path) as recording:
        found = list(recording.messages())
        assert recording.warnings == []
        assert [(m.topic, m.received_ns, m.stamp_ns) for m in found] == [
            (m.topic, m.received_ns, m.stamp_ns) for m in sample.expected
        ]
        for message, written in zip(found, sample.expected, strict=True):
            assert same_value(message.value, written.value)
            assert same_value(recording.read(message.topic, message.index), message)


@pytest.mark.parametrize("name", PACKED)
def test_without_metadata(build: Any, same_value: Any, name: str) -> None:
    sample = build(name)
    (sample.path / "metadata.yaml").unlink()
    same_messages(sample.path, sample, same_value)


@pytest.mark.parametrize("name", PACKED)
def test_lone_files(build: Any, same_value: Any, name: str) -> None:
    sample = build(name)
    (file,) = (f for f in sample.path.iterdir() if f.name != "metadata.yaml")
    assert file.suffix == ".zstd" or "message" in name
    renamed = file.rename(sample.path.parent / "recording")
    same_messages(renamed, sample, same_value)


def test_nothing_is_left_in_the_temporary_folder(build: Any, temporary_files: Path) -> None:
    path = build("rosbag2 sqlite3 packed by file").path
    with open_recording(path) as recording:
        assert list(temporary_files.iterdir()) == []
        assert len(list(recording.messages())) > 0
    (path / next(path.glob("*.zstd")).name).write_bytes(b"\x28\xb5\x2f\xfd" + bytes(20))
    with pytest.raises(RecordingError):
        open_recording(path)
    assert list(temporary_files.iterdir()) == []


def pack(content: bytes, packing: str) -> bytes:
    if packing == "lz4":
        return bytes(lz4.frame.compress(content))
    if packing == "zstd in frames":
        middle = len(content) // 2
        parts = content[:middle], content[middle:]
        return b"".join(zstandard.ZstdCompressor().compress(part) for part in parts)
    # A frame that does not say how long it is.
    return zstandard.ZstdCompressor(write_content_size=False).compress(content)


@pytest.mark.parametrize("suffix", ["", ".zst", ".odd"])
@pytest.mark.parametrize("packing", ["lz4", "zstd in frames", "zstd without size"])
def test_compression_formats(
    build: Callable[[str], Any], same_value: Any, packing: str, suffix: str
) -> None:
    sample = build("rosbag2 sqlite, no metadata")
    (file,) = sample.path.iterdir()
    packed = file.with_name(file.name + suffix)
    packed.write_bytes(pack(file.read_bytes(), packing))
    if packed != file:
        file.unlink()
    same_messages(packed, sample, same_value)
    if suffix != ".odd":
        same_messages(sample.path, sample, same_value)


def test_a_decompressed_part_beside_the_compressed_one_is_read_once(
    build: Any, same_value: Any
) -> None:
    sample = build("rosbag2 sqlite3 packed by file")
    (file,) = sample.path.glob("*.zstd")
    # rosbags' frame does not say how long it is.
    content = zstandard.ZstdDecompressor().decompressobj().decompress(file.read_bytes())
    file.with_suffix("").write_bytes(content)
    same_messages(sample.path, sample, same_value)


@pytest.mark.parametrize("fraction", [0.001, 0.3, 0.5, 0.99])
def test_a_truncated_compressed_part(tmp_path: Path, fraction: float) -> None:
    # Noise, so that a fraction of the packed bytes is that fraction of the rows.
    file = tmp_path / "a_0.db3"
    rng = np.random.default_rng(1)
    write_messages(file, [rng.bytes(3000) for _ in range(500)])
    packed = zstandard.ZstdCompressor().compress(file.read_bytes())
    file.unlink()
    (tmp_path / "a_0.db3.zstd").write_bytes(packed[: int(fraction * len(packed))])
    if fraction < 0.1:
        # zstd packs 128 KiB at a time.
        with pytest.raises(RecordingError, match="0 bytes could be unpacked"):
            StorageFile(tmp_path / "a_0.db3.zstd")
        return
    with closing(StorageFile(tmp_path / "a_0.db3.zstd")) as storage:
        assert len(storage.index()) / 500 >= fraction - 0.1
        assert "a_0.db3.zstd is cut short or damaged: " in storage.warnings[0]
        assert "bytes could be unpacked" in storage.warnings[0]
        assert "a_0.db3.zstd: it is cut short: " in storage.warnings[1]


def test_a_damaged_part_loses_only_its_own_messages(build: Any) -> None:
    sample = build("rosbag2 mcap packed by file")
    path = sample.path
    (path / "metadata.yaml").unlink()
    (file,) = path.iterdir()
    whole = file.rename(path / "part_0.mcap.zstd")
    (path / "part_1.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd" + bytes(20))
    (path / "part_2.mcap.zstd").write_bytes(whole.read_bytes())
    with open_recording(path) as recording:
        assert len(list(recording.messages())) == 2 * len(sample.written)
        assert any(w.startswith("part_1.mcap.zstd is left out: ") for w in recording.warnings)


def test_a_decompression_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compressed_storage, "_ALWAYS_DECOMPRESSED_BYTES", 8 << 20)
    content = b"SQLite format 3\0" + bytes(64 << 20)
    (tmp_path / "a_0.db3.zstd").write_bytes(zstandard.ZstdCompressor().compress(content))
    with pytest.raises(RecordingError, match="unpacks to more than 8388608 bytes"):
        open_recording(tmp_path / "a_0.db3.zstd")


def test_a_full_disk(build: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    path = build("rosbag2 sqlite3 packed by file").path
    usage = shutil.disk_usage(path)._replace(free=(256 << 20) + 100)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(RecordingError, match="more than the 100 bytes that are free") as caught:
        open_recording(path)
    assert "TMPDIR" in caught.value.advice


def test_an_archive_of_something_else(tmp_path: Path) -> None:
    for name in ("cloud.zst", "cloud"):
        file = tmp_path / name
        file.write_bytes(zstandard.ZstdCompressor().compress(b"text" * 100))
        with pytest.raises(RecordingError, match="holds no storage file"):
            open_recording(file)
    assert not is_rosbag2_folder(tmp_path)


def write_messages(path: Path, payloads: list[bytes]) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format)"
        )
        connection.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)"
        )
        connection.execute("INSERT INTO topics VALUES (1, '/a', 'std_msgs/msg/String', 'cdr')")
        connection.executemany(
            "INSERT INTO messages VALUES (?, 1, 0, ?)", list(enumerate(payloads, 1))
        )
        connection.commit()


def test_messages_are_decompressed_within_bounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compressed_storage, "MAX_CHUNK_BYTES", 3 << 20)
    fits, long = bytes(range(256)) * (3 << 12), bytes((3 << 20) + 1)
    with_size = zstandard.ZstdCompressor()
    without = zstandard.ZstdCompressor(write_content_size=False)
    path = tmp_path / "a.db3"
    write_messages(
        path,
        [
            with_size.compress(fits),
            without.compress(fits),
            with_size.compress(long),
            without.compress(long),
            without.compress(fits)[:-10],
            b"\x28\xb5\x2f\xfd" + b"\xff" * 20,
            b"\0\1\0\0plain",
        ],
    )
    with closing(StorageFile(path)) as file:
        file.index()
        assert bytes(file.payload(0, 1)) == fits
        assert bytes(file.payload(0, 2)) == fits
        for row, said in (
            (3, "unpacks to more"),
            (4, "unpacks to more"),
            (5, "end"),
            (6, "message"),
        ):
            with pytest.raises(RecordingError, match=said) as caught:
                file.payload(0, row)
            assert "\n" not in str(caught.value)
            assert str(path) in str(caught.value)
        assert bytes(file.payload(0, 7)) == b"\0\1\0\0plain"


def test_a_message_that_is_a_bomb_takes_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compressed_storage, "MAX_CHUNK_BYTES", 3 << 20)
    bomb = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(64 << 20))
    path = tmp_path / "a.db3"
    write_messages(path, [bomb])
    with closing(StorageFile(path)) as file:
        file.index()
        tracemalloc.start()
        with pytest.raises(RecordingError, match="unpacks to more"):
            file.payload(0, 1)
        _, peak_bytes = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert peak_bytes < 16 << 20
