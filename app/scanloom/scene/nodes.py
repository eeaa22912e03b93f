"""The nodes of one browser's scene. Each is added once and then only given new values."""

from dataclasses import dataclass

import numpy as np
import viser

from fusion_core.model.conventions import (
    NS_PER_MS,
    ByteArray,
    FloatArray,
    read_only,
)
from scanloom.plots.palette import Color, class_colors, color_of
from scanloom.plots.png import show_picture
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import NO_SEGMENTS, arrow_segments, path_segments, quaternion
from scanloom.scene.geometry_nodes import colors_of_segments, depth_colors, lines, points
from scanloom.scene.image_planes import ImagePlane
from scanloom.scene.layers import LAYERS, Layer
from scanloom.scene.picking import nearest_beam

# Set by hand: the cameras of a panorama trigger one after the other within this time.
_TOGETHER_NS = 150 * NS_PER_MS
_GREY: Color = (120, 128, 138)
# Coplanar layers are drawn with a small offset against z-fighting.
_APART_M = 0.01


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


@dataclass(frozen=True, slots=True, kw_only=True)
class PickResult:
    """What a click hit: a pixel (x_px, y_px) of the image plane ``plane``, or a beam."""

    plane: str | None = None
    pixel: tuple[float, float] | None = None
    beam: int | None = None


