"""ScanLoom: a 2D LiDAR curve laid over the rows of a depth image.

    import scanloom

    room = scanloom.fuse("furnished_room.mcap")
    room.mount.yaw_rad
    room.frames.column("score").to_numpy()
    room.maps["fused"].to_numpy()

``open``, ``info``, ``fuse``, ``build_map`` and ``match_scans`` do what the commands of the same
names do; ``load`` reads a folder of results that a command wrote. Whatever fails raises
``ScanLoomError``, with the file and what to do about it.
"""

from typing import TYPE_CHECKING, Any

from fusion_core.model.errors import ScanLoomError
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

if TYPE_CHECKING:
    from fusion_core.workflows.fuse.session import FuseOptions
    from fusion_core.workflows.map.options import MapOptions
    from fusion_core.workflows.source import RoomChoice

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


def __getattr__(name: str) -> Any:
    """The options of the workflows, which are imported when they are first asked for."""
    if name == "FuseOptions":
        from fusion_core.workflows.fuse.session import FuseOptions

        return FuseOptions
    if name == "MapOptions":
        from fusion_core.workflows.map.options import MapOptions

        return MapOptions
    if name == "RoomChoice":
        from fusion_core.workflows.source import RoomChoice

        return RoomChoice
    raise AttributeError(f"module 'scanloom' has no attribute {name!r}")
