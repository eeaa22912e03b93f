"""The dense cloud of Fu 2024 §3.1: the pixels of keyframes at their poses, in colour.

It is assembled from the keyframes' images once their poses are final, and anew where they change.
"""

import numpy as np

from fusion_core.mapping.voxel_cloud import VoxelCloud
from fusion_core.model.conventions import BoolArray, ByteArray, Float32Array, FloatArray
from fusion_core.model.dense_map import ColoredCloud
from fusion_core.model.errors import MappingFailed
from fusion_core.model.geometry import transform_points
from fusion_core.registration.radius_filter import has_neighbours
from fusion_core.settings import StageSettings, setting


class DenseCloudSettings(StageSettings):
    """Dense cloud of the keyframes."""

    voxel_m: float = setting(
        0.01, "One point for each cube of this side", unit="m", ge=0.001, le=1.0
    )
    voxels_max: int = setting(
        2_000_000,
        "Largest cloud; where more are needed, voxel_m is doubled",
        unit="points",
        ge=1_000,
        le=20_000_000,
    )
    outlier_radius_voxels: float = setting(
        3.0, "Radius in which a point must have neighbours", unit="voxels", ge=1.0, le=20.0
    )
    outlier_neighbours_min: int = setting(
        5, "Least neighbours within the radius (0: all points remain)", ge=0, le=1000
    )


def back_project(depth_m: Float32Array, rays: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Fu (6): the points in the camera's frame, (N, 3), of the pixels that have depth, (H, W).

    ``rays``: (H, W, 2) (u - q_x) / f_x and (v - q_y) / f_y of each pixel, without the lens's
    distortion. The paper prints u - q_y for the second, a misprint.
    """
    if rays.shape != (*depth_m.shape, 2):
        raise ValueError(f"rays must be {(*depth_m.shape, 2)}, got {rays.shape}")
    has_depth: BoolArray = np.isfinite(depth_m)
    z = depth_m[has_depth].astype(np.float64)
    points_m = np.empty((len(z), 3))
    points_m[:, :2] = rays[has_depth] * z[:, np.newaxis]
    points_m[:, 2] = z
    return points_m, has_depth


def points_in_map(
    depth_m: Float32Array, rays: FloatArray, T_map_camera: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """(N, 3) the points of (H, W) depth in the map, and which pixels they are, (H, W).

    Fu (5) solved for the point: the paper's R, t are the inverse of ``T_map_camera``. ``rays`` as
    in ``back_project``.
    """
    points_in_camera_m, has_depth = back_project(depth_m, rays)
    return transform_points(T_map_camera, points_in_camera_m), has_depth


class DenseCloudBuilder:
    """Adds keyframes to a cloud. Memory follows the surfaces seen, and is bounded."""

    def __init__(self, settings: DenseCloudSettings) -> None:
        self._settings = settings
        self._cloud = VoxelCloud(settings.voxel_m, settings.voxels_max, channels=3, coarsens=True)

    @property
    def voxel_m(self) -> float:
        """Side of a voxel: that of the settings, or larger where the cloud was too large."""
        return self._cloud.voxel_m

    def add(self, points_in_map_m: FloatArray, rgb: ByteArray) -> None:
        """Add (N, 3) points of one keyframe with their (N, 3) colours.

        Raises MappingFailed for a point too far from the map's origin.
        """
        self._cloud.add(points_in_map_m, rgb)

    def build(self) -> ColoredCloud:
        """The mean point and colour of each voxel, those without neighbours left out.

        Raises MappingFailed where nothing is left, and as ``add``.
        """
        points_m, rgb = self._cloud.points_m(), self._cloud.values()
        if not len(points_m):
            raise MappingFailed(
                "the dense cloud has no points: no keyframe has depth within range.",
                advice="Check depth_filter.depth_min_m and depth_max_m.",
            )
        kept = has_neighbours(
            points_m,
            points_m,
            self._settings.outlier_radius_voxels * self.voxel_m,
            self._settings.outlier_neighbours_min,
        )
        if not kept.any():
            raise MappingFailed(
                "the dense cloud has no points: none has enough neighbours.",
                advice="Set a larger dense_cloud.outlier_radius_voxels.",
            )
        return ColoredCloud(points_in_map_m=points_m[kept], rgb=np.rint(rgb[kept]).astype(np.uint8))
