"""ScanLoom: a 2D LiDAR aligned with the rows of a depth image.

    import scanloom

    room = scanloom.fuse("furnished_room.mcap")
    room.mount.yaw_rad
    room.frames.column("score").to_numpy()
    room.maps["fused"].to_numpy()

``open``, ``info``, ``fuse``, ``build_map`` and ``match_scans`` do what the commands of the same
names do; ``load`` reads a folder of results that a command wrote. Failures raise
``ScanLoomError`` with the file and advice.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fusion_core.model.errors import ScanLoomError
    from fusion_core.workflows.fuse.session import FuseOptions
    from fusion_core.workflows.map.options import MapOptions
    from fusion_core.workflows.source import RoomChoice
    from scanloom.api import (
        FuseResult,
        MapResult,
        RecordingInfo,
        build_map,
        fuse,
        info,
        load,
        match_scans,
        open,
    )

__all__ = [
    "FuseOptions",
    "FuseResult",
    "MapOptions",
    "MapResult",
    "RecordingInfo",
    "RoomChoice",
    "ScanLoomError",
    "build_map",
    "fuse",
    "info",
    "load",
    "match_scans",
    "open",
]

_MODULE_OF = {
    "FuseOptions": "fusion_core.workflows.fuse.session",
    "MapOptions": "fusion_core.workflows.map.options",
    "RoomChoice": "fusion_core.workflows.source",
    "ScanLoomError": "fusion_core.model.errors",
}


def __getattr__(name: str) -> Any:
    """Import a name on first access: the command line is a part of this
    package, and its ``--help`` must be quick."""
    if name not in __all__:
        raise AttributeError(f"module 'scanloom' has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF.get(name, "scanloom.api")), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
