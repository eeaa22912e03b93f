"""The maps in space of a run of visual SLAM: dense cloud, surface, octree and the grid projected
from it (Fu 2024 §3.1), each assembled from the keyframes' images at their final poses."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.exporting.clouds import write_cloud
from fusion_core.exporting.figures_volumes import write_cloud_figure, write_mesh_figure
from fusion_core.exporting.map_picture import write_grid_picture
from fusion_core.exporting.meshes import write_mesh
from fusion_core.exporting.octomap_files import write_octree
from fusion_core.exporting.ros_map import write_ros_map
from fusion_core.mapping.octree_nodes import leaves_of
from fusion_core.mapping.projected_grid import FREE_BELOW, OCCUPIED_ABOVE, project_octree
from fusion_core.model.errors import MappingFailed
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.number_text import counted
from fusion_core.model.progress import Progress, silent
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.workflows.map.volume_assembly import (
    Views,
    Volumes,
    VolumeSettings,
    assemble_volumes,
)

__all__ = ["Views", "VolumeSettings", "VolumeSummary", "write_volumes"]

# Without a floor in sight the band begins above the lowest points; this percentage may lie lower.
_LOWEST_PERCENT = 1.0
_NOT_REPORTED = ("grid", "notes")
# x, y, z as float32, and three bytes of colour.
_BYTES_PER_POINT = 15


@dataclass(frozen=True, slots=True, kw_only=True)
class VolumeSummary:
    """What was written, for the report.

    ``lowest_in_map_m``, ``highest_in_map_m``: the corners of the dense cloud's extent.
    ``mesh_voxel_m``: 0 where there is no mesh. ``octree_bytes``: of the tree in memory, as it was
    built; ``cloud_bytes``: of the dense cloud's points and colours at 15 bytes each. ``grid``: the
    one projected from the octree, None where there is none.
    """

    keyframes: int
    points: int
    cloud_voxel_m: float
    cloud_bytes: int
    lowest_in_map_m: tuple[float, float, float]
    highest_in_map_m: tuple[float, float, float]
    mesh_vertices: int
    mesh_triangles: int
    mesh_voxel_m: float
    octree_resolution_m: float
    octree_nodes: int
    octree_leaves: int
    octree_occupied_leaves: int
    octree_bytes: int
    floor_height_m: float
    grid_occupied_cells: int
    grid_free_cells: int
    grid: OccupancyGrid | None = None
    notes: tuple[str, ...] = ()

    def to_report(self) -> dict[str, Any]:
        """As plain values, without the grid and the notes."""
        plain = replace(self, grid=None, notes=())
        return {name: value for name, value in asdict(plain).items() if name not in _NOT_REPORTED}


def write_volumes(
    folder: Path,
    views: Views,
    intrinsics: CameraIntrinsics,
    settings: VolumeSettings,
    progress: Progress = silent,
    *,
    floor_height_m: float | None = 0.0,
) -> VolumeSummary:
    """Write ``cloud.ply``, ``cloud.pcd``, ``mesh.ply``, ``octree.ot``, ``octree.bt`` and
    ``map_camera`` with their pictures into an existing folder.

    ``intrinsics``: of the frames' grey images, with their distortion. ``floor_height_m``: z of the
    floor in the map, None where it is not known: then the lowest points stand for it, and a note
    says so.

    Raises MappingFailed where the keyframes have no usable depth.
    """
    built = assemble_volumes(views, intrinsics, settings, progress)
    cloud, notes = built.cloud, list(built.notes)
    if floor_height_m is None:
        floor_height_m = float(np.percentile(cloud.points_in_map_m[:, 2], _LOWEST_PERCENT))
        notes.append(
            "No floor is known: the projected grid's band of heights begins above the lowest "
            f"points, at z = {floor_height_m:.2f} m."
        )
    grid = None
    try:
        grid = project_octree(built.octree, floor_height_m, settings.projected_grid)
    except MappingFailed as error:
        notes.append(f"No map_camera: {error}")
    progress(0, None, "writing the maps")
    for suffix in (".ply", ".pcd"):
        write_cloud(folder / f"cloud{suffix}", cloud.points_in_map_m, cloud.rgb)
    if built.mesh is not None:
        write_mesh(folder / "mesh.ply", built.mesh)
    _write_pictures(folder, built, intrinsics)
    for suffix in (".ot", ".bt"):
        write_octree(folder / f"octree{suffix}", built.octree)
    if grid is not None:
        write_ros_map(
            folder,
            "map_camera",
            grid,
            occupied_above=OCCUPIED_ABOVE,
            free_below=FREE_BELOW,
        )
        write_grid_picture(folder / "map_camera.png", grid)
    return _summary(built, grid, floor_height_m, notes)


def _write_pictures(folder: Path, built: Volumes, intrinsics: CameraIntrinsics) -> None:
    keyframes = counted(len(built.T_map_camera), "keyframe")
    heading = f"Dense cloud of {keyframes}: {counted(len(built.cloud.rgb), 'point')}"
    write_cloud_figure(
        folder / "cloud.png",
        heading,
        built.cloud,
        built.cloud_voxel_m,
        built.T_map_camera,
        intrinsics,
    )
    if built.mesh is not None:
        heading = (
            f"Surface of {keyframes}: {counted(len(built.mesh.triangles), 'triangle')}, "
            f"voxels of {built.mesh_voxel_m:g} m"
        )
        write_mesh_figure(folder / "mesh.png", heading, built.mesh, built.T_map_camera, intrinsics)


def _summary(
    built: Volumes, grid: OccupancyGrid | None, floor_height_m: float, notes: list[str]
) -> VolumeSummary:
    points_m = built.cloud.points_in_map_m
    leaves = leaves_of(built.octree)
    lowest, highest = points_m.min(axis=0).tolist(), points_m.max(axis=0).tolist()
    log_odds = np.empty((0, 0)) if grid is None else grid.log_odds
    return VolumeSummary(
        keyframes=len(built.T_map_camera),
        points=len(points_m),
        cloud_voxel_m=built.cloud_voxel_m,
        cloud_bytes=_BYTES_PER_POINT * len(points_m),
        lowest_in_map_m=(lowest[0], lowest[1], lowest[2]),
        highest_in_map_m=(highest[0], highest[1], highest[2]),
        mesh_vertices=0 if built.mesh is None else len(built.mesh.vertices_in_map_m),
        mesh_triangles=0 if built.mesh is None else len(built.mesh.triangles),
        mesh_voxel_m=0.0 if built.mesh is None else built.mesh_voxel_m,
        octree_resolution_m=built.octree.resolution_m,
        octree_nodes=len(built.octree.nodes),
        octree_leaves=len(leaves),
        octree_occupied_leaves=int(leaves.occupied.sum()),
        octree_bytes=built.octree_bytes,
        floor_height_m=floor_height_m,
        grid_occupied_cells=int((log_odds >= 0.0).sum()),
        grid_free_cells=int((log_odds < 0.0).sum()),
        grid=grid,
        notes=tuple(notes),
    )
