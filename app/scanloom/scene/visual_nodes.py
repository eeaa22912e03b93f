"""The map of visual SLAM in a browser's scene: cloud or boxes, keyframes, path, loops, a grid."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray, read_only
from scanloom.plots.palette import Color, color_of
from scanloom.scene.geometry import NO_SEGMENTS, path_segments, quaternion
from scanloom.scene.geometry_nodes import intensities, lines
from scanloom.scene.map_nodes import CELL_COLOR, MapPlane, cell_mark
from scanloom.scene.stage_colors import StageColors, stage_colors
from scanloom.scene.visual_picture import VisualPicture
from scanloom.scene.visual_shapes import (
    USUAL_VIEW,
    Boxes,
    HalfView,
    keyframe_segments,
    loop_segments,
)
from scanloom.state.view import Layer

ROOT = "/visual"
# Of the keyframes that are picked, with their images: large enough for these to be seen.
_PICKED_DEPTH_M = 0.25
_NOW_DEPTH_M = 0.16
_LOST: Color = (214, 39, 40)
# A browser draws points twice as wide as their size says.
_SIZE_PER_WIDTH = 0.5
_UNIT_CUBE = np.array(
    [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)], dtype=np.float32
)
_CUBE_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    dtype=np.uint32,
)  # fmt: skip
# Neighbouring boxes are told apart by a gap.
_BOX_FILL = 0.94
# The grid lies a little below the floor's points.
_GRID_HEIGHT_M = -0.01
_SHARP_PX = 1024


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PickedKeyframe:
    """A keyframe that stands out: its (4, 4) pose, its (H, W, 3) image and its colour."""

    T_map_camera: FloatArray
    image: ByteArray
    color: Color

    def __post_init__(self) -> None:
        read_only(self.T_map_camera)
        read_only(self.image)


class VisualNodes:
    """One browser's visual map. Hidden until ``show``; calls come from one thread at a time."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._colors: StageColors = stage_colors(is_dark=False)
        self._layers: frozenset[Layer] = frozenset()
        self._half_view = USUAL_VIEW
        self._picture: VisualPicture | None = None
        self._has_cloud = self._has_loop = self._has_grid = self._shows_boxes = self._is_seen = (
            False
        )
        self._root = scene.add_frame(ROOT, show_axes=False, visible=False)
        self._cloud = scene.add_point_cloud(
            f"{ROOT}/cloud",
            np.zeros((1, 3), dtype=np.float32),
            np.zeros((1, 3), dtype=np.uint8),
            point_size=0.01,
            point_shape="square",
            point_shading="flat",
            precision="float32",
            visible=False,
        )
        self._path = lines(scene, f"{ROOT}/path", self._colors.ink, thickness_px=2.0)
        self._keyframes = lines(scene, f"{ROOT}/keyframes", self._colors.camera, thickness_px=1.3)
        self._loops = lines(scene, f"{ROOT}/loops", color_of("lidar"), thickness_px=4.0)
        # Seen through the cloud, which often lies before it.
        self._last_loop = scene.add_label(
            f"{ROOT}/last_loop", "", anchor="bottom-center", font_screen_scale=0.9, visible=False
        )
        self._now = lines(scene, f"{ROOT}/now", self._colors.ink, thickness_px=3.0)
        self._cell = lines(scene, f"{ROOT}/cell", CELL_COLOR, thickness_px=3.0)
        self._plane: MapPlane | None = None
        self._floor_m = 0.0
        self._boxes: viser.BatchedMeshHandle | None = None
        self._grid: viser.ImageHandle | None = None
        self._picked: list[viser.CameraFrustumHandle] = []

    @property
    def is_shown(self) -> bool:
        """Whether there is a map to be seen."""
        return self._picture is not None

    def show(self, picture: VisualPicture | None, half_view: HalfView | None = None) -> None:
        """Keyframes, path and loops; None hides the whole map. The cloud comes by ``draw_cloud``.
        ``half_view``: of the camera, None leaves it as it was."""
        self._picture = picture
        self._half_view = half_view or self._half_view
        if picture is None:
            self._has_cloud = False
            self.pick([])
            return
        self._draw_lines(picture)
        self._update_visible()

    def _draw_lines(self, picture: VisualPicture) -> None:
        self._path.draw(path_segments(picture.path_m))
        self._keyframes.draw(keyframe_segments(picture.T_map_keyframe, self._half_view))
        loops = loop_segments(picture.T_map_keyframe, picture.loops)
        self._loops.draw(loops)
        self._has_loop = len(loops) > 0
        if self._has_loop:
            self._last_loop.text = f"loop {len(loops)}"
            self._last_loop.position = loops[-1].mean(axis=0)
        self.mark_now(picture.now)
        self._now.recolor(_LOST if picture.is_lost else self._colors.ink)

    def mark_now(self, T_map_camera: FloatArray | None) -> None:
        """Where the camera is; None for nowhere."""
        self._now.draw(
            NO_SEGMENTS
            if T_map_camera is None
            else keyframe_segments(T_map_camera[np.newaxis], self._half_view, _NOW_DEPTH_M)
        )

    def draw_cloud(self, points_m: Float32Array, rgb: ByteArray, width_m: float) -> None:
        """The points to be seen, (N, 3), with their colours and their width."""
        self._has_cloud = len(points_m) > 0
        if self._has_cloud:
            self._cloud.points, self._cloud.colors = points_m, rgb
            self._cloud.point_size = _SIZE_PER_WIDTH * width_m
        self._update_visible()

    def draw_boxes(self, boxes: Boxes | None) -> None:
        """The boxes to be seen instead of the cloud, None for the cloud."""
        self._shows_boxes = boxes is not None
        # A batch keeps the number of its instances.
        if self._boxes is not None:
            self._boxes.remove()
            self._boxes = None
        if boxes is not None and len(boxes.middles_m):
            count = len(boxes.middles_m)
            self._boxes = self._scene.add_batched_meshes_simple(
                f"{ROOT}/boxes",
                _UNIT_CUBE,
                _CUBE_FACES,
                np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (count, 1)),
                boxes.middles_m,
                batched_scales=_BOX_FILL * boxes.sizes_m,
                batched_colors=intensities(boxes.rgb),
                lod="off",
                flat_shading=True,
                cast_shadow=False,
                receive_shadow=False,
            )
        self._update_visible()

    def show_grid(self, plane: MapPlane | None, floor_m: float = 0.0) -> None:
        """A grid on the plane z = ``floor_m``, None for none."""
        self._has_grid, self._plane, self._floor_m = plane is not None, plane, floor_m
        self._cell.empty()
        if plane is not None:
            width_m, height_m = map(float, plane.size_m)
            # A browser blurs the cells of a small picture.
            times = max(1, _SHARP_PX // max(plane.picture.shape[:2]))
            picture = plane.picture.repeat(times, axis=0).repeat(times, axis=1)
            if self._grid is None:
                self._grid = self._scene.add_image(
                    f"{ROOT}/grid",
                    picture,
                    width_m,
                    height_m,
                    format="png",
                    cast_shadow=False,
                    receive_shadow=False,
                    # Seen from above: its own axes are right, down and away from who looks.
                    wxyz=(0.0, 1.0, 0.0, 0.0),
                )
            else:
                self._grid.image = picture
                self._grid.render_width, self._grid.render_height = width_m, height_m
            x_m, y_m = plane.origin_m
            middle_m = x_m + 0.5 * width_m, y_m + 0.5 * height_m
            self._grid.position = (*middle_m, floor_m + _GRID_HEIGHT_M)
        self._update_visible()

    def mark_cell(self, place_m: FloatArray) -> None:
        """Outline the grid's cell at an (x, y)."""
        if self._plane is not None:
            self._cell.draw(cell_mark(self._plane, place_m, self._floor_m))

    def pick(self, frusta: Sequence[PickedKeyframe]) -> None:
        """The keyframes that stand out, instead of those before."""
        while self._picked:
            self._picked.pop().remove()
        for number, picked in enumerate(frusta):
            self._picked.append(
                self._scene.add_camera_frustum(
                    f"{ROOT}/picked_{number}",
                    self._half_view.fov_rad,
                    self._half_view.aspect,
                    scale=_PICKED_DEPTH_M,
                    thickness=3.0,
                    thickness_units="screen",
                    color=picked.color,
                    image=picked.image,
                    format="jpeg",
                    cast_shadow=False,
                    receive_shadow=False,
                    wxyz=quaternion(picked.T_map_camera[:3, :3]),
                    position=picked.T_map_camera[:3, 3],
                ),
            )
        self._update_visible()

    def show_layers(self, layers: frozenset[Layer], *, is_seen: bool) -> None:
        """Show these layers and hide the others; the whole map only where it ``is_seen``."""
        is_changed = layers != self._layers
        self._layers, self._is_seen = layers, is_seen
        self._update_visible()
        if is_changed and self._picture is not None:
            # Nothing is sent for a layer that is off.
            self._draw_lines(self._picture)

    def shows(self, layer: Layer) -> bool:
        """Whether a layer is seen."""
        return self._is_seen and layer in self._layers

    @property
    def wants_cloud(self) -> bool:
        """Whether points are seen; nothing is sent that is not."""
        return self.shows("cloud") and not self._shows_boxes

    def set_dark(self, *, is_dark: bool) -> None:
        """Use the colours for a dark or a light ground."""
        colors = stage_colors(is_dark)
        if colors is self._colors:
            return
        self._colors = colors
        self._path.recolor(colors.ink)
        self._keyframes.recolor(colors.camera)
        self._now.recolor(colors.ink)

    def _update_visible(self) -> None:
        layers = self._layers
        self._root.visible = self._picture is not None and self._is_seen
        self._path.allow("map" in layers)
        self._cell.allow("map" in layers and self._has_grid)
        self._keyframes.allow("keyframes" in layers)
        self._loops.allow("loops" in layers)
        self._last_loop.visible = self._has_loop and "loops" in layers
        for frustum in self._picked:
            frustum.visible = "keyframes" in layers
        has_cloud = self._has_cloud and not self._shows_boxes
        self._cloud.visible = has_cloud and "cloud" in layers
        if self._boxes is not None:
            self._boxes.visible = "cloud" in layers
        if self._grid is not None:
            self._grid.visible = self._has_grid and "map" in layers