class SceneNodes:
    """One browser's view of a frame. ``scene`` is the browser's own.

    Calls come from one thread at a time, and inside the client's ``atomic()`` where the browser
    should see their effects together.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._layers = frozenset(LAYERS)
        self._frame: FrameGeometry | None = None
        self._marked: int | None = None
        self._floor_m = float("nan")
        self._in_a_map = False
        scene.set_up_direction("+z")
        self._cameras: dict[int, _CameraNodes] = {}
        self._matched = lines(scene, "/frame/matched", color_of("depth"), thickness_px=3.5)
        self._curve = lines(scene, "/frame/curve", color_of("lidar"), thickness_px=2.5)
        self._beams = points(scene, "/frame/beams", color_of("lidar"), size_m=0.014)
        self._pairs = lines(scene, "/frame/pairs", None, thickness_px=1.5)
        self._moved = lines(scene, "/frame/moved", None, thickness_px=2.0)
        self._filled = points(scene, "/frame/filled", _GREY, size_m=0.022)
        self._mark = lines(scene, "/frame/mark", color_of("fused"), thickness_px=1.5)
        self._of_frame = (
            self._matched,
            self._curve,
            self._beams,
            self._pairs,
            self._moved,
            self._filled,
            self._mark,
        )
        self._lidar = scene.add_cylinder(
            "/lidar",
            0.05,
            0.05,
            color=(70, 75, 82),
            # Without a graphics card the shader of the standard material takes seconds to compile.
            material="toon3",
            cast_shadow=False,
            visible=False,
        )
        self._floor = scene.add_grid(
            "/floor",
            width=40.0,
            height=40.0,
            cell_size=1.0,
            section_size=5.0,
            cell_color=(226, 229, 233),
            section_color=(200, 205, 211),
            fade_distance=30.0,
            shadow_opacity=0.0,
            visible=False,
        )
        self._in_map = scene.add_frame("/in_map", show_axes=False, visible=False)
        self._path = lines(scene, "/in_map/path", color_of("fused"), thickness_px=2.0)
        self._map: viser.ImageHandle | None = None
        self._planes: dict[str, tuple[ImagePlane, viser.ImageHandle]] = {}

    def show(self, frame: FrameGeometry) -> None:
        """Draw a frame instead of the one before.

        Other cameras keep what they saw last, if that was of about the same instant.
        """
        self._frame = frame
        if frame.camera not in self._cameras:
            self._cameras[frame.camera] = _CameraNodes(self._scene, frame)
        self._cameras[frame.camera].draw(frame)
        codes = class_colors()
        self._matched.draw(frame.matched_m)
        self._curve.draw(frame.curve_m)
        self._beams.draw(frame.beams_m[np.isfinite(frame.beams_m[:, 0])])
        self._pairs.draw(frame.pairs_m, colors_of_segments(codes[frame.pairs_class]))
        arrows_m, arrows_class = arrow_segments(frame.moved_m, frame.moved_class)
        self._moved.draw(arrows_m, colors_of_segments(codes[arrows_class]))
        self._filled.draw(frame.filled_m, codes[frame.filled_class])
        self._place_floor(frame.lowest_m)
        self.mark_beam(self._marked)
        self._update_visible()

    def show_color(self, camera: int, rgb: ByteArray | None) -> None:
        """The upright colour image in a camera's frustum, None for none."""
        if camera in self._cameras:
            self._cameras[camera].frustum.image = rgb

    def mark_beam(self, beam: int | None) -> None:
        """Highlight a beam of the scan, in this frame and the next ones; None: none."""
        self._marked = beam
        beams_m = self._frame.beams_m if self._frame is not None else np.empty((0, 3))
        if beam is None or beam >= len(beams_m) or not np.isfinite(beams_m[beam]).all():
            self._mark.draw(NO_SEGMENTS)
            return
        foot = beams_m[beam]
        top = foot + np.array([0.0, 0.0, 0.6], dtype=np.float32)
        self._mark.draw(np.array([[np.zeros(3), foot], [foot, top]], dtype=np.float32))

    def show_map(self, plane: MapPlane | None) -> None:
        """A map on the floor, None for none."""
        if plane is None:
            if self._map is not None:
                self._map.visible = False
            return
        width_m, height_m = map(float, plane.size_m)
        if self._map is None:
            self._map = self._scene.add_image(
                "/in_map/map",
                plane.picture,
                width_m,
                height_m,
                format="png",
                cast_shadow=False,
                receive_shadow=False,
                # Seen from above: its own axes are right, down and into the floor.
                wxyz=(0.0, 1.0, 0.0, 0.0),
            )
        else:
            self._map.image = plane.picture
            self._map.render_width, self._map.render_height = width_m, height_m
        x_m, y_m = plane.origin_m
        self._map.position = (x_m + 0.5 * width_m, y_m + 0.5 * height_m, _APART_M)
        self._map.visible = True

    def show_path(self, positions_in_map: FloatArray) -> None:
        """The LiDAR's trajectory, (N, 2) or (N, 3), on the floor; NaN where no pose is known."""
        on_floor = np.full((len(positions_in_map), 3), 2.0 * _APART_M)
        on_floor[:, :2] = positions_in_map[:, :2]
        self._path.draw(path_segments(on_floor))

    def place_map(self, T_map_lidar: FloatArray | None) -> None:
        """Place map and path around the LiDAR by its pose in the map; None (no pose) hides them."""
        if T_map_lidar is not None:
            R_lidar_map = T_map_lidar[:3, :3].T
            x_m, y_m, _ = -R_lidar_map @ T_map_lidar[:3, 3]
            floor_m = 0.0 if np.isnan(self._floor_m) else self._floor_m
            self._in_map.wxyz = quaternion(R_lidar_map)
            self._in_map.position = (x_m, y_m, floor_m)
        self._in_a_map = T_map_lidar is not None
        self._in_map.visible = self._in_a_map and "map" in self._layers

    def show_image_plane(self, image_plane: ImagePlane) -> None:
        """Display a picture on its plane; one of the same name is replaced."""
        shown = self._planes.get(image_plane.name)
        plane = image_plane.plane
        if shown is None:
            handle = self._scene.add_image(
                f"/images/{image_plane.name}",
                image_plane.rgb,
                plane.width_m,
                plane.height_m,
                format="png",
                cast_shadow=False,
                receive_shadow=False,
                wxyz=plane.wxyz,
                position=plane.position_m,
            )
        else:
            handle = shown[1]
            if not np.array_equal(shown[0].rgb, image_plane.rgb):
                show_picture(handle, image_plane.rgb)
            handle.render_width, handle.render_height = plane.width_m, plane.height_m
            handle.wxyz, handle.position = np.array(plane.wxyz), np.array(plane.position_m)
        handle.visible = "images" in self._layers
        self._planes[image_plane.name] = (image_plane, handle)

    def show_layers(self, layers: frozenset[Layer]) -> None:
        """Show these layers and hide the others."""
        self._layers = layers
        self._update_visible()

    def pick(self, ray_origin_m: FloatArray, ray_direction: FloatArray) -> PickResult | None:
        """The pixel or beam that the ray of a click hits, None if it misses."""
        if "images" in self._layers:
            hits = [
                (*image_plane.plane.hit(ray_origin_m, ray_direction), name)
                for name, (image_plane, _) in self._planes.items()
            ]
            hits = [hit for hit in hits if np.isfinite(hit[2])]
            if hits:
                x_px, y_px, _, name = min(hits, key=lambda hit: hit[2])
                return PickResult(plane=name, pixel=(x_px, y_px))
        if self._frame is None or "curve" not in self._layers:
            return None
        beam = nearest_beam(self._frame.beams_m, ray_origin_m, ray_direction)
        return None if beam is None else PickResult(beam=beam)

    def hide_image_plane(self, name: str) -> None:
        """Hide a picture until the next one of its name."""
        shown = self._planes.pop(name, None)
        if shown is not None:
            shown[1].remove()

    def hide_frame(self) -> None:
        """Hide the frame until the next one; floor and map stay."""
        self._frame = None
        for drawn in self._of_frame:
            drawn.empty()
        self._update_visible()

    def clear(self) -> None:
        """Hide everything, as before the first frame."""
        self._frame, self._marked, self._floor_m = None, None, float("nan")
        for camera in self._cameras.values():
            camera.remove()
        for _, handle in self._planes.values():
            handle.remove()
        self._cameras, self._planes = {}, {}
        for drawn in (*self._of_frame, self._path):
            drawn.empty()
        self.show_map(None)
        self.place_map(None)
        self._lidar.visible = self._floor.visible = False

    def _place_floor(self, lowest_m: float) -> None:
        # The lowest so far: a frame that does not see the floor does not raise it.
        if np.isnan(lowest_m) or lowest_m > self._floor_m - 0.03:
            return
        self._floor_m = lowest_m
        self._floor.position = (0.0, 0.0, lowest_m)
        self._in_map.position = (*self._in_map.position[:2], lowest_m)

    def _update_visible(self) -> None:
        layers, frame = self._layers, self._frame
        for layer, drawn in (
            ("matched", self._matched),
            ("curve", self._curve),
            ("curve", self._beams),
            ("pairs", self._pairs),
            ("repairs", self._moved),
            ("repairs", self._filled),
        ):
            drawn.allow(layer in layers)
        for camera in self._cameras.values():
            near = frame is not None and abs(camera.stamp_ns - frame.stamp_ns) <= _TOGETHER_NS
            camera.rows.allow(near and "rows" in layers)
            camera.frustum.visible = near and "camera" in layers
        for _, handle in self._planes.values():
            handle.visible = "images" in layers
        self._in_map.visible = self._in_a_map and "map" in layers
        self._lidar.visible = frame is not None
        self._floor.visible = "floor" in layers and not np.isnan(self._floor_m)


class _CameraNodes:
    """Rows and frustum of one camera, as it saw them last."""

    def __init__(self, scene: viser.SceneApi, frame: FrameGeometry) -> None:
        folder = f"/cameras/{frame.camera}"
        self.stamp_ns = frame.stamp_ns
        self.rows = lines(scene, f"{folder}/rows", None, thickness_px=1.0)
        self.frustum = scene.add_camera_frustum(
            f"{folder}/frustum",
            frame.frustum.fov_rad,
            frame.frustum.aspect,
            scale=0.15,
            thickness=1.5,
            thickness_units="screen",
            color=color_of("depth"),
            format="jpeg",
            cast_shadow=False,
            visible=False,
        )

    def draw(self, frame: FrameGeometry) -> None:
        self.stamp_ns = frame.stamp_ns
        self.rows.draw(frame.rows_m, colors_of_segments(depth_colors(frame.rows_depth_m)))
        self.frustum.fov, self.frustum.aspect = frame.frustum.fov_rad, frame.frustum.aspect
        self.frustum.wxyz = frame.frustum.wxyz
        self.frustum.position = frame.frustum.position_m

    def remove(self) -> None:
        self.rows.remove()
        self.frustum.remove()
