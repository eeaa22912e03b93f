"""A graph of planar poses and of measured relations between them."""

from dataclasses import dataclass

from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseGraph:
    """K nodes and M edges.

    ``poses_map_node``: (K, 3) x, y, yaw. ``first``, ``second``: (M,) indices of nodes.
    ``pose_first_second``: (M, 3) as measured. ``information``: (M, 3, 3) of x, y, yaw in the
    second's axes, in 1/m² and 1/rad². ``is_loop``: (M,) whether an edge joins two visits of
    a place.
    """

    poses_map_node: FloatArray
    first: IntArray
    second: IntArray
    pose_first_second: FloatArray
    information: FloatArray
    is_loop: BoolArray

    def __post_init__(self) -> None:
        count = self.first.size
        shapes = {
            "second": (self.second.shape, (count,)),
            "pose_first_second": (self.pose_first_second.shape, (count, 3)),
            "information": (self.information.shape, (count, 3, 3)),
            "is_loop": (self.is_loop.shape, (count,)),
            "poses_map_node": (self.poses_map_node.shape, (len(self.poses_map_node), 3)),
        }
        for name, (shape, expected) in shapes.items():
            if shape != expected:
                raise ValueError(f"{name} must be {expected}, got {shape}")
            read_only(getattr(self, name))
        read_only(self.first)
