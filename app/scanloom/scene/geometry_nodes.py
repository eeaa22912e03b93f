"""Points and line segments in a browser's scene: added once, then given new values."""

import numpy as np
import viser

from fusion_core.model.conventions import ByteArray, Float32Array
from scanloom.plots.palette import Color
from scanloom.scene.geometry import Segments
from scanloom.scene.glyphs import Facing
from scanloom.scene.stage_colors import OUTLINE

# A browser draws points twice as wide as their size says.
_SIZE_PER_WIDTH = 0.5

# The edge of a line lies behind it by this share of its distance.
_EDGE_BEHIND = 0.006
# An edge of 1.3 px around a dot of 6 to 9 px.
_EDGED_WIDTH = 1.45
# Widths are steps of this ratio, so that they seldom change from frame to frame.
_WIDTH_STEP = 1.15

_SRGB = np.arange(256) / 255.0
_INTENSITIES = np.rint(
    255.0 * np.where(_SRGB <= 0.04045, _SRGB / 12.92, ((_SRGB + 0.055) / 1.055) ** 2.4)
).astype(np.uint8)


class SceneGeometry:
    """A node of points or segments, hidden while it has none or its layer is off."""

    def __init__(self, handle: viser.LineSegmentsHandle | viser.PointCloudHandle) -> None:
        self._handle = handle
        self._filled, self._allowed = False, True

    def draw(self, points_m: Float32Array, colors: ByteArray | None = None) -> None:
        """Set the points; ``colors``: one for each, None keeps those of a node in one colour.
        Nothing is sent while the layer is off."""
        self._filled = len(points_m) > 0
        if self._filled and self._allowed:
            self._handle.points = points_m
            if colors is not None:
                self._handle.colors = colors
        self._handle.visible = self._filled and self._allowed

    def recolor(self, color: Color) -> None:
        """Another colour for a node in one colour."""
        self._handle.colors = np.array(color, dtype=np.uint8)

    def resize(self, size_m: float) -> None:
        """Another width of points."""
        half_m = _SIZE_PER_WIDTH * size_m
        if isinstance(self._handle, viser.PointCloudHandle) and self._handle.point_size != half_m:
            self._handle.point_size = half_m

    def empty(self) -> None:
        """Draw nothing."""
        self._filled = False
        self._handle.visible = False

    def allow(self, allowed: bool) -> None:
        """Whether the node may be seen; what was drawn while it might not is to be drawn again."""
        self._allowed = allowed
        self._handle.visible = self._filled and allowed

    def remove(self) -> None:
        """Take the node out of the scene."""
        self._handle.remove()


class EdgedGeometry:
    """Lines or dots with a dark edge, which lies a little behind them."""

    def __init__(self, fill: SceneGeometry, edge: SceneGeometry) -> None:
        self.fill, self.edge = fill, edge

    def draw(
        self, points_m: Float32Array, eye: Facing, lift: float, colors: ByteArray | None = None
    ) -> None:
        """Draw (..., 3) points, moved towards the eye by a share of their distance."""
        self.edge.draw(eye.lifted(points_m, lift - _EDGE_BEHIND))
        self.fill.draw(eye.lifted(points_m, lift), colors)

    def draw_dots(self, points_m: Float32Array, eye: Facing, width: float, lift: float) -> None:
        """Draw (N, 3) dots, of a width per metre of their median distance."""
        if len(points_m):
            distance_m = float(np.median(eye.distance_m(points_m)))
            width_m = width * max(distance_m, 0.1)
            width_m = _WIDTH_STEP ** float(np.round(np.log(width_m) / np.log(_WIDTH_STEP)))
            self.fill.resize(width_m)
            self.edge.resize(_EDGED_WIDTH * width_m)
        self.draw(points_m, eye, lift)


def colors_of_segments(colors: ByteArray) -> ByteArray:
    """(N, 3) colours of segments as (N, 2, 3) of their ends.

    A line's colours, unlike those of points and of whole nodes, are drawn as intensities, without
    the gamma of sRGB; it is taken out here, so that a class looks the same everywhere.
    """
    of_ends: ByteArray = np.repeat(intensities(colors)[:, np.newaxis], 2, axis=1)
    return of_ends


def intensities(colors: ByteArray) -> ByteArray:
    """Colours as they must be sent where a browser draws them without the gamma of sRGB: those of
    segments, and of the meshes of a batch."""
    linear: ByteArray = _INTENSITIES[colors]
    return linear


def lines(
    scene: viser.SceneApi, name: str, color: Color | None, *, thickness_px: float
) -> SceneGeometry:
    """Segments of one colour, or (None) of a colour each.

    A browser settles with the first colours which of the two it is.
    """
    nothing: Segments = np.zeros((1, 2, 3), dtype=np.float32)
    return SceneGeometry(
        scene.add_line_segments(
            name,
            nothing,
            np.zeros((1, 2, 3), dtype=np.uint8) if color is None else color,
            thickness=thickness_px,
            thickness_units="screen",
            visible=False,
        )
    )


def points(scene: viser.SceneApi, name: str, color: Color) -> SceneGeometry:
    """Dots of one colour, of a width that is still to be set."""
    return SceneGeometry(
        scene.add_point_cloud(
            name,
            np.zeros((1, 3), dtype=np.float32),
            color,
            point_size=0.01,
            point_shape="circle",
            point_shading="flat",
            # Half precision is 4 mm at 8 m, as much as a LiDAR's noise.
            precision="float32",
            visible=False,
        )
    )


def edged_lines(
    scene: viser.SceneApi, name: str, color: Color | None, *, thickness_px: float, edge_px: float
) -> EdgedGeometry:
    """As ``lines``, with an edge on both sides."""
    edge = lines(scene, f"{name}_edge", OUTLINE, thickness_px=thickness_px + 2.0 * edge_px)
    return EdgedGeometry(lines(scene, name, color, thickness_px=thickness_px), edge)


def edged_dots(scene: viser.SceneApi, name: str, color: Color) -> EdgedGeometry:
    """As ``points``, with an edge."""
    edge = points(scene, f"{name}_edge", OUTLINE)
    return EdgedGeometry(points(scene, name, color), edge)


def squares(scene: viser.SceneApi, name: str) -> SceneGeometry:
    """Square points with a colour each, for surfaces: 4 mm exact within 8 m."""
    return SceneGeometry(
        scene.add_point_cloud(
            name,
            np.zeros((1, 3), dtype=np.float16),
            np.zeros((1, 3), dtype=np.uint8),
            point_size=0.02,
            point_shape="square",
            point_shading="flat",
            precision="float16",
            visible=False,
        )
    )
