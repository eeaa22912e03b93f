"""The keyframes of a visual map, and what relates two of them beside landmarks."""

from dataclasses import dataclass

from fusion_core.model.conventions import Float32Array, FloatArray, IntArray, read_only
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.relative_pose import RelativePose

NO_LANDMARK = -1
"""Of a feature that sees no landmark."""


@dataclass(slots=True, kw_only=True, eq=False)
class Keyframe:
    """An image of the map.

    ``index``: its number in ``VisualMap.keyframes``. ``T_map_camera``: (4, 4), as estimated so
    far. ``landmarks``: (F,) the landmark that each feature sees, or NO_LANDMARK. ``parent``: the
    keyframe that saw most of its landmarks when it was made, None for the first of a map: the
    spanning tree of the essential graph. ``is_culled``: left out of all that follows, without
    features; its pose then follows that of its parent, which is kept, by ``T_parent_camera``,
    (4, 4), None for a keyframe that is kept itself.
    ``reduced_depth_m``: (h, w) by ``SurfaceSampler``, None where it is not needed any more.
    """

    index: int
    stamp_ns: int
    features: FrameFeatures
    T_map_camera: FloatArray
    landmarks: IntArray
    parent: int | None = None
    is_culled: bool = False
    T_parent_camera: FloatArray | None = None
    reduced_depth_m: Float32Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopClosure:
    """Two keyframes that see the same place. ``pose``: of the second in the first."""

    first: int
    second: int
    pose: RelativePose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthAlignment:
    """What their depth images say of two keyframes.

    ``T_second_first``: (4, 4) of their optical frames. ``information``: (6, 6) of a small motion
    from the left, rotation first.
    """

    first: int
    second: int
    T_second_first: FloatArray
    information: FloatArray

    def __post_init__(self) -> None:
        for array in (self.T_second_first, self.information):
            read_only(array)
