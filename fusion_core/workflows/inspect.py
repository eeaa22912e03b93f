"""What is inside a recording."""

from pathlib import Path
from typing import Any

from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.info import describe


def info(path: Path) -> dict[str, Any]:
    """Format, times, topics and warnings of a recording, ready for JSON.

    Raises RecordingError where the file cannot be read as a recording.
    """
    with open_recording(path) as recording:
        return describe(recording)
