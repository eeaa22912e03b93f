"""Rays against a world: Open3D's ray casting says which triangle, float64 says how far.

Embree works in float32. Its answer is used for the triangle alone; the distance is computed from
that triangle's plane in float64, so truths are exact to rounding, and only rays within float32 of
a silhouette could depend on the processor's vector units.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, IntArray
from fusion_core.simulation.solids import Mesh, join_meshes
from fusion_core.simulation.worlds import World


@dataclass(frozen=True, slots=True)
class Hits:
    """Where rays first meet a surface.

    ``distance``: (N,) in units of the ray's direction vector, inf where nothing is met.
    ``incidence_cos``: (N,) in [0, 1], 1 is head on. ``normals``: (N, 3) unit.
    ``materials``: (N,) uint8. ``triangles``: (N,) index in the mesh, -1 where nothing is met.
    """

    distance: FloatArray
    incidence_cos: FloatArray
    normals: FloatArray
    materials: ByteArray
    triangles: IntArray


class MeshCaster:
    """Casts rays against a mesh that does not move."""

    def __init__(self, mesh: Mesh) -> None:
        # Open3D takes most of a second to import, and only simulation needs it.
        import open3d.core as o3c
        import open3d.t.geometry as o3d_geometry

        self._tensor = o3c.Tensor.from_numpy
        self._scene = o3d_geometry.RaycastingScene()
        corners = mesh.corners_m
        self._scene.add_triangles(
            o3c.Tensor.from_numpy(corners.reshape(-1, 3).astype(np.float32)),
            o3c.Tensor.from_numpy(np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)),
        )
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normals = cross / np.linalg.norm(cross, axis=1, keepdims=True)
        self._offsets = np.einsum("ij,ij->i", self._normals, corners[:, 0])
        self._materials = mesh.materials

    def cast(self, origins_m: FloatArray, directions: FloatArray) -> Hits:
        """First triangles met by rays from (N, 3) or (3,) along (N, 3), of any length."""
        answer = self._scene.cast_rays(self._rays(origins_m, directions))
        triangle = answer["primitive_ids"].numpy().astype(np.int64)
        met = np.isfinite(answer["t_hit"].numpy())
        triangle[~met] = 0
        normals = self._normals[triangle]
        slope = np.einsum("ij,ij->i", normals, directions)
        height = self._offsets[triangle] - np.einsum("ij,ij->i", normals, origins_m)
        distance = np.divide(height, slope, out=np.full(len(met), np.inf), where=met)
        length = np.sqrt(np.einsum("ij,ij->i", directions, directions))
        incidence_cos = np.abs(slope) / length
        materials = self._materials[triangle]
        return Hits(distance, incidence_cos, normals, materials, np.where(met, triangle, -1))

    def blocked(self, origins_m: FloatArray, directions: FloatArray) -> BoolArray:
        """(N,) whether a triangle lies on the way from each origin to origin + direction."""
        rays = self._rays(origins_m, directions)
        blocked: BoolArray = self._scene.test_occlusions(rays, tnear=0.0, tfar=1.0).numpy()
        return blocked

    def _rays(self, origins_m: FloatArray, directions: FloatArray) -> object:
        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3] = origins_m
        rays[:, 3:] = directions
        return self._tensor(rays)


class RayCaster:
    """Casts rays into a world at one instant."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._static = MeshCaster(world.mesh)

    def cast(self, origins_m: FloatArray, directions: FloatArray, time_s: float) -> Hits:
        """First surfaces met by rays.

        ``origins_m``: (N, 3) or (3,). ``directions``: (N, 3), of any length: distances are in
        its units. ``time_s``: since the start of the recording; it moves the people.
        """
        origins_m = np.broadcast_to(origins_m, directions.shape)
        hits = self._static.cast(origins_m, directions)
        moving = self._moving(time_s)
        if moving is None:
            return hits
        other = moving.cast(origins_m, directions)
        nearer = other.distance < hits.distance
        return Hits(
            np.where(nearer, other.distance, hits.distance),
            np.where(nearer, other.incidence_cos, hits.incidence_cos),
            np.where(nearer[:, None], other.normals, hits.normals),
            np.where(nearer, other.materials, hits.materials),
            # The triangles of the people are numbered after those of the world.
            np.where(nearer, other.triangles + self._world.mesh.materials.size, hits.triangles),
        )

    def blocked(self, origins_m: FloatArray, target_m: FloatArray, time_s: float) -> BoolArray:
        """(N,): whether something lies between each origin (N, 3) and its target (N, 3) or (3,)."""
        directions = target_m - origins_m
        # A centimetre away from the origin's own surface, which float32 could meet again.
        length = np.linalg.norm(directions, axis=1, keepdims=True)
        origins_m = origins_m + directions * (0.01 / length)
        directions = target_m - origins_m
        blocked = self._static.blocked(origins_m, directions)
        moving = self._moving(time_s)
        return blocked if moving is None else blocked | moving.blocked(origins_m, directions)

    def _moving(self, time_s: float) -> MeshCaster | None:
        if not self._world.walkers:
            return None
        return MeshCaster(join_meshes([walker.mesh_at(time_s) for walker in self._world.walkers]))
