"""The estimators of ``scanloom map``: each places the scans of a recording."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import MappingFailed
from fusion_core.model.progress import Progress
from fusion_core.slam.pose_graph_slam import SlamResult, SlamSettings, pose_graph_slam
from fusion_core.workflows.poses import Poses
from fusion_core.workflows.scan_source import Scans

Slam = Literal["none", "pose-graph"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """N scans with a pose.

    ``poses_map_scan``: (N, 3) x, y, yaw. ``trusted``: (N,) whether each can be. ``graph``: of the
    pose graph alone. ``seconds``: of each stage, on the wall clock.
    """

    stamps_ns: IntArray
    poses_map_scan: FloatArray
    trusted: BoolArray
    seconds: Mapping[str, float]
    graph: SlamResult | None = None

    def __post_init__(self) -> None:
        for array in (self.stamps_ns, self.poses_map_scan, self.trusted):
            read_only(array)


def place(
    scans: Scans,
    motion: Poses | None,
    slam: Slam,
    settings: SlamSettings,
    progress: Progress,
) -> Placed:
    """Place the scans; ``motion`` is the prior of SLAM, or all there is without it.

    Raises MappingFailed where no scan can be placed.
    """
    if slam == "pose-graph":
        result = pose_graph_slam(scans, motion.at if motion else None, settings, progress)
        return Placed(
            stamps_ns=result.stamps_ns,
            poses_map_scan=result.poses_map_scan,
            trusted=result.trusted,
            seconds=result.seconds,
            graph=result,
        )
    if motion is None:
        raise MappingFailed("without SLAM and without motion there are no poses.")
    return _placed_by_motion(scans, motion)


def _placed_by_motion(scans: Scans, motion: Poses) -> Placed:
    known = [
        (scan.stamp_ns, pose) for scan in scans if (pose := motion.at(scan.stamp_ns)) is not None
    ]
    if not known:
        raise MappingFailed(f"{motion.source} has no pose for any scan.")
    stamps_ns, found = zip(*known, strict=True)
    return Placed(
        stamps_ns=np.array(stamps_ns, dtype=np.int64),
        poses_map_scan=np.array(found),
        trusted=np.ones(len(known), dtype=np.bool_),
        seconds={},
    )
