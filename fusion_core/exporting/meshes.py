"""Surfaces as PLY."""

from pathlib import Path

import numpy as np

from fusion_core.files.atomic import write_bytes
from fusion_core.model.dense_map import ColoredMesh
from fusion_core.model.errors import ExportError

_VERTEX = np.dtype([("position", "<f4", 3), ("rgb", "u1", 3)])
_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])


def write_mesh(path: Path, mesh: ColoredMesh) -> None:
    """Write a surface, binary, with the colours of its vertices.

    Raises ExportError for another suffix than ``.ply``.
    """
    if path.suffix != ".ply":
        raise ExportError(f"{path.suffix!r} is not a mesh format.", file=path, advice="Use .ply.")
    vertices = np.empty(len(mesh.vertices_in_map_m), dtype=_VERTEX)
    vertices["position"], vertices["rgb"] = mesh.vertices_in_map_m, mesh.rgb
    faces = np.empty(len(mesh.triangles), dtype=_FACE)
    faces["count"], faces["vertices"] = 3, mesh.triangles
    header = (
        "ply\n"
        "format binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        f"element face {len(faces)}\n"
        "property list uchar int vertex_indices\n"
        "end_header\n"
    )
    write_bytes(path, header.encode("ascii") + vertices.tobytes() + faces.tobytes())
