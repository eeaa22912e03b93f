"""Scans and depth images of a recording as the calibration without a board takes them."""

import numpy as np

from fusion_core.alignment.mount_refinement import fit_lines
from fusion_core.alignment.scan_motion import ScanMotion, estimate_motion
from fusion_core.calibration.planar.planar_frames import ScanWithPatches
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.polar import points_from_polar
from fusion_core.model.progress import Progress
from fusion_core.model.sensors import LaserScan
from fusion_core.patches.depth_patches import find_patches
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session

# Tolerances of a scan's line, as the mount's refinement has them.
_LINE_M, _LINE_PER_M = 0.03, 0.02


def observe_planar(session: Session, frames_max: int, progress: Progress) -> list[ScanWithPatches]:
    """Frames of the session's first camera, evenly spread over the recording."""
    count = session.image_count
    every = max(1, count // frames_max)
    seen = 0
    observed = []
    heading = _Heading()
    for entry in session.pairs():
        if isinstance(entry, LaserScan) or entry.camera != 0:
            continue
        seen += 1
        progress(seen, count, "collecting surfaces")
        if entry.window is None:
            continue
        scan = entry.window.scan
        motion = estimate_motion(entry.window, session.settings.time)
        heading_rad = heading.at(scan.stamp_ns, motion)
        if seen % every == 0:
            observed.append(_observe(entry, scan, motion, heading_rad, session))
    return observed


def _observe(
    entry: PairedImage,
    scan: LaserScan,
    motion: ScanMotion | None,
    heading_rad: float,
    session: Session,
) -> ScanWithPatches:
    azimuths = scan.angles_rad
    wrapped = (azimuths + np.pi) % (2.0 * np.pi) - np.pi
    valid = np.isfinite(scan.ranges_m)
    order = np.argsort(wrapped, kind="stable")
    order = order[valid[order]]
    points = points_from_polar(scan.ranges_m[order], wrapped[order])
    tolerance = _LINE_M + _LINE_PER_M * scan.ranges_m[order]
    normals, sd_rad = fit_lines(points, np.zeros(order.size, dtype=np.int64), tolerance)
    normals = np.where(np.isfinite(sd_rad)[:, np.newaxis], normals, np.nan)
    return ScanWithPatches(
        azimuths_rad=wrapped[order],
        points_m=points,
        normals=normals,
        normal_sd_rad=sd_rad,
        velocity=np.zeros(3) if motion is None else motion.velocity,
        image_after_scan_s=entry.gap_ns / NS_PER_S,
        heading_rad=heading_rad,
        patches=find_patches(
            session.depth_of(entry.camera, entry.image.depth_m),
            session.rig.cameras[entry.camera].intrinsics,
        ),
    )


class _Heading:
    """The LiDAR's heading in the room, by the turns between the scans that are seen."""

    def __init__(self) -> None:
        self._rad = 0.0
        self._stamp_ns: int | None = None

    def at(self, stamp_ns: int, motion: ScanMotion | None) -> float:
        if self._stamp_ns is not None and motion is not None:
            self._rad += motion.turn_rate_rad_s * (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        return self._rad
