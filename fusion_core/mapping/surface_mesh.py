"""The surface of the keyframes by a truncated signed distance field (Curless & Levoy 1996), with
Open3D's sparse blocks of voxels."""

from typing import Any

import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, IntArray
from fusion_core.model.dense_map import ColoredMesh
from fusion_core.model.errors import MappingFailed, VolumeTooLarge
from fusion_core.model.geometry import invert_transform
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting

# Voxels along a block's side: small blocks hug the surface, so they take less memory.
_BLOCK_SIDE = 8
_BLOCKS_AT_START = 1000


class MeshSettings(StageSettings):
    """Surface of the keyframes."""

    voxel_m: float = setting(0.01, "Side of a voxel", unit="m", ge=0.002, le=1.0)
    truncation_voxels: float = setting(
        6.0,
        "Distance from the surface up to which a pixel speaks",
        unit="voxels",
        ge=1.0,
        le=7.0,
    )
    weight_min: int = setting(
        2, "Images that must have seen a place; no more than there are", ge=1, le=100
    )
    blocks_max: int = setting(
        50_000,
        "Largest field, 10 kB a block of 8 voxels' side; where more are needed, voxel_m is doubled",
        unit="blocks",
        ge=100,
        le=500_000,
    )


class MeshBuilder:
    """Adds images to a distance field.

    ``voxel_m``: side of a voxel, at least that of the settings.
    """

    def __init__(self, settings: MeshSettings, voxel_m: float) -> None:
        # Imported here: it takes most of a second and 200 MiB.
        import open3d as o3d

        self._settings, self._voxel_m = settings, voxel_m
        self._o3d: Any = o3d
        self._images = 0
        float32 = o3d.core.float32
        self._field = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight", "color"),
            (float32, float32, float32),
            tuple(o3d.core.SizeVector([n]) for n in (1, 1, 3)),
            voxel_m,
            _BLOCK_SIDE,
            _BLOCKS_AT_START,
            o3d.core.Device("CPU:0"),
        )

    def add(
        self,
        depth_m: Float32Array,
        rgb: ByteArray,
        intrinsics: CameraIntrinsics,
        T_map_camera: FloatArray,
    ) -> None:
        """Add (H, W) depth, NaN where missing, with (H, W, 3) colours.

        ``intrinsics``: of both, whose distortion must have been taken out of the images.

        Raises VolumeTooLarge where the field becomes too large.
        """
        if rgb.shape != (*depth_m.shape, 3):
            raise ValueError(f"rgb must be {(*depth_m.shape, 3)}, got {rgb.shape}")
        has_depth = np.isfinite(depth_m)
        if not has_depth.any():
            return
        o3d = self._o3d
        # Zero is Open3D's missing depth.
        depth = o3d.t.geometry.Image(o3d.core.Tensor(np.where(has_depth, depth_m, np.float32(0.0))))
        color = o3d.t.geometry.Image(o3d.core.Tensor(rgb.astype(np.float32) / np.float32(255.0)))
        K = o3d.core.Tensor(intrinsics.matrix)
        T_camera_map = o3d.core.Tensor(invert_transform(T_map_camera))
        depth_scale, depth_max_m = 1.0, float(depth_m[has_depth].max()) + 1.0
        truncation = self._settings.truncation_voxels
        blocks = self._field.compute_unique_block_coordinates(
            depth, K, T_camera_map, depth_scale, depth_max_m, truncation
        )
        self._field.integrate(
            blocks,
            depth,
            color,
            K,
            K,
            T_camera_map,
            depth_scale,
            depth_max_m,
            truncation,
        )
        self._images += 1
        if self._field.hashmap().size() > self._settings.blocks_max:
            raise VolumeTooLarge(
                f"the distance field exceeds {self._settings.blocks_max} blocks of voxels of "
                f"{self._voxel_m:g} m.",
                advice="Choose a larger mesh.voxel_m, or a larger mesh.blocks_max.",
            )

    def build(self) -> ColoredMesh:
        """The surface where the signed distance changes its sign.

        Raises MappingFailed where there is none.
        """
        nothing = MappingFailed(
            "the surface has no triangles: no place was seen by enough keyframes.",
            advice="Set a smaller mesh.weight_min, or check the depth and the poses.",
        )
        if not self._images:
            raise nothing
        weight_min = min(self._settings.weight_min, self._images)
        # Weights are counts of images: half a count separates them safely.
        mesh = self._field.extract_triangle_mesh(weight_threshold=weight_min - 0.5)
        if "indices" not in mesh.triangle or not len(mesh.triangle.indices):
            raise nothing
        return _in_canonical_order(
            mesh.vertex.positions.numpy(), mesh.vertex.colors.numpy(), mesh.triangle.indices.numpy()
        )


def _in_canonical_order(
    vertices_m: Float32Array, colors: Float32Array, triangles: IntArray
) -> ColoredMesh:
    """Vertices by their coordinates, triangles by their vertices: Open3D's order depends on how its
    threads happened to run. Vertices of one place become one."""
    order = np.lexsort((*colors.T[::-1], *vertices_m.T[::-1]))
    ordered_m = vertices_m[order]
    is_first = np.ones(len(order), dtype=np.bool_)
    is_first[1:] = (np.diff(ordered_m, axis=0) != 0.0).any(axis=1)
    renamed = np.empty(len(order), dtype=np.int64)
    renamed[order] = np.cumsum(is_first) - 1
    corners = renamed[triangles]
    # The smallest vertex first, which keeps the side that the triangle faces.
    turns = (np.argmin(corners, axis=1)[:, np.newaxis] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turns, axis=1)
    has_area = (
        (corners[:, 0] != corners[:, 1])
        & (corners[:, 1] != corners[:, 2])
        & (corners[:, 0] != corners[:, 2])
    )
    corners = np.unique(corners[has_area], axis=0)
    rgb = np.rint(255.0 * np.clip(colors[order][is_first], 0.0, 1.0)).astype(np.uint8)
    return ColoredMesh(
        vertices_in_map_m=np.ascontiguousarray(ordered_m[is_first]),
        rgb=rgb,
        triangles=corners.astype(np.int32),
    )
