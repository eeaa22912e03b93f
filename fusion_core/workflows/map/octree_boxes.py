"""The octree of a run as boxes to be displayed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.exporting.manifest import require_intact
from fusion_core.mapping.octree_nodes import boxes_of
from fusion_core.model.conventions import Float32Array, read_only
from fusion_core.model.errors import RecordingError
from fusion_core.model.octree import TREE_DEPTH, OccupancyOctree
from fusion_core.recordings.octree_file import read_octree

OCTREE_NAME = "octree.ot"
BOXES_MAX = 50_000
"""A browser is sent at most so many boxes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OctreeBoxes:
    """The occupied leaves of an octree, nodes at ``depth`` counting as leaves.

    ``centres_in_map_m``: (N, 3). ``sides_m``: (N,). ``depth``: the one that was asked for, or less
    where that gave too many. ``finest_side_m``: of a box at that depth.
    """

    centres_in_map_m: Float32Array
    sides_m: Float32Array
    depth: int
    finest_side_m: float

    def __post_init__(self) -> None:
        read_only(self.centres_in_map_m)
        read_only(self.sides_m)


def read_run_octree(folder: Path) -> OccupancyOctree | None:
    """The octree in a folder of results, None where there is none.

    Raises RecordingError or ExportError where it is not as it was written.
    """
    if not (folder / OCTREE_NAME).exists():
        return None
    require_intact(folder, (OCTREE_NAME,), "map")
    return read_octree(folder / OCTREE_NAME)


def octree_boxes(octree: OccupancyOctree, depth: int, boxes_max: int = BOXES_MAX) -> OctreeBoxes:
    """Boxes of the occupied leaves. Raises RecordingError for nodes that are no octree."""
    try:
        leaves, cut = boxes_of(octree, depth, boxes_max)
    except ValueError as error:
        raise RecordingError(
            f"the octree cannot be shown: {error}.", advice="Run again."
        ) from error
    return OctreeBoxes(
        centres_in_map_m=leaves.centres_in_map_m.astype(np.float32),
        sides_m=leaves.sides_m.astype(np.float32),
        depth=cut,
        finest_side_m=octree.resolution_m * 2.0 ** (TREE_DEPTH - cut),
    )
