"""The keyframes' images at their final poses, assembled to the maps in space."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from fusion_core.mapping.dense_cloud import DenseCloudBuilder, DenseCloudSettings, points_in_map
from fusion_core.mapping.depth_filter import (
    DepthFilterSettings,
    depth_off_edges,
    depth_within_range,
)
from fusion_core.mapping.octree import OctreeBuilder, OctreeSettings
from fusion_core.mapping.projected_grid import ProjectedGridSettings
from fusion_core.mapping.surface_mesh import MeshBuilder, MeshSettings
from fusion_core.model.conventions import FloatArray
from fusion_core.model.dense_map import ColoredCloud, ColoredMesh
from fusion_core.model.errors import MappingFailed, VolumeTooLarge
from fusion_core.model.octree import OccupancyOctree
from fusion_core.model.progress import Progress
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import SettingsGroup
from fusion_core.workflows.map.keyframe_images import KeyframeImages, colors_of_depth


class Views(Protocol):
    """Keyframes with (4, 4) T_map_camera of the optical frame, iterable any number of times."""

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[tuple[RgbdFrame, FloatArray]]: ...


class VolumeSettings(SettingsGroup):
    """The settings of the maps in space."""

    depth_filter: DepthFilterSettings = DepthFilterSettings()
    dense_cloud: DenseCloudSettings = DenseCloudSettings()
    mesh: MeshSettings = MeshSettings()
    octree: OctreeSettings = OctreeSettings()
    projected_grid: ProjectedGridSettings = ProjectedGridSettings()


@dataclass(frozen=True, slots=True, kw_only=True)
class Volumes:
    """What the keyframes' images amount to. ``T_map_camera``: (K, 4, 4)."""

    T_map_camera: FloatArray
    cloud: ColoredCloud
    cloud_voxel_m: float
    mesh: ColoredMesh | None
    mesh_voxel_m: float
    octree: OccupancyOctree
    octree_bytes: int
    notes: tuple[str, ...]


Builder = TypeVar("Builder", OctreeBuilder, MeshBuilder)


class _Coarsening(Generic[Builder]):
    """A builder that is replaced by one twice as coarse where its map becomes too large; then it
    needs the keyframes again, from the first."""

    def __init__(self, make: Callable[[float], Builder], side_m: float) -> None:
        self._make: Callable[[float], Builder] = make
        self.side_m = side_m
        self.builder: Builder = make(side_m)
        self._too_large: VolumeTooLarge | None = None
        self.notes: tuple[str, ...] = ()

    def add(self, *keyframe: Any) -> None:
        """Add a keyframe as the builder takes it, unless the map is too large already."""
        if self._too_large is None:
            try:
                self.builder.add(*keyframe)
            except VolumeTooLarge as error:
                self._too_large = error

    def restart(self) -> bool:
        """Whether the keyframes are needed again."""
        if self._too_large is None:
            return False
        self.side_m *= 2.0
        self.notes = (f"{self._too_large.problem} It has cells of {self.side_m:g} m instead.",)
        self._too_large = None
        self.builder = self._make(self.side_m)
        return True


def assemble_volumes(
    views: Views, intrinsics: CameraIntrinsics, settings: VolumeSettings, progress: Progress
) -> Volumes:
    images = KeyframeImages(intrinsics)
    cloud = DenseCloudBuilder(settings.dense_cloud)
    octree = _Coarsening(
        lambda side_m: OctreeBuilder(settings.octree.model_copy(update={"resolution_m": side_m})),
        settings.octree.resolution_m,
    )
    mesh = _Coarsening(lambda side_m: MeshBuilder(settings.mesh, side_m), settings.mesh.voxel_m)
    poses: list[FloatArray] = []
    is_first, wants_octree, wants_mesh = True, True, True
    while is_first or wants_octree or wants_mesh:
        for done, (frame, T_map_camera) in enumerate(views):
            progress(done, len(views), "adding keyframes to cloud, mesh and octree")
            if not np.isfinite(T_map_camera).all():
                raise MappingFailed(
                    f"the pose of the keyframe at {frame.stamp_ns} ns is not finite."
                )
            all_m = depth_off_edges(frame.depth_m, settings.depth_filter)
            near_m = depth_within_range(all_m, settings.depth_filter)
            geometry, rgb = images.geometry(all_m), colors_of_depth(frame)
            if is_first:
                poses.append(T_map_camera)
                points_m, has_depth = points_in_map(near_m, geometry.rays, T_map_camera)
                cloud.add(points_m, rgb[has_depth])
            if wants_octree:
                points_m, _ = points_in_map(all_m, geometry.rays, T_map_camera)
                octree.add(points_m, T_map_camera[:3, 3])
            if wants_mesh:
                straight = geometry.straight
                mesh.add(
                    straight.depth(near_m), straight.color(rgb), geometry.intrinsics, T_map_camera
                )
        is_first, wants_octree, wants_mesh = False, octree.restart(), mesh.restart()
    progress(0, None, "filtering the dense cloud")
    colored = cloud.build()
    notes = [*octree.notes, *mesh.notes]
    if cloud.voxel_m > settings.dense_cloud.voxel_m:
        notes.append(
            f"The dense cloud has one point for {cloud.voxel_m:g} m and not "
            f"{settings.dense_cloud.voxel_m:g} m: finer ones were more than "
            f"{settings.dense_cloud.voxels_max} (dense_cloud.voxels_max)."
        )
    surface = None
    try:
        surface = mesh.builder.build()
    except MappingFailed as error:
        notes.append(f"No mesh: {error}")
    return Volumes(
        T_map_camera=np.array(poses),
        cloud=colored,
        cloud_voxel_m=cloud.voxel_m,
        mesh=surface,
        mesh_voxel_m=mesh.side_m,
        octree=octree.builder.build(),
        octree_bytes=octree.builder.memory_bytes,
        notes=tuple(notes),
    )
