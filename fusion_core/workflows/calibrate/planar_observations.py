"""Scans and depth images of a recording as the calibration without a board takes them."""

from collections.abc import Iterator

import numpy as np

from fusion_core.alignment.mount_refinement import fit_lines
from fusion_core.alignment.time import ScanWindow, estimate_turn_rate_rad_s
from fusion_core.calibration.planar.depth_patches import find_patches
from fusion_core.calibration.planar.planar_frames import ScanWithPatches
from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.errors import RegistrationFailed
from fusion_core.model.polar import points_from_polar
from fusion_core.model.progress import Progress
from fusion_core.model.sensors import LaserScan
from fusion_core.registration.pl_icp import PlIcpSettings, match_scans
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.session import Session

# Tolerances of a scan's line, as the mount's refinement has them.
_LINE_M, _LINE_PER_M = 0.03, 0.02
# Neighbouring scans of a robot are no farther apart.
_NEAR = PlIcpSettings(search_translation_m=0.3, search_rotation_rad=0.4)


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
        heading_rad = heading.at(entry.window, session)
        if seen % every == 0:
            observed.append(_observe(entry, entry.window, heading_rad, session))
    return observed


def _observe(
    entry: PairedImage,
    window: ScanWindow,
    heading_rad: float,
    session: Session,
) -> ScanWithPatches:
    scan = window.scan
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
        velocity=_velocity(window, session),
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

    def at(self, window: ScanWindow, session: Session) -> float:
        rate = estimate_turn_rate_rad_s(window, session.settings.time)
        stamp_ns = window.scan.stamp_ns
        if self._stamp_ns is not None and np.isfinite(rate):
            self._rad += rate * (stamp_ns - self._stamp_ns) / NS_PER_S
        self._stamp_ns = stamp_ns
        return self._rad


def _velocity(window: ScanWindow, session: Session) -> FloatArray:
    """(3,) of the LiDAR around its scan: the mean of the motions to its neighbours in time; where
    they cannot be matched, the turn rate alone."""
    found = list(_velocities(window))
    if found:
        mean: FloatArray = np.mean(found, axis=0)
        return mean
    rate = estimate_turn_rate_rad_s(window, session.settings.time)
    return np.array([0.0, 0.0, rate if np.isfinite(rate) else 0.0])


def _velocities(window: ScanWindow) -> Iterator[FloatArray]:
    for first, second in ((window.before, window.scan), (window.scan, window.after)):
        if first is None or second is None or first.ranges_m.size != second.ranges_m.size:
            continue
        seconds = (second.stamp_ns - first.stamp_ns) / NS_PER_S
        if not 0.0 < seconds < 1.0:
            continue
        try:
            match = match_scans(
                first.ranges_m,
                second.ranges_m,
                angle_min_rad=first.angle_min_rad,
                angle_increment_rad=first.angle_increment_rad,
                settings=_NEAR,
            )
        except RegistrationFailed:
            continue
        if match.unobservable_directions.size == 0:
            yield match.pose_first_second / seconds
