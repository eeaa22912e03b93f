"""A piece of the map frame on paper, seen from above: lines and dots in metres, y upwards."""

from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray
from scanloom.plots.palette import Color
from scanloom.plots.sheet import Box

# Fractions of a pixel that OpenCV draws with.
_SHIFT = 4
_FAR_PX = 30_000.0
_LIGHT: Color = (255, 255, 255)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Canvas:
    """``box`` of ``sheet`` shows the map frame from ``low_m``, (x, y) at its lower left corner."""

    sheet: ByteArray
    box: Box
    low_m: FloatArray
    px_per_m: float

    def places(self, points_m: FloatArray) -> FloatArray:
        """(N, 2) pixels of (N, >= 2) points, counted from the box's upper left corner."""
        places_px = (points_m[:, :2] - self.low_m) * self.px_per_m
        places_px[:, 1] = self.box.height - places_px[:, 1]
        # The middle of the first pixel is 0.
        return np.clip(places_px - 0.5, -_FAR_PX, _FAR_PX)

    def way(self, points_m: FloatArray, color: Color, thickness_px: int = 2) -> None:
        """A line through points, in order."""
        if len(points_m) > 1:
            fixed = np.rint(self.places(points_m) * (1 << _SHIFT)).astype(np.int32)
            cv2.polylines(self._part, [fixed], False, color, thickness_px, cv2.LINE_AA, _SHIFT)

    def stretches(self, points_m: FloatArray, marked: BoolArray, color: Color) -> None:
        """Those parts of a way, (N, 2), whose points are ``marked``, (N,)."""
        turns = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
        for first, end in zip(turns[::2], turns[1::2], strict=True):
            self.way(points_m[first:end], color, 3)
            self.dots(points_m[first:end], color, 2)

    def links(self, ends_m: FloatArray, color: Color) -> None:
        """(L, 4) lines from x, y to x, y, with a dot at each end."""
        fixed = np.rint(self.places(ends_m.reshape(-1, 2)) * (1 << _SHIFT)).astype(np.int32)
        lines = list(fixed.reshape(-1, 2, 2))
        cv2.polylines(self._part, lines, False, color, 1, cv2.LINE_AA, _SHIFT)
        self.dots(ends_m.reshape(-1, 2), color, 2)

    def dots(self, points_m: FloatArray, color: Color | ByteArray, radius_px: int) -> None:
        """Filled circles, of one colour or of (N, 3), the last on top."""
        colors = np.broadcast_to(np.array(color, dtype=np.uint8), (len(points_m), 3)).tolist()
        fixed = np.rint(self.places(points_m) * (1 << _SHIFT)).astype(np.int32).tolist()
        for place, one in zip(fixed, colors, strict=True):
            cv2.circle(self._part, place, radius_px << _SHIFT, one, cv2.FILLED, cv2.LINE_AA, _SHIFT)

    def headings(self, poses: FloatArray, colors: ByteArray, length_px: float) -> None:
        """A stroke from each (N, 3) pose to where it looks, in its (N, 3) colour."""
        along = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        ends_m = poses[:, :2] + along * (length_px / self.px_per_m)
        for begin, end, color in zip(
            np.rint(self.places(poses) * (1 << _SHIFT)).astype(np.int32).tolist(),
            np.rint(self.places(ends_m) * (1 << _SHIFT)).astype(np.int32).tolist(),
            colors.tolist(),
            strict=True,
        ):
            cv2.line(self._part, begin, end, color, 1, cv2.LINE_AA, _SHIFT)

    def ring(self, point_m: FloatArray, color: Color) -> None:
        """A small circle, as where a way begins."""
        place = np.rint(self.places(point_m[np.newaxis])[0] * (1 << _SHIFT)).astype(np.int32)
        for tint, thickness in ((_LIGHT, cv2.FILLED), (color, 1)):
            cv2.circle(
                self._part, place.tolist(), 5 << _SHIFT, tint, thickness, cv2.LINE_AA, _SHIFT
            )

    def arrow(self, pose: FloatArray, color: Color) -> None:
        """A small triangle that looks where the (3,) pose does."""
        angles = pose[2] + np.array([0.0, 2.4, -2.4])
        corners_m = pose[:2] + np.column_stack([np.cos(angles), np.sin(angles)]) * (
            np.array([[12.0], [9.0], [9.0]]) / self.px_per_m
        )
        fixed = np.rint(self.places(corners_m) * (1 << _SHIFT)).astype(np.int32)
        cv2.polylines(self._part, [fixed], True, _LIGHT, 3, cv2.LINE_AA, _SHIFT)
        cv2.fillPoly(self._part, [fixed], color, cv2.LINE_AA, _SHIFT)

    def lattice(self, step_m: float, color: Color) -> None:
        """A line at each multiple of a length."""
        part = self._part
        size_m = np.array([self.box.width, self.box.height]) / self.px_per_m
        for axis in (0, 1):
            low = self.low_m[axis]
            values = step_m * np.arange(
                np.ceil(low / step_m), np.floor((low + size_m[axis]) / step_m) + 1
            )
            for value in values:
                px = round(float(value - low) * self.px_per_m - 0.5)
                if axis == 0:
                    part[:, min(max(px, 0), self.box.width - 1)] = color
                else:
                    part[min(max(self.box.height - 1 - px, 0), self.box.height - 1)] = color

    @property
    def _part(self) -> ByteArray:
        """What is drawn into it stays inside of the box."""
        return self.box.view(self.sheet)


def canvas_for(sheet: ByteArray, box: Box, low_m: FloatArray, high_m: FloatArray) -> Canvas:
    """The largest scale at which a box shows all from ``low_m`` to ``high_m``, in its middle."""
    size_px = np.array([box.width, box.height])
    px_per_m = float((size_px / (high_m - low_m)).min())
    return Canvas(
        sheet=sheet,
        box=box,
        low_m=0.5 * (low_m + high_m) - 0.5 * size_px / px_per_m,
        px_per_m=px_per_m,
    )
