"""An image as tracking holds it until the next: its features and the points that they see."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.pinhole import unproject
from fusion_core.slam.visual.visual_map import VisualMap


@dataclass(slots=True, kw_only=True, eq=False)
class TrackedFrame:
    """``T_map_camera``: (4, 4). ``landmarks``: (F,) of the features, or NO_LANDMARK.
    ``positions_in_map_m``: (F, 3) what each feature sees: its landmark, else by its depth; NaN
    where it has neither. ``information``: (6, 6) of the pose, see ``PoseFit``; None for the image
    that begins the map, whose pose is chosen."""

    features: FrameFeatures
    T_map_camera: FloatArray
    landmarks: IntArray
    positions_in_map_m: FloatArray
    information: FloatArray | None = None

    @property
    def in_sight(self) -> int:
        """How many landmarks it sees."""
        return int(np.count_nonzero(self.landmarks != NO_LANDMARK))

    def add_points_by_depth(self, camera: FloatArray) -> None:
        """Give features without a landmark the point at their depth."""
        missing = np.flatnonzero(self.landmarks == NO_LANDMARK)
        features = self.features
        points = unproject(features.pixels[missing], features.depths_m[missing], camera)
        self.positions_in_map_m[missing] = transform_points(self.T_map_camera, points)

    def follow_map(self, visual_map: VisualMap, T_map_camera: FloatArray) -> None:
        """Take over the pose and the landmarks' positions after mapping has changed them."""
        moved = T_map_camera @ invert_transform(self.T_map_camera)
        seen = np.flatnonzero(self.landmarks != NO_LANDMARK)
        gone = seen[visual_map.is_landmark_culled[self.landmarks[seen]]]
        self.landmarks[gone] = NO_LANDMARK
        self.positions_in_map_m = transform_points(moved, self.positions_in_map_m)
        kept = np.flatnonzero(self.landmarks != NO_LANDMARK)
        self.positions_in_map_m[kept] = visual_map.positions_in_map_m[self.landmarks[kept]]
        self.T_map_camera = T_map_camera
