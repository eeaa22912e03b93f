"""How the LiDAR moves around a scan, by the scans before and after it: no odometry is needed.

The turn is looked for over all that the settings allow first, by the shift of beams that lays one
scan on the next. From there the turn and the drive follow together from the range flow (Gonzalez
and Gutierrez 1999; Jaimez, Monroy and Gonzalez-Jimenez 2016). With the azimuth a of a beam, d along
it, e across it, and the slope r' = dr/da of the scan, the surface there has the normal

    n = (r d - r' e) / sqrt(r^2 + r'^2),

and a LiDAR that moved by t and turned by another psi since a scan of ranges r_1 has the ranges r_2
of the same directions, for which

    (r_1 - r_2) n.d = n.t - r' n.d psi.

This is exact on plane walls; edges, and what moves by itself, are outliers.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.moved_scan import MovedScan, move_scan
from fusion_core.alignment.parabola import parabola_offset
from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.compiled import compiled
from fusion_core.model.bounded_cache import BoundedCache
from fusion_core.model.conventions import NS_PER_S, FloatArray, read_only
from fusion_core.model.planar_poses import invert_pose, pose_after, velocity_between
from fusion_core.model.robust import MAD_TO_SIGMA, WELSCH_SD
from fusion_core.model.sensors import LaserScan

# A range difference beyond this is between two surfaces and does not measure the motion; set by
# hand.
_MAX_DIFFERENCE_M = 0.3
# A slope is that of the neighbours within this angle on each side, and of so many at least.
_SLOPE_RAD = float(np.deg2rad(2.0))
_LEAST_NEIGHBOURS = 4
# The shift that is found by whole beams is off by no more than a few (a standard deviation).
_SHIFT_SD_BEAMS = 4.0
# Of fewer beams no motion is concluded.
_LEAST_BEAMS = 20
# The scan is shifted by what was found, and the flow of the rest found again.
_PASSES = 2
_MAX_ITERATIONS = 10
# A step this small against the deviations changes nothing.
_LAST_STEP_SD = 0.1
# Residuals that are all but zero have no scale: it is no smaller.
_LEAST_NOISE_M = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanMotion:
    """The motion of the LiDAR around a scan.

    ``velocity``: (3,) in its own frame, in which it is constant: forward and left in m/s,
    counter-clockwise in rad/s. ``turn_rate_sd_rad_s``: the standard deviation of the last by the
    noise of the ranges.
    """

    velocity: FloatArray
    turn_rate_sd_rad_s: float

    def __post_init__(self) -> None:
        read_only(self.velocity)

    @property
    def turn_rate_rad_s(self) -> float:
        """Counter-clockwise."""
        return float(self.velocity[2])

    def pose_after(self, seconds: float) -> FloatArray:
        """(3,) pose of the LiDAR so much later, in its frame at the scan."""
        return pose_after(self.velocity, seconds)


def estimate_motion(window: ScanWindow, settings: TimeSettings) -> ScanMotion | None:
    """The mean over the scan's neighbours of the motions that lay one scan on the next; None where
    no neighbour overlaps enough."""
    between = [
        motion_between(first, second, settings)
        for first, second in ((window.before, window.scan), (window.scan, window.after))
        if first is not None and second is not None
    ]
    known = [motion for motion in between if motion is not None]
    if not known:
        return None
    variances = [motion.turn_rate_sd_rad_s**2 for motion in known]
    return ScanMotion(
        velocity=np.mean([motion.velocity for motion in known], axis=0),
        turn_rate_sd_rad_s=float(np.sqrt(np.mean(variances) / len(known))),
    )


# The images around two scans all ask for the motion between them.
_recent: BoundedCache[tuple[LaserScan, LaserScan, TimeSettings], ScanMotion | None] = BoundedCache(
    8
)


def motion_between(
    first: LaserScan, second: LaserScan, settings: TimeSettings
) -> ScanMotion | None:
    """The motion from one scan to the next; None where they are of other beams, a second or more
    apart, or overlap too little."""
    return _recent.get_or_compute(
        (first, second, settings), lambda: _lay_over(first, second, settings)
    )


def neighbour_seen_from(
    scan: LaserScan, neighbour: LaserScan | None, motion: ScanMotion | None, settings: TimeSettings
) -> MovedScan | None:
    """A neighbour in time as seen from where ``scan`` was taken; None where there is none, it is of
    other beams, or the ``motion`` around ``scan`` is not known."""
    if neighbour is None or motion is None or not _have_same_beams(scan, neighbour):
        return None
    pose_scan_neighbour = motion.pose_after((neighbour.stamp_ns - scan.stamp_ns) / NS_PER_S)
    return move_scan(neighbour, invert_pose(pose_scan_neighbour), settings.same_surface_m)


def _lay_over(first: LaserScan, second: LaserScan, settings: TimeSettings) -> ScanMotion | None:
    seconds = (second.stamp_ns - first.stamp_ns) / NS_PER_S
    if not _have_same_beams(first, second) or not 0.0 < seconds < 1.0:
        return None
    step_rad = first.angle_increment_rad
    reach = int(np.ceil(settings.max_turn_rate_rad_s * seconds / abs(step_rad)))
    reach = min(max(reach, 2), first.ranges_m.size // 4)
    cost = _shift_costs(first.ranges_m, second.ranges_m, reach, first.is_full_circle)
    if not np.isfinite(cost).any():
        return None
    best = int(np.nanargmin(cost))
    # A LiDAR that turns left by s beams sees at beam i what it saw at beam i + s.
    shift = best - reach + parabola_offset(cost, best)
    drive_sd_m = settings.speed_sd_m_s * seconds
    moved, turn_sd_rad = _fit_range_flow(
        first.ranges_m,
        second.ranges_m,
        float(shift),
        first.angle_min_rad,
        step_rad,
        first.is_full_circle,
        np.array([drive_sd_m, drive_sd_m, _SHIFT_SD_BEAMS * abs(step_rad)]),
    )
    if np.isnan(turn_sd_rad):
        return None
    return ScanMotion(
        velocity=velocity_between(moved, seconds), turn_rate_sd_rad_s=turn_sd_rad / seconds
    )


def _have_same_beams(first: LaserScan, second: LaserScan) -> bool:
    return (
        first.ranges_m.size == second.ranges_m.size
        and first.angle_increment_rad == second.angle_increment_rad
    )


@compiled()
def _fit_range_flow(
    first: FloatArray,
    second: FloatArray,
    shift: float,
    start_rad: float,
    step_rad: float,
    is_full_circle: bool,
    prior_sd: FloatArray,
) -> tuple[FloatArray, float]:
    """(3,) pose of the LiDAR at the second scan in its frame at the first, and the standard
    deviation of its turn, NaN where too few beams are of one surface.

    Iteratively reweighted least squares from a turn of ``shift`` beams and no drive, with a prior
    about those: where the flow does not show a direction, they stay.
    """
    moved = np.array([0.0, 0.0, shift * step_rad])
    centre = moved.copy()
    prior = np.diag(1.0 / prior_sd**2)
    information = prior
    for _ in range(_PASSES):
        # Whole beams: what is interpolated between two would share their noise.
        whole = int(np.rint(moved[2] / step_rad))
        shifted_by = np.array([0.0, 0.0, whole * step_rad])
        rows, flows_m = _range_flow(first, second, whole, start_rad, step_rad, is_full_circle)
        if flows_m.size < _LEAST_BEAMS:
            return moved, np.nan
        for _ in range(_MAX_ITERATIONS):
            off = flows_m - rows @ (moved - shifted_by)
            noise = max(MAD_TO_SIGMA * np.median(np.abs(off)), _LEAST_NOISE_M)
            information = prior.copy()
            gradient = prior @ (centre - moved)
            for n in range(off.size):
                weight = np.exp(-((off[n] / (WELSCH_SD * noise)) ** 2)) / noise**2
                for i in range(3):
                    gradient[i] += weight * rows[n, i] * off[n]
                    for j in range(3):
                        information[i, j] += weight * rows[n, i] * rows[n, j]
            step = np.linalg.solve(information, gradient)
            moved += step
            if step @ gradient < _LAST_STEP_SD**2:
                break
    return moved, np.sqrt(np.linalg.inv(information)[2, 2])


@compiled()
def _range_flow(
    first: FloatArray,
    second: FloatArray,
    shift: int,
    start_rad: float,
    step_rad: float,
    is_full_circle: bool,
) -> tuple[FloatArray, FloatArray]:
    """(M, 3) and (M,): n and -r' n.d, and the range flow along n, of the beams whose ranges, after
    a turn by ``shift`` beams, are of one surface."""
    beams = first.size
    shifted = np.full(beams, np.nan)
    for beam in range(beams):
        place = (beam - shift) % beams if is_full_circle else beam - shift
        if 0 <= place < beams:
            shifted[beam] = second[place]
    mean_m = 0.5 * (first + shifted)
    half = max(_LEAST_NEIGHBOURS, int(np.rint(_SLOPE_RAD / abs(step_rad))))
    rows, flows_m = np.empty((beams, 3)), np.empty(beams)
    count = 0
    for beam in range(beams):
        r = mean_m[beam]
        # NaN compares false.
        if not abs(first[beam] - shifted[beam]) <= _MAX_DIFFERENCE_M:
            continue
        n, sum_x, sum_y, sum_xx, sum_xy = 0, 0.0, 0.0, 0.0, 0.0
        for offset in range(-half, half + 1):
            place = beam + offset
            if is_full_circle:
                place %= beams
            elif place < 0 or place >= beams:
                continue
            away = mean_m[place] - r
            if abs(away) <= _MAX_DIFFERENCE_M:
                n += 1
                sum_x += offset
                sum_y += away
                sum_xx += offset * offset
                sum_xy += offset * away
        spread = sum_xx - sum_x * sum_x / n
        if n <= half or spread <= 0.0:
            continue
        slope = (sum_xy - sum_x * sum_y / n) / spread / step_rad
        azimuth = start_rad + beam * step_rad
        cos, sin, length = np.cos(azimuth), np.sin(azimuth), np.hypot(r, slope)
        rows[count, 0] = (r * cos + slope * sin) / length
        rows[count, 1] = (r * sin - slope * cos) / length
        rows[count, 2] = -slope * r / length
        flows_m[count] = (first[beam] - shifted[beam]) * r / length
        count += 1
    return rows[:count], flows_m[:count]


@compiled()
def _shift_costs(
    first: FloatArray, second: FloatArray, reach: int, is_full_circle: bool
) -> FloatArray:
    """Mean capped range difference of second[i] and first[i + s] for s in -reach..reach."""
    beams = first.size
    # Beam 0 of ``first`` at index ``reach``, so that every shift is a slice.
    padded = np.full(beams + 2 * reach, np.nan)
    for place in range(padded.size):
        beam = place - reach
        if is_full_circle:
            beam %= beams
        if 0 <= beam < beams:
            padded[place] = first[beam]
    totals, counts = np.zeros(2 * reach + 1), np.zeros(2 * reach + 1)
    for beam in range(beams):
        own, others = second[beam], padded[beam : beam + 2 * reach + 1]
        for column in range(2 * reach + 1):
            difference = abs(own - others[column])
            is_known = difference == difference
            totals[column] += min(difference, _MAX_DIFFERENCE_M) if is_known else 0.0
            counts[column] += 1.0 if is_known else 0.0
    costs = np.full(2 * reach + 1, np.nan)
    for column in range(2 * reach + 1):
        if counts[column] * 4.0 >= beams:
            costs[column] = totals[column] / max(counts[column], 1.0)
    return costs
