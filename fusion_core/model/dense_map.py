"""Coloured clouds and surfaces of a map."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, Int32Array, read_only


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColoredCloud:
    """``points_in_map_m``: (N, 3) float64, finite. ``rgb``: (N, 3) uint8."""

    points_in_map_m: FloatArray
    rgb: ByteArray

    def __post_init__(self) -> None:
        shape = (len(self.points_in_map_m), 3)
        if self.points_in_map_m.shape != shape or self.rgb.shape != shape:
            raise ValueError(
                f"(N, 3) points and colours, got {self.points_in_map_m.shape}, {self.rgb.shape}"
            )
        if self.points_in_map_m.dtype != np.float64 or self.rgb.dtype != np.uint8:
            raise ValueError(
                f"float64 points and uint8 colours, got {self.points_in_map_m.dtype}, "
                f"{self.rgb.dtype}"
            )
        for array in (self.points_in_map_m, self.rgb):
            read_only(array)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColoredMesh:
    """A surface of triangles.

    ``vertices_in_map_m``: (V, 3) float32. ``rgb``: (V, 3) uint8. ``triangles``: (T, 3) int32, rows
    of ``vertices_in_map_m``, counter-clockwise as seen from the free side.
    """

    vertices_in_map_m: Float32Array
    rgb: ByteArray
    triangles: Int32Array

    def __post_init__(self) -> None:
        shape = (len(self.vertices_in_map_m), 3)
        if self.vertices_in_map_m.shape != shape or self.rgb.shape != shape:
            raise ValueError(
                f"(V, 3) vertices and colours, got {self.vertices_in_map_m.shape}, {self.rgb.shape}"
            )
        if self.triangles.ndim != 2 or self.triangles.shape[1] != 3:
            raise ValueError(f"triangles must be (T, 3), got {self.triangles.shape}")
        if (
            self.vertices_in_map_m.dtype != np.float32
            or self.rgb.dtype != np.uint8
            or self.triangles.dtype != np.int32
        ):
            raise ValueError("a mesh has float32 vertices, uint8 colours and int32 triangles")
        for array in (self.vertices_in_map_m, self.rgb, self.triangles):
            read_only(array)
