"""Archives that the disk of temporary files has no room for."""

import gzip
import resource
from collections.abc import Iterator
from pathlib import Path

import pytest
import zstandard

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.archives import decompress_to_temporary_file, detect_compression
from fusion_core.recordings.rosbag2.compressed_storage import StorageFile

ROOM_BYTES = 300_000
# Below the size of a write's buffer beyond what there is room for: it is missed at the end alone.
CONTENTS = {"a piece": b"x" * 5_000_000, "the last bytes": b"x" * (ROOM_BYTES + 100)}


@pytest.fixture
def little_room() -> Iterator[None]:
    """No file grows beyond ROOM_BYTES."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM_BYTES, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("missing", CONTENTS)
def test_a_log_that_does_not_fit_is_named(tmp_path: Path, missing: str, little_room: None) -> None:
    path = tmp_path / "log.clf.gz"
    path.write_bytes(gzip.compress(CONTENTS[missing]))
    compression = detect_compression(path)
    assert compression is not None
    with pytest.raises(RecordingError, match=r"log\.clf\.gz: cannot be unpacked: File too large"):
        decompress_to_temporary_file(path, compression)


@pytest.mark.parametrize("missing", CONTENTS)
def test_a_storage_file_that_does_not_fit_is_named(
    tmp_path: Path, missing: str, little_room: None
) -> None:
    path = tmp_path / "drive.mcap.zstd"
    path.write_bytes(zstandard.ZstdCompressor().compress(CONTENTS[missing]))
    with pytest.raises(RecordingError, match=r"drive\.mcap\.zstd: cannot be unpacked: File too"):
        StorageFile(path)
