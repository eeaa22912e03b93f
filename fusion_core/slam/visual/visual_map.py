"""The map of visual SLAM: keyframes with ORB features, and the landmarks that they see.

Landmarks are held as columns of arrays, one row each; a feature points to its landmark by row.
Numbers of keyframes and landmarks stay what they are: what is culled is marked, not moved.
"""

from dataclasses import dataclass, field

import numpy as np

from fusion_core.model.conventions import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
)

NO_LANDMARK = -1
"""Of a feature that sees no landmark."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FrameFeatures:
    """The ORB features of one image.

    ``pixels``: (F, 2) u, v by the camera matrix alone: distortion is taken off. ``depths_m``: (F,),
    z along the optical axis, NaN where missing or at a depth edge. ``octaves``: (F,) level of the
    pyramid. ``angles_deg``: (F,) orientation. ``descriptors``: (F, 32) uint8.
    """

    pixels: FloatArray
    depths_m: FloatArray
    octaves: IntArray
    angles_deg: Float32Array
    descriptors: ByteArray

    def __post_init__(self) -> None:
        for array in (
            self.pixels,
            self.depths_m,
            self.octaves,
            self.angles_deg,
            self.descriptors,
        ):
            read_only(array)

    def __len__(self) -> int:
        return len(self.pixels)


@dataclass(slots=True, kw_only=True, eq=False)
class Keyframe:
    """An image of the map.

    ``index``: its number in ``VisualMap.keyframes``. ``T_map_camera``: (4, 4), as estimated so
    far. ``landmarks``: (F,) the landmark that each feature sees, or NO_LANDMARK. ``parent``: the
    keyframe that saw most of its landmarks when it was made, None for the first of a map: the
    spanning tree of the essential graph. ``is_culled``: left out of all that follows.
    """

    index: int
    stamp_ns: int
    features: FrameFeatures
    T_map_camera: FloatArray
    landmarks: IntArray
    parent: int | None = None
    is_culled: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopClosure:
    """Two keyframes that see the same place.

    ``T_first_second``: (4, 4) of their optical frames. ``covariance``: (6, 6) of a small motion of
    the second in its own frame, rotation first (gtsam's Pose3). ``matches``: (M, 2) the features of
    both that agree with it.
    """

    first: int
    second: int
    T_first_second: FloatArray
    covariance: FloatArray
    matches: IntArray

    def __post_init__(self) -> None:
        for array in (self.T_first_second, self.covariance, self.matches):
            read_only(array)


@dataclass(slots=True, eq=False)
class VisualMap:
    """Keyframes and landmarks.

    ``positions_in_map_m``: (M, 3) of the landmarks. ``landmark_descriptors``: (M, 32).
    ``is_landmark_culled``: (M,). ``loops``: in the order in which they were closed.
    """

    keyframes: list[Keyframe] = field(default_factory=list)
    loops: list[LoopClosure] = field(default_factory=list)
    positions_in_map_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    landmark_descriptors: ByteArray = field(default_factory=lambda: np.empty((0, 32), np.uint8))
    is_landmark_culled: BoolArray = field(default_factory=lambda: np.empty(0, np.bool_))
