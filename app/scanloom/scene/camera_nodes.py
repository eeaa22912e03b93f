"""What one camera sees, in a browser's scene."""

import viser

from fusion_core.model.conventions import NS_PER_MS, ByteArray
from scanloom.scene.frame_geometry import FrameGeometry
from scanloom.scene.geometry import Frustum
from scanloom.scene.geometry_nodes import lines, squares
from scanloom.scene.glyphs import Facing
from scanloom.scene.stage_colors import StageColors
from scanloom.state.view import Layer

# Set by hand: the cameras of a panorama trigger one after the other within this time.
TOGETHER_NS = 150 * NS_PER_MS
# Share of the distance by which rows are drawn before the squares of their surface.
_ROW_LIFT = 0.005


class CameraNodes:
    """Surface, rows and frustum of one camera, as it saw them last."""

    def __init__(
        self, scene: viser.SceneApi, camera: int, frustum: Frustum, colors: StageColors
    ) -> None:
        folder = f"/cameras/{camera}"
        self.stamp_ns = 0
        self._surface = squares(scene, f"{folder}/surface")
        self._rows = lines(scene, f"{folder}/rows", colors.row, thickness_px=1.0)
        self._frustum = scene.add_camera_frustum(
            f"{folder}/frustum",
            frustum.fov_rad,
            frustum.aspect,
            scale=0.12,
            thickness=2.0,
            thickness_units="screen",
            color=colors.camera,
            cast_shadow=False,
            visible=False,
        )
        self._label = scene.add_label(
            f"{folder}/frustum/label",
            "depth camera",
            # Away from the LiDAR's, which stands to the right: from above both are in one place.
            anchor="top-right",
            font_screen_scale=0.9,
        )

    def draw(
        self,
        frame: FrameGeometry,
        surface_rgb: ByteArray,
        seen_from: Facing,
        layers: frozenset[Layer],
    ) -> None:
        """What the camera sees now. ``surface_rgb``: (N, 3) colours of its surface's points."""
        self.stamp_ns = frame.stamp_ns
        # What is not of this instant was hidden, and nothing hidden is sent.
        self.update_visible(frame.stamp_ns, layers, has_label=False)
        self._surface.resize(frame.surface.point_m)
        self._surface.draw(frame.surface.points_m, surface_rgb)
        self._rows.draw(seen_from.lifted(frame.rows_m, _ROW_LIFT))
        if frame.frustum is not None:
            self._frustum.fov, self._frustum.aspect = frame.frustum.fov_rad, frame.frustum.aspect
            self._frustum.wxyz = frame.frustum.wxyz
            self._frustum.position = frame.frustum.position_m

    def set_colors(self, colors: StageColors) -> None:
        """The colours for another ground."""
        self._rows.recolor(colors.row)
        self._frustum.color = colors.camera

    def update_visible(
        self, stamp_ns: int | None, layers: frozenset[Layer], *, has_label: bool
    ) -> None:
        """Show the layers of the camera, if what it saw is of about the same instant.
        ``has_label``: of several cameras one is named."""
        near = stamp_ns is not None and abs(self.stamp_ns - stamp_ns) <= TOGETHER_NS
        self._surface.allow(near and "surface" in layers)
        self._rows.allow(near and "rows" in layers)
        self._frustum.visible = near and "sensors" in layers
        self._label.visible = has_label

    def remove(self) -> None:
        """Take the camera out of the scene."""
        self._surface.remove()
        self._rows.remove()
        # Its label goes with it.
        self._frustum.remove()
