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
# The side of the square around a picked cell, in cells.
_MARK_CELLS = np.float32(7.0)
CELL_COLOR: Color = color_of("depth")
"""Of the outline of a cell that is picked."""
DIFFERING_COLOR: Color = color_of("conflict")
"""Of the outlines of cells of which two rules of fusion make different things."""


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


def cell_outlines(plane: MapPlane, places_m: FloatArray, height_m: float) -> Segments:
    """(4 N, 2, 3) the edges of the cells at (N, 2) places, or at one; none outside of the map."""
    step_m, cells = plane.resolution_m, plane.picture.shape[1::-1]
    cell = np.floor((np.atleast_2d(places_m) - np.array(plane.origin_m)) / step_m)
    low = plane.origin_m + step_m * cell[((cell >= 0) & (cell < cells)).all(axis=1)]
    if not len(low):
        return NO_SEGMENTS
    around = step_m * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]])
    corners = np.full((len(low), 5, 3), height_m, dtype=np.float32)
    corners[..., :2] = low[:, np.newaxis] + around
    return np.stack([corners[:, :-1], corners[:, 1:]], axis=2).reshape(-1, 2, 3)


def cell_mark(plane: MapPlane, place_m: FloatArray, height_m: float) -> Segments:
    """(8, 2, 3) the edges of the cell at an (x, y), and of a larger square around it, which is seen
    from far; none outside of the map."""
    cell = cell_outlines(plane, place_m, height_m)
    middle = cell.reshape(-1, 3).mean(axis=0) if len(cell) else 0.0
    return np.concatenate([cell, middle + _MARK_CELLS * (cell - middle)])


class MapNodes:
    """One browser's map and trajectory. They are seen where there is a pose, if the layer is on."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._is_placed, self._is_allowed = False, True
        self._frame = scene.add_frame("/in_map", show_axes=False, visible=False)
        self._path = lines(scene, "/in_map/path", LIGHT.ink, thickness_px=3.0)
        self._cell = lines(scene, "/in_map/cell", CELL_COLOR, thickness_px=3.0)
        self._differing = lines(scene, "/in_map/differing", DIFFERING_COLOR, thickness_px=2.0)
        self._plane: MapPlane | None = None
        self._image: viser.ImageHandle | None = None

    def show(self, plane: MapPlane | None, differing_m: FloatArray | None = None) -> None:
        """A map in the LiDAR's plane, None for none. ``differing_m``: (N, 2) places of the cells
        of which two rules of fusion make different things."""
        self._plane = plane
        for outlines in (self._cell, self._differing):
            outlines.empty()
        if plane is not None and differing_m is not None:
            self._differing.draw(cell_outlines(plane, differing_m, -_APART_M))
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
            self._cell.draw(cell_mark(self._plane, place_m, 0.0))

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
