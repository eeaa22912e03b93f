"""The nodes of one browser's scene. Each is added once and then only given new values."""

from typing import Any

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray, Float32Array, FloatArray
from scanloom.plots.palette import Color, class_colors, color_of
from scanloom.scene.camera_nodes import CameraNodes
from scanloom.scene.camera_views import CameraView
from scanloom.scene.depth_surface import point_at
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import NO_SEGMENTS, Segments, arrow_segments
from scanloom.scene.geometry_nodes import (
    EdgedGeometry,
    SceneGeometry,
    colors_of_segments,
    edged_dots,
    edged_lines,
    lines,
)
from scanloom.scene.glyphs import Glyphs, class_glyphs, facing, ring_segments
from scanloom.scene.layers import LAYERS
from scanloom.scene.map_nodes import MapNodes
from scanloom.scene.picking import nearest_beam
from scanloom.scene.stage_colors import HOLLOW, LIGHT, stage_colors
from scanloom.state.view import Layer

# Shares of its distance by which a line is moved towards the viewer, where it is seen at the same
# place: more than the noise of the surface that it lies on, 5 cm at 4 m.
_MATCHED_LIFT = 0.010
_CURVE_LIFT = 0.020
_DOT_LIFT = 0.024
_GLYPH_LIFT = 0.032
_MARK_LIFT = 0.036
# Widths of dots per metre of distance: 6 to 9 px on a screen of 900 px.
_SMALL_DOT, _LARGE_DOT = 0.0062, 0.0088
# Set by hand: about so many beams are told apart as a fan.
_MAX_RAYS = 72
# What an eye sees as another direction: shapes are turned to it.
_TURNED_COS = float(np.cos(np.deg2rad(8.0)))
_DISTANCE_RATIO = 1.2
_LABEL: dict[str, Any] = {"anchor": "bottom-center", "font_screen_scale": 0.9}
# Where the labels stand: in the image (down and right, each from 0 to 1), and along the beams.
_SURFACE_LABEL, _CURVE_LABEL = (0.3, 0.3), 0.88
# Of a scan alone nothing tells the floor: a grid not far below it gives the scale.
_SCAN_FLOOR_M = -0.2
# A label that would move by less stays where it is, so that none trembles while frames play.
_LABEL_STEP_M = 0.4
_NOWHERE = np.empty((0, 3), dtype=np.float32)


