"""A file name for each capture."""

import re

from fusion_core.model.labels import Capture

_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
# Some file systems end at 255 bytes.
_NAME_MAX = 100


class CaptureNames:
    """Gives each capture a relative path: a folder for its topic, and its stamp."""

    def __init__(self) -> None:
        self._folders: dict[str, str] = {}

    def name(self, capture: Capture, suffix: str) -> str:
        """Such as ``camera_depth/1700000000000000000.png``; of scans that repeat a stamp, from the
        second on, with their index."""
        folder = self._folders.get(capture.topic)
        if folder is None:
            folder = self._folders[capture.topic] = self._new_folder(capture.topic)
        repeated = f"_{capture.index}" if capture.index else ""
        return f"{folder}/{capture.stamp_ns}{repeated}{suffix}"

    def _new_folder(self, topic: str) -> str:
        safe = _UNSAFE.sub("_", topic)[:_NAME_MAX].strip("._-") or "topic"
        # Where letters of either case are one, two topics must not share a folder.
        taken = {folder.lower() for folder in self._folders.values()}
        name, number = safe, 2
        while name.lower() in taken:
            name, number = f"{safe}_{number}", number + 1
        return name
