"""The LiDAR's curve before and after its repair, beside what the camera answers, to be plotted."""

from dataclasses import dataclass, fields

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.workflows.fuse.frame import FusedFrame
from scanloom.plots.line_plot import whole_limits
from scanloom.scene.frame_summary import unwrapped_deg


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeCurves:
    """(B,) arrays over the beams in view, from the right to the left as the camera sees them.

    ``azimuth_deg`` rises. Ranges in metres, NaN where missing: ``raw_m`` and ``repaired_m`` of the
    chosen classes, ``pixel_m`` of the pixels that the beams are compared with, ``camera_m`` where
    each beam meets the surface that the camera sees, ``selected_m`` that of the selected beam.
    """

    azimuth_deg: FloatArray
    repaired_m: FloatArray
    raw_m: FloatArray
    pixel_m: FloatArray
    camera_m: FloatArray
    selected_m: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            read_only(getattr(self, field.name))

    @property
    def limits_m(self) -> tuple[float, float]:
        """Whole metres around all ranges, so that they seldom change from frame to frame."""
        return whole_limits(self.repaired_m, self.raw_m, self.pixel_m, self.camera_m)


def range_curves(
    frame: FusedFrame, classes: frozenset[NoiseClass], beam: int | None
) -> RangeCurves:
    """The curves of a frame. ``classes``: whose beams are shown; ``beam``: the selected one."""
    pairs = frame.match.correspondence
    raw_m, repaired_m, camera_m = (
        pairs.lidar_range_m,
        frame.repair.lidar_range_m,
        pairs.camera_range_m,
    )
    shown = np.isin(frame.classes.lidar_class, [int(noise_class) for noise_class in classes])
    first_known_m = np.where(np.isfinite(repaired_m), repaired_m, camera_m)
    first_known_m = np.where(np.isfinite(raw_m), raw_m, first_known_m)
    is_selected = pairs.beam == (-1 if beam is None else beam)
    azimuth_deg = unwrapped_deg(pairs.azimuth_rad)
    order = np.argsort(azimuth_deg, kind="stable")
    return RangeCurves(
        azimuth_deg=azimuth_deg[order],
        repaired_m=np.where(shown, repaired_m, np.nan)[order],
        raw_m=np.where(shown, raw_m, np.nan)[order],
        pixel_m=np.where(shown, pairs.depth_as_range_m, np.nan)[order],
        camera_m=camera_m[order],
        selected_m=np.where(is_selected, first_known_m, np.nan)[order],
    )
