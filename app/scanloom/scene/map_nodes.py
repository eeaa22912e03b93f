"""The map and the trajectory in a browser's scene, placed around the LiDAR."""

from dataclasses import dataclass

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray, FloatArray, read_only
from fusion_core.model.grids import OccupancyGrid
from scanloom.plots.grid_image import grid_texture
from scanloom.plots.palette import Color, color_of
from scanloom.plots.theme import Theme
from scanloom.scene.geometry import NO_SEGMENTS, Segments, path_segments, quaternion
from scanloom.scene.geometry_nodes import lines
from scanloom.scene.stage_colors import LIGHT

# Coplanar layers are drawn with a small offset against z-fighting.
_APART_M = 0.01
CELL_COLOR: Color = color_of("depth")
"""Of the outline of a cell that is picked."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapPlane:
    """A map as a picture, (H, W, 3) or (H, W, 4) uint8, its first row at the largest y.

    ``origin_m``: (x, y) of its corner of least x and y in the map frame.
    """

    picture: ByteArray
    resolution_m: float
    origin_m: tuple[float, float]

    def __post_init__(self) -> None:
        read_only(self.picture)

    @property
    def size_m(self) -> FloatArray:
        """(2,) extent along x and y."""
        return self.resolution_m * np.array(self.picture.shape[1::-1], dtype=np.float64)


def map_plane(grid: OccupancyGrid, theme: Theme) -> MapPlane:
    """A grid as it is drawn."""
    x_m, y_m = map(float, grid.origin_m)
    return MapPlane(
        picture=grid_texture(grid, theme), resolution_m=grid.resolution_m, origin_m=(x_m, y_m)
    )


def cell_outline(plane: MapPlane, place_m: FloatArray, height_m: float) -> Segments:
    """(4, 2, 3) the edges of the cell at an (x, y), none outside of the map."""
    step_m = plane.resolution_m
    cell = np.floor((place_m - np.array(plane.origin_m)) / step_m)
    if not (0 <= cell[0] < plane.picture.shape[1] and 0 <= cell[1] < plane.picture.shape[0]):
        return NO_SEGMENTS
    low = plane.origin_m + cell * step_m
    round_m = low + step_m * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
    corners = np.column_stack([round_m, np.full(5, height_m)]).astype(np.float32)
    return np.stack([corners[:-1], corners[1:]], axis=1)


class MapNodes:
    """One browser's map and trajectory. They are seen where there is a pose, if the layer is on."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._is_placed, self._is_allowed = False, True
        self._frame = scene.add_frame("/in_map", show_axes=False, visible=False)
        self._path = lines(scene, "/in_map/path", LIGHT.ink, thickness_px=3.0)
        self._cell = lines(scene, "/in_map/cell", CELL_COLOR, thickness_px=3.0)
        self._plane: MapPlane | None = None
        self._image: viser.ImageHandle | None = None

    def show(self, plane: MapPlane | None) -> None:
        """A map in the LiDAR's plane, None for none."""
        self._plane = plane
        self._cell.empty()
        if plane is None:
            if self._image is not None:
                self._image.visible = False
            return
        width_m, height_m = map(float, plane.size_m)
        if self._image is None:
            self._image = self._scene.add_image(
                "/in_map/map",
                plane.picture,
                width_m,
                height_m,
                format="png",
                cast_shadow=False,
                receive_shadow=False,
                # Seen from above: its own axes are right, down and away from who looks.
                wxyz=(0.0, 1.0, 0.0, 0.0),
            )
        else:
            self._image.image = plane.picture
            self._image.render_width, self._image.render_height = width_m, height_m
        x_m, y_m = plane.origin_m
        # Below the curve, which lies in the LiDAR's plane, too.
        self._image.position = (x_m + 0.5 * width_m, y_m + 0.5 * height_m, -2.0 * _APART_M)
        self._image.visible = True

    def mark_cell(self, place_m: FloatArray) -> None:
        """Outline the cell at an (x, y) of the map."""
        if self._plane is not None:
            self._cell.draw(cell_outline(self._plane, place_m, 0.0))

    def show_path(self, positions_in_map: FloatArray) -> None:
        """The LiDAR's trajectory, (N, 2) or (N, 3), in its plane; NaN where no pose is known."""
        in_plane = np.full((len(positions_in_map), 3), -_APART_M)
        in_plane[:, :2] = positions_in_map[:, :2]
        self._path.draw(path_segments(in_plane))

    def place(self, T_map_lidar: FloatArray | None) -> None:
        """Place map and path around the LiDAR by its pose in the map; None (no pose) hides them."""
        if T_map_lidar is not None:
            R_lidar_map = T_map_lidar[:3, :3].T
            x_m, y_m, _ = -R_lidar_map @ T_map_lidar[:3, 3]
            self._frame.wxyz = quaternion(R_lidar_map)
            self._frame.position = (x_m, y_m, 0.0)
        self._is_placed = T_map_lidar is not None
        self._frame.visible = self._is_placed and self._is_allowed

    def allow(self, allowed: bool) -> None:
        """Whether they may be seen."""
        self._is_allowed = allowed
        self._frame.visible = self._is_placed and allowed

    def recolor_path(self, color: Color) -> None:
        """Another colour of the trajectory."""
        self._path.recolor(color)

    def clear(self) -> None:
        """Hide map and path, as before the first."""
        self._path.empty()
        self.show(None)
        self.place(None)
