"""Files with a recording's name that no batch can read."""

from pathlib import Path

MCAP_MAGIC = b"\x89MCAP0\r\n"


def unreadable_files(recording: Path) -> dict[str, bytes]:
    """Their contents by name. ``recording``: an MCAP file, of which one is the beginning."""
    # A chunk that claims to hold four exabytes.
    huge = (1 << 62).to_bytes(8, "little")
    bomb = MCAP_MAGIC + b"\x06" + huge + bytes(16) + huge + bytes(4) + b"\x04\0\0\0zstd" + huge
    return {
        "truncated.mcap": recording.read_bytes()[:60],
        "empty.bag": b"",
        "wrong_bytes.db3": bytes(range(256)) * 40,
        "bomb.mcap": bomb,
    }