class SceneNodes:
    """One browser's view of a frame. ``scene`` is the browser's own; ``map`` is drawn in it.

    Calls come from one thread at a time, and inside the client's ``atomic()`` where the browser
    should see their effects together.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._layers = frozenset(LAYERS)
        self._frame: FrameGeometry | None = None
        self._marked: int | None = None
        self._hovered: tuple[int | None, tuple[float, float] | None] = None, None
        self._floor_m = float("nan")
        self._labelled: set[str] = set()
        self._is_dark = False
        self._facing = facing(np.array([-4.0, 0.0, 4.0]), np.zeros(3), np.array([0.0, 0.0, 1.0]))
        scene.set_up_direction("+z")
        self._cameras: dict[int, CameraNodes] = {}

        def edged(name: str, color: Color | None, *, px: float, edge_px: float) -> EdgedGeometry:
            return edged_lines(scene, f"/frame/{name}", color, thickness_px=px, edge_px=edge_px)

        def dots(name: str, color: Color) -> EdgedGeometry:
            return edged_dots(scene, f"/frame/{name}", color)

        self._rays = lines(scene, "/frame/rays", LIGHT.ray, thickness_px=1.0)
        self._matched = edged("matched", color_of("depth"), px=9.0, edge_px=1.0)
        self._curve = edged("curve", color_of("lidar"), px=5.5, edge_px=1.3)
        self._alone = dots("alone", color_of("lidar"))
        self._pairs = lines(scene, "/frame/pairs", None, thickness_px=2.0)
        self._pixel_dots = dots("pixels", color_of("depth"))
        self._beam_dots = dots("beams", color_of("lidar"))
        self._good_dots = dots("good", color_of("good"))
        self._glyphs = edged("classes", None, px=2.8, edge_px=1.6)
        self._moved = edged("moved", None, px=2.4, edge_px=1.3)
        self._filled = dots("filled", HOLLOW)
        self._mark = edged("mark", LIGHT.ink, px=2.0, edge_px=0.0)
        self._hover = edged("hover", LIGHT.ink, px=2.5, edge_px=0.0)
        self._of_layer: dict[Layer, tuple[SceneGeometry | EdgedGeometry, ...]] = {
            "rays": (self._rays,),
            "matched": (self._matched,),
            "curve": (self._curve, self._alone, self._mark, self._hover),
            "pairs": (self._pairs, self._pixel_dots, self._beam_dots),
            "classes": (self._good_dots, self._glyphs),
            "repairs": (self._moved, self._filled),
        }
        self._lidar = scene.add_cylinder(
            "/lidar",
            0.06,
            0.07,
            color=LIGHT.lidar_body,
            # Without a graphics card the shader of the standard material takes seconds to compile.
            material="toon3",
            cast_shadow=False,
            visible=False,
        )
        # A label goes with its node: it is placed once.
        self._body_label = scene.add_label(
            "/lidar/label", "LiDAR", position=(0.0, 0.0, 0.06), **_LABEL | {"anchor": "bottom-left"}
        )
        self._labels = {
            name: scene.add_label(f"/labels/{name}", text, visible=False, **_LABEL)
            for name, text in (("curve", "LiDAR curve"), ("surface", "depth surface"))
        }
        self._floor = scene.add_grid(
            "/floor",
            width=40.0,
            height=40.0,
            cell_size=1.0,
            section_size=5.0,
            cell_color=LIGHT.cell,
            section_color=LIGHT.section,
            fade_distance=30.0,
            shadow_opacity=0.0,
            visible=False,
        )
        self.map = MapNodes(scene)

    def show(self, frame: FrameGeometry, surface_rgb: ByteArray) -> None:
        """Draw a frame instead of the one before. ``surface_rgb``: (N, 3) colours of its surface.

        Other cameras keep what they saw last, if that was of about the same instant.
        """
        self._frame = frame
        if frame.body is not None and frame.body != self._body_label.text:
            self._body_label.text = frame.body
        if tuple(self._lidar.position) != frame.body_m:
            self._lidar.position = frame.body_m
        self.show_camera(frame, surface_rgb)
        self._rays.draw(_fan(frame.beams_m))
        self._draw_facing()
        self._place_floor(_SCAN_FLOOR_M if frame.camera is None else frame.lowest_m)
        self._place_labels(frame)
        self._update_visible()

    def show_camera(self, frame: FrameGeometry, surface_rgb: ByteArray) -> None:
        """Draw what a camera saw, and nothing else of the frame."""
        if frame.camera is None or frame.frustum is None:
            return
        if frame.camera not in self._cameras:
            self._cameras[frame.camera] = CameraNodes(
                self._scene, frame.camera, frame.frustum, stage_colors(self._is_dark)
            )
        camera = self._cameras[frame.camera]
        camera.draw(frame, surface_rgb, self._facing, self._layers)

    def face(self, view: CameraView) -> None:
        """Turn lines and shapes towards a viewpoint, unless it is nearly that of before."""
        now = facing(view.position_m, view.look_at_m, view.up, view.fov_rad)
        away_m, before_m = now.eye_m - view.look_at_m, self._facing.eye_m - view.look_at_m
        distance_m, before = float(np.linalg.norm(away_m)), float(np.linalg.norm(before_m))
        if not np.isfinite(distance_m) or distance_m < 1e-6:
            return
        zoom_ratio = now.zoom / self._facing.zoom
        ratio = max(distance_m / max(before, 1e-6), before / distance_m, zoom_ratio, 1 / zoom_ratio)
        is_turned = float(away_m @ before_m) < _TURNED_COS * distance_m * before
        if ratio < _DISTANCE_RATIO and not is_turned:
            return
        self._facing = now
        if self._frame is not None:
            self._draw_facing()

    def set_dark(self, is_dark: bool) -> None:
        """Use the colours for a dark or a light ground."""
        if is_dark == self._is_dark:
            return
        self._is_dark = is_dark
        colors = stage_colors(is_dark)
        self._rays.recolor(colors.ray)
        self.map.recolor_path(colors.ink)
        self._mark.fill.recolor(colors.ink)
        self._hover.fill.recolor(colors.ink)
        self._floor.cell_color, self._floor.section_color = colors.cell, colors.section
        self._lidar.color = colors.lidar_body
        for camera in self._cameras.values():
            camera.set_colors(colors)

    def mark_beam(self, beam: int | None) -> None:
        """Highlight a beam of the scan, in this frame and the next ones; None: none."""
        self._marked = beam
        end = self._beam_end(beam)
        if end is None:
            self._mark.fill.draw(NO_SEGMENTS)
            return
        top = end + np.array([0.0, 0.0, 0.6], dtype=np.float32)
        mark = np.array([[np.zeros(3), end], [end, top]], dtype=np.float32)
        self._mark.fill.draw(self._facing.lifted(mark, _MARK_LIFT))

    def mark_hover(self, beam: int | None, place: tuple[float, float] | None = None) -> None:
        """Light up a beam that is pointed at, and the point that the camera measures for it, or at
        a place of its image (down and right, each from 0 to 1); None: none. It sends a few lines,
        and lasts until the next call."""
        self._hovered = beam, place
        frame, end = self._frame, self._beam_end(beam)
        parts: list[Segments] = []
        pixel: Float32Array | None = None
        if frame is not None and place is not None:
            pixel = point_at(frame.surface, place)
        elif frame is not None and beam is not None and 0 <= beam < len(frame.pixels_m):
            pixel = frame.pixels_m[beam]
        if pixel is not None and np.isfinite(pixel).all():
            parts.append(ring_segments(pixel[np.newaxis], self._facing, 0.6))
        if end is not None:
            parts.append(np.array([[np.zeros(3), end]], dtype=np.float32))
            parts.append(ring_segments(end[np.newaxis], self._facing, 1.3))
        shown = np.concatenate(parts) if parts else NO_SEGMENTS
        self._hover.fill.draw(self._facing.lifted(shown, _MARK_LIFT))

    def show_layers(self, layers: frozenset[Layer]) -> None:
        """Show these layers and hide the others. What a layer shows of the current frame is drawn
        by the next ``show``."""
        self._layers = layers
        self._update_visible()

    def pick(self, ray_origin_m: FloatArray, ray_direction: FloatArray) -> int | None:
        """The beam that the ray of a click hits, None if it misses."""
        if self._frame is None or "curve" not in self._layers:
            return None
        return nearest_beam(self._frame.beams_m, ray_origin_m, ray_direction)

    def hide_frame(self) -> None:
        """Hide the frame until the next one; floor and map stay."""
        self._frame = None
        self._empty_frame()
        self._update_visible()

    def clear(self) -> None:
        """Hide everything, as before the first frame."""
        self._frame, self._marked, self._floor_m = None, None, float("nan")
        for camera in self._cameras.values():
            camera.remove()
        self._cameras = {}
        self._empty_frame()
        self.map.clear()
        self._lidar.visible = self._floor.visible = False

    def _draw_facing(self) -> None:
        """Draw what is turned to the viewer."""
        frame, eye, codes = self._frame, self._facing, class_colors()
        assert frame is not None, "there is a frame to be drawn"
        self._matched.draw(frame.matched_m, eye, _MATCHED_LIFT)
        self._curve.draw(frame.curve_m, eye, _CURVE_LIFT)
        self._alone.draw_dots(frame.alone_m, eye, _LARGE_DOT, _DOT_LIFT)
        self._pairs.draw(
            eye.lifted(frame.pairs_m, _DOT_LIFT), colors_of_segments(codes[frame.pairs_class])
        )
        self._pixel_dots.draw_dots(frame.pairs_m[:, 1], eye, _SMALL_DOT, _DOT_LIFT)
        self._beam_dots.draw_dots(frame.pairs_m[:, 0], eye, _SMALL_DOT, _DOT_LIFT)
        if "classes" in self._layers:
            self._draw_classes(class_glyphs(frame.marks_m, frame.marks_class, eye))
        arrows_m, arrows_class = arrow_segments(frame.moved_m, frame.moved_class)
        self._moved.draw(arrows_m, eye, _GLYPH_LIFT, colors_of_segments(codes[arrows_class]))
        self._filled.draw_dots(frame.filled_m, eye, _SMALL_DOT, _DOT_LIFT)
        self.mark_beam(self._marked)
        self.mark_hover(*self._hovered)

    def _draw_classes(self, shapes: Glyphs) -> None:
        colors = colors_of_segments(class_colors()[shapes.lines_class])
        self._good_dots.draw_dots(shapes.dots_m, self._facing, _LARGE_DOT, _DOT_LIFT)
        self._glyphs.draw(shapes.lines_m, self._facing, _GLYPH_LIFT, colors)

    def _beam_end(self, beam: int | None) -> Float32Array | None:
        beams_m = self._frame.beams_m if self._frame is not None else _NOWHERE
        if beam is None or not 0 <= beam < len(beams_m) or not np.isfinite(beams_m[beam]).all():
            return None
        end: Float32Array = beams_m[beam]
        return end

    def _empty_frame(self) -> None:
        for drawn in self._geometry():
            drawn.empty()

    def _geometry(self) -> list[SceneGeometry]:
        """Every node of points or lines that belongs to the frame."""
        return [node for layer in self._of_layer for node in self._nodes_of(layer)]

    def _nodes_of(self, layer: Layer) -> list[SceneGeometry]:
        nodes: list[SceneGeometry] = []
        for drawn in self._of_layer.get(layer, ()):
            nodes += [drawn.edge, drawn.fill] if isinstance(drawn, EdgedGeometry) else [drawn]
        return nodes

    def _place_floor(self, lowest_m: float) -> None:
        # The lowest so far: a frame that does not see the floor does not raise it.
        if np.isnan(lowest_m) or lowest_m > self._floor_m - 0.03:
            return
        self._floor_m = lowest_m
        self._floor.position = (0.0, 0.0, lowest_m)

    def _place_labels(self, frame: FrameGeometry) -> None:
        """The surface's label above its middle, the curve's at the left of what both see."""
        self._place_label("surface", point_at(frame.surface, _SURFACE_LABEL))
        seen = np.flatnonzero(np.isfinite(frame.pixels_m[:, 0]) & np.isfinite(frame.beams_m[:, 0]))
        if not seen.size:
            seen = np.flatnonzero(np.isfinite(frame.beams_m[:, 0]))
        if seen.size:
            # Beams count to the left.
            leftmost = seen[round((seen.size - 1) * _CURVE_LABEL)]
            self._place_label("curve", frame.beams_m[leftmost])
        else:
            self._place_label("curve", None)

    def _place_label(self, name: str, point_m: Float32Array | None) -> None:
        label = self._labels[name]
        if point_m is None:
            self._labelled.discard(name)
            return
        is_new = name not in self._labelled
        if is_new or np.linalg.norm(point_m - label.position) > _LABEL_STEP_M:
            label.position = point_m.astype(np.float64)
        self._labelled.add(name)

    def _update_visible(self) -> None:
        layers, frame = self._layers, self._frame
        for layer in self._of_layer:
            for drawn in self._nodes_of(layer):
                drawn.allow(layer in layers)
        for number, camera in self._cameras.items():
            camera.update_visible(
                None if frame is None else frame.stamp_ns,
                layers,
                has_label=frame is not None and number == frame.camera,
            )
        for name, label in self._labels.items():
            label.visible = frame is not None and "labels" in layers and name in self._labelled
        self.map.allow("map" in layers)
        has_body = frame is not None and frame.body is not None
        self._lidar.visible = has_body and "sensors" in layers
        self._floor.visible = "floor" in layers and not np.isnan(self._floor_m)


def _fan(beams_m: Float32Array) -> Segments:
    """(N, 2, 3) from the LiDAR to the ends of some of its beams."""
    ends = beams_m[np.isfinite(beams_m[:, 0])]
    ends = ends[:: max(1, -(-len(ends) // _MAX_RAYS))]
    return np.stack([np.zeros_like(ends), ends], axis=1)
