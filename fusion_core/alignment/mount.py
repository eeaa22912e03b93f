"""The mount of the rig on the LiDAR, estimated once from the whole recording.

The LiDAR's plane does not meet the image in a row: what lies Delta z below the camera at depth z
appears Delta z f / z below the centre. So the offset u of the rows gives the yaw (Xu 2024's idea,
over the whole recording), and from there the mount is refined where LiDAR points, projected into
the image, agree best with the depth found there.

Three ways to disagree are not the same. A camera that sees *through* a LiDAR point (depth beyond
it) contradicts the mount; one that sees something *nearer* may just be occluded; a point outside
the image says little, but must cost something, since a large Delta z would otherwise hide every
near point that could disagree.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from scipy.optimize import minimize

from fusion_core.alignment.time import parabola_offset
from fusion_core.model.conventions import (
    NS_PER_S,
    Float32Array,
    FloatArray,
    IntArray,
    read_only,
    wrap_angle,
)
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.geometry import inverse
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import LaserScan
from fusion_core.settings import StageSettings, setting


class MountSettings(StageSettings):
    """How the mount is refined around the recording's offset u."""

    frames: int = setting(48, "Depth images kept for the refinement", unit="images", ge=4, le=400)
    tolerance_m: float = setting(0.03, "Agreement tolerance at range 0", unit="m", gt=0.0)
    tolerance_share: float = setting(0.02, "Growth of the tolerance with range", gt=0.0, le=0.2)
    nearer_cost: float = setting(
        0.6, "Cost of depth nearer than the LiDAR point (1: beyond it)", ge=0.0, le=1.0
    )
    hidden_cost: float = setting(
        0.3, "Cost of a LiDAR point outside the image or on a hole", ge=0.0, le=1.0
    )
    delta_z_min_m: float = setting(-0.8, "Lowest camera against the LiDAR", unit="m")
    delta_z_max_m: float = setting(1.6, "Highest camera against the LiDAR", unit="m")
    clearance_m: float = setting(
        0.1, "Least height of the LiDAR's plane over the lowest surface seen", unit="m", ge=0.0
    )
    frame_yaw_sd_deg: float = setting(
        0.5, "How far a frame's yaw may stray from the mount's (0: not at all)", unit="deg", ge=0.0
    )
    min_agreement: float = setting(
        0.8, "Least share of visible points that agree, to pair along the curve", gt=0.0, le=1.0
    )


# Beyond these standard deviations (in the order of MOUNT_PARAMETERS) a value is not observable:
# it could not be told from its neighbours by the classes and repairs that use it.
_OBSERVABLE_SD = np.array([np.deg2rad(1.5), 0.15, 0.10, 0.10, np.deg2rad(2.0), 25.0])
# Weak priors keep what the data do not show near zero: a rig is compact and nearly level.
_PRIOR_SD = np.array([np.deg2rad(10.0), 1.0, 0.15, 0.15, np.deg2rad(5.0), 80.0])
_RECORDED_SD = np.array([np.deg2rad(0.3), 0.01, 0.01, 0.01, np.deg2rad(0.3), 80.0])
# One standard deviation of a prior weighs as much as this many blocks of frames.
_PRIOR_BLOCKS = 20.0
# What systematic causes (occlusion, furniture edges, slanted walls) left as error in simulated
# rooms; no recording's own scatter shows it.
_LEAST_SD = np.array([np.deg2rad(0.3), 0.05, 0.02, 0.015, np.deg2rad(1.0), 5.0])
_STARTS = 3
_RIVAL_YAWS = 3
# Steps of the search and of the finite differences: large against a pixel, small against a mode.
_STEP = np.array([np.deg2rad(0.6), 0.04, 0.04, 0.04, np.deg2rad(0.8), 20.0])
# Noise that only one sensor has moves the cost of two heights apart by this much.
_RIVAL_COST = 0.01
# Neighbouring frames see the same walls: they count as one observation.
_FRAMES_PER_BLOCK = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class MountFrame:
    """One scan and one image of the subset that the refinement keeps.

    ``points_m``: (N, 2) valid LiDAR points in the LiDAR frame at the scan's stamp.
    ``raw_depth_m``: (H, W) upright view, ``depth_m`` the same without speckle.
    ``image_after_scan_s``: image stamp - scan stamp.
    """

    camera: Camera
    scan: LaserScan
    raw_depth_m: Float32Array
    points_m: FloatArray
    depth_m: Float32Array
    turn_rate_rad_s: float
    image_after_scan_s: float

    def __post_init__(self) -> None:
        read_only(self.points_m)
        read_only(self.depth_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class MountEstimate:
    """The mount, and how far the recording supports it.

    ``agreement``: share of visible points within the tolerance; ``visible``: share of the points
    in front of a camera that fall on a valid depth; ``delta_z_profile``: (K, 2) Delta z and cost.
    """

    mount: Mount
    agreement: float
    visible: float
    confident: bool
    from_recorded: bool
    delta_z_profile: FloatArray


def mount_frame(
    camera: Camera, scan: LaserScan, depth_m: Float32Array, image_stamp_ns: int, turn_rate: float
) -> MountFrame:
    """Keep what the refinement needs of one pair. An unknown turn rate counts as standing still
    only here, where one frame of many cannot move the mount."""
    valid = np.isfinite(scan.ranges_m)
    angles = scan.angles_rad[valid]
    ranges = scan.ranges_m[valid]
    return MountFrame(
        camera=camera,
        scan=scan,
        raw_depth_m=depth_m,
        points_m=np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1),
        depth_m=without_speckle(depth_m),
        turn_rate_rad_s=turn_rate if np.isfinite(turn_rate) else 0.0,
        image_after_scan_s=(image_stamp_ns - scan.stamp_ns) / NS_PER_S,
    )


def without_speckle(depth_m: Float32Array) -> Float32Array:
    """The depth image without lone values, by a 3 x 3 median, and without lone holes.

    A hole among at least four valid pixels of one surface in the 5 x 5 around becomes their mean
    (dark furniture answers in every other pixel); other holes stay.
    """
    zeroed = np.where(np.isfinite(depth_m), depth_m, np.float32(0.0))
    filtered = cv2.medianBlur(zeroed, 3)
    square = np.ones((5, 5), dtype=np.uint8)
    valid = (zeroed > 0.0).astype(np.float32)
    count = cv2.boxFilter(valid, -1, (5, 5), normalize=False)
    total = cv2.boxFilter(zeroed, -1, (5, 5), normalize=False)
    highest = cv2.dilate(zeroed, square)
    lowest = cv2.erode(np.where(valid > 0.0, zeroed, np.float32(1e6)), square)
    mean = total / np.maximum(count, 1.0)
    one_surface = (count >= 4.0) & (highest - lowest < 0.05 * mean)
    filled = np.where((filtered <= 0.0) & one_surface, mean, filtered)
    return np.where(filled > 0.0, filled, np.float32(np.nan)).astype(np.float32)


def estimate_mount(
    frames: Sequence[MountFrame],
    settings: MountSettings,
    *,
    yaw_rad: float,
    recorded: Mount | None = None,
) -> MountEstimate:
    """Refine the mount from the yaw of the recording's offset u.

    Where the plane of the LiDAR lies far from any one row, the rows can favour a wrong yaw: other
    yaws are tried as well, and taken only where they agree better beyond doubt.
    ``recorded``: extrinsics that the recording itself gives; used as a prior where their yaw is
    within 5 degrees of ``yaw_rad`` or points agree under them.

    Raises AlignmentFailed where there are too few frames or points.
    """
    if len(frames) < 4 or sum(frame.points_m.shape[0] for frame in frames) < 100:
        raise AlignmentFailed(
            f"the mount needs 4 paired depth images with 100 LiDAR points, got {len(frames)}.",
            advice="Use a longer recording.",
        )
    problem = _Problem(frames, settings)
    highest_m = min(settings.delta_z_max_m, -problem.lowest_seen_m() - settings.clearance_m)
    heights_m = np.arange(
        settings.delta_z_min_m, max(highest_m, settings.delta_z_min_m + 0.1), 0.05
    )
    trusted = recorded is not None and (
        _apart_rad(recorded.yaw_rad, yaw_rad) < np.deg2rad(5.0)
        or problem.agreement(recorded.vector())[0] >= settings.min_agreement
    )
    if recorded is not None and trusted:
        centre, spread = recorded.vector(), _RECORDED_SD
        fits = [_descend(_with_prior(problem, centre, spread, np.inf), centre)]
        yaws = [centre[0]]
    else:
        spread = _PRIOR_SD
        yaws = [yaw_rad, *_other_yaws(problem.thinned(), yaw_rad, heights_m[::3])]
        fits = []
        for yaw in yaws:
            centre = _level(yaw)
            cost = _with_prior(problem, centre, spread, highest_m)
            # A rival yaw must only show how well it can agree; the rows' own is refined fully.
            count = _STARTS if yaw == yaw_rad else 1
            for start in _starts(_delta_z_profile(problem, centre, heights_m), centre, count):
                fits.append(_descend(cost, start))
    best, doubtful_yaw = _choose(problem, fits, yaws[0])
    least_sd = np.minimum(_LEAST_SD, _RECORDED_SD) if trusted else _LEAST_SD
    sd = np.maximum(_sandwich_sd(problem, best, spread), least_sd)
    if not trusted:
        level = [np.concatenate([best[:1], [height], best[2:]]) for height in heights_m]
        for rival in _rivals(problem, [*fits, *level], best):
            sd = np.maximum(sd, np.abs(rival - best))
            sd[[1, 4]] = np.inf
    if doubtful_yaw:
        sd[0] = np.inf
    # Pairs need the turn of yaw and delay together, which is known even where neither is.
    sure_yaw = bool(sd[0] <= _OBSERVABLE_SD[0])
    sd = _with_delay(sd, problem.turn_rates_rad_s, spread[5], settings)
    mount = Mount.from_vector(
        best,
        tuple(
            float(value) if value <= limit else None
            for value, limit in zip(sd, _OBSERVABLE_SD, strict=True)
        ),
    )
    agreement, visible = problem.agreement(best)
    return MountEstimate(
        mount=mount,
        agreement=agreement,
        visible=visible,
        confident=bool(agreement >= settings.min_agreement and sure_yaw),
        from_recorded=bool(trusted),
        delta_z_profile=_delta_z_profile(problem, best, heights_m)[:, 1:],
    )


def _apart_rad(first_rad: float, second_rad: float) -> float:
    return float(np.abs(wrap_angle(first_rad - second_rad)))


def _level(yaw_rad: float) -> FloatArray:
    """A mount of which only the yaw is known."""
    values = np.zeros(6)
    values[0] = yaw_rad
    return values


def _with_prior(
    problem: "_Problem", centre: FloatArray, spread: FloatArray, highest_m: float
) -> Callable[[FloatArray], float]:
    weight = 1.0 / (2.0 * problem.blocks * _PRIOR_BLOCKS)

    def cost(values: FloatArray) -> float:
        if values[1] > highest_m:
            return 1.0 + float(values[1] - highest_m)
        prior = float(np.sum(((values - centre) / spread) ** 2))
        return problem.mean_cost(values) + weight * prior

    return cost


def _other_yaws(problem: "_Problem", yaw_rad: float, heights_m: FloatArray) -> list[float]:
    """The best few yaws all around, more than 5 degrees from ``yaw_rad`` and from each other.

    A yaw counts where at least half as many points lie in front of a camera as at the best one.
    """
    yaws = yaw_rad + np.deg2rad(np.arange(-180.0, 180.0, 2.0))
    costs = np.full(yaws.size, np.inf)
    in_front = np.zeros(yaws.size)
    for index, yaw in enumerate(yaws):
        for height in heights_m:
            values = _level(float(yaw))
            values[1] = height
            tallies = problem.frame_tallies(values).sum(axis=0)
            in_front[index] = tallies[1]
            costs[index] = min(costs[index], tallies[0] / max(tallies[1], 1.0))
    costs[in_front < 0.5 * in_front.max()] = np.inf
    found: list[float] = []
    for index in np.argsort(costs):
        yaw = float(yaws[index])
        if not np.isfinite(costs[index]) or len(found) == _RIVAL_YAWS:
            break
        if min(_apart_rad(yaw, other) for other in [yaw_rad, *found]) > np.deg2rad(5.0):
            found.append(yaw)
    return found


def _choose(problem: "_Problem", fits: list[FloatArray], yaw_rad: float) -> tuple[FloatArray, bool]:
    """The best fit near the rows' yaw, unless another is better beyond doubt (paired over blocks,
    3 sigma); and whether the two remain in doubt."""
    near = [fit for fit in fits if _apart_rad(fit[0], yaw_rad) < np.deg2rad(5.0)]
    best = min(near or fits, key=problem.mean_cost)
    rival = min(fits, key=problem.mean_cost)
    if _apart_rad(rival[0], best[0]) < np.deg2rad(5.0):
        return best, False
    gain = problem.block_costs(best) - problem.block_costs(rival)
    sure = np.mean(gain) > 3.0 * np.std(gain) / np.sqrt(gain.size)
    return (rival, False) if sure else (best, True)


def frame_yaw_offset_rad(frame: MountFrame, mount: Mount, settings: MountSettings) -> float:
    """How far one frame's own best yaw lies from the mount's: its check against the recording.

    The sum of what the frame shows and of a prior of ``frame_yaw_sd_deg`` around the mount: a
    plain wall fits at any yaw and must not pull. What remains is the turn that stamps do not
    explain (a clock offset, a scan that is not instantaneous).
    """
    problem = _Problem([frame], settings)
    sd_rad = np.deg2rad(settings.frame_yaw_sd_deg)
    offsets = np.linspace(-3.0, 3.0, 25) * sd_rad
    # Four neighbouring beams count as one observation; the loss is 1/16 of a log likelihood.
    costs = 4.0 * problem.costs_at_yaws(mount, mount.yaw_rad + offsets)
    costs += 0.5 * (offsets / sd_rad) ** 2
    best = int(costs.argmin())
    return float(offsets[best] + parabola_offset(costs, best) * (offsets[1] - offsets[0]))


class _Problem:
    """The kept frames as flat arrays, and the cost of a mount on each of them."""

    def __init__(self, frames: Sequence[MountFrame], settings: MountSettings) -> None:
        self._frames = frames
        self._settings = settings
        self._points = np.concatenate([frame.points_m for frame in frames])
        sizes = [frame.points_m.shape[0] for frame in frames]
        self._first_point = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self._pixels = np.concatenate([frame.depth_m.ravel() for frame in frames])
        areas = [frame.depth_m.size for frame in frames]
        self._first_pixel = np.concatenate([[0], np.cumsum(areas)[:-1]]).astype(np.int64)
        self._lens = np.array(
            [
                [lens.fx, lens.fy, lens.cx, lens.cy, lens.width, lens.height]
                for lens in (frame.camera.intrinsics for frame in frames)
            ]
        )
        self._T_camera_rig = np.stack([inverse(frame.camera.T_rig_camera) for frame in frames])
        self.turn_rates_rad_s = np.array([frame.turn_rate_rad_s for frame in frames])
        self._after_s = np.array([frame.image_after_scan_s for frame in frames])
        self.blocks = max(1, len(frames) // _FRAMES_PER_BLOCK)

    def thinned(self) -> "_Problem":
        """Every third frame, to look far around."""
        return _Problem(self._frames[::3], self._settings)

    def lowest_seen_m(self) -> float:
        """Height of the lowest surface in the rig frame: the floor, where it is in the image.

        A LiDAR plane below it would be nowhere in the images.
        """
        lowest = []
        for index, T_camera_rig in enumerate(self._T_camera_rig):
            fx, fy, cx, cy, width, height = self._lens[index]
            first = self._first_pixel[index]
            depth = self._pixels[first : first + int(width * height)].reshape(int(height), -1)
            v, u = np.mgrid[0 : int(height) : 4, 0 : int(width) : 4]
            z = depth[::4, ::4]
            up = T_camera_rig[:3, 2]
            heights = z * ((u - cx) / fx * up[0] + (v - cy) / fy * up[1] + up[2])
            heights = heights[np.isfinite(heights)] - float(up @ T_camera_rig[:3, 3])
            if heights.size:
                lowest.append(np.quantile(heights, 0.01))
        return float(np.median(lowest)) if lowest else float("-inf")

    def frame_tallies(self, values: FloatArray) -> FloatArray:
        """(F, 4): cost, points in front of the camera, points on valid depth, points in accord."""
        mount = Mount.from_vector(values)
        return self._tallies(inverse(mount.T_lidar_rig), mount)

    def costs_at_yaws(self, mount: Mount, yaws_rad: FloatArray) -> FloatArray:
        """(K,) cost of all frames for the mount at other yaws."""
        pitched = replace(mount, yaw_rad=0.0, forward_m=0.0, left_m=0.0, delta_z_m=0.0)
        back = np.eye(4)
        back[:3, 3] = -mount.T_lidar_rig[:3, 3]
        T_rig_lidar = inverse(pitched.T_lidar_rig) @ _turns(-yaws_rad) @ back
        return np.array([self._tallies(T, mount)[:, 0].sum() for T in T_rig_lidar])

    def _tallies(self, T_rig_lidar: FloatArray, mount: Mount) -> FloatArray:
        turned_rad = self.turn_rates_rad_s * (self._after_s - mount.clock_offset_ms * 1e-3)
        tallies: FloatArray = _tally(
            self._points,
            self._first_point,
            self._pixels,
            self._first_pixel,
            self._lens,
            self._T_camera_rig @ T_rig_lidar @ _turns(-turned_rad),
            self._settings.tolerance_m,
            self._settings.tolerance_share,
            self._settings.nearer_cost,
            self._settings.hidden_cost,
        )
        return tallies

    def mean_cost(self, values: FloatArray) -> float:
        tallies = self.frame_tallies(values)
        return float(tallies[:, 0].sum() / max(tallies[:, 1].sum(), 1.0))

    def block_costs(self, values: FloatArray) -> FloatArray:
        """(blocks,) mean cost of runs of neighbouring frames."""
        tallies = self.frame_tallies(values)
        return np.array(
            [
                block[:, 0].sum() / max(block[:, 1].sum(), 1.0)
                for block in np.array_split(tallies, self.blocks)
            ]
        )

    def agreement(self, values: FloatArray) -> tuple[float, float]:
        tallies = self.frame_tallies(values).sum(axis=0)
        return float(tallies[3] / max(tallies[2], 1.0)), float(tallies[2] / max(tallies[1], 1.0))


def _turns(angles_rad: FloatArray) -> FloatArray:
    """(F, 4, 4) rotations about z."""
    turns = np.tile(np.eye(4), (angles_rad.size, 1, 1))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angles_rad)
    turns[:, 1, 0] = np.sin(angles_rad)
    turns[:, 0, 1] = -turns[:, 1, 0]
    return turns


def _delta_z_profile(problem: _Problem, centre: FloatArray, heights_m: FloatArray) -> FloatArray:
    """(K, 3): best yaw, Delta z, cost, over a grid of Delta z with the yaw free by 3 degrees."""
    rows = []
    for delta_z in heights_m:
        best = (np.inf, 0.0)
        for yaw in centre[0] + np.deg2rad([-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]):
            values = centre.copy()
            values[:2] = yaw, delta_z
            best = min(best, (problem.mean_cost(values), float(yaw)))
        rows.append([best[1], float(delta_z), best[0]])
    return np.array(rows)


def _starts(profile: FloatArray, centre: FloatArray, count: int) -> list[FloatArray]:
    """The ``count`` lowest local minima of the profile."""
    cost = np.concatenate([[np.inf], profile[:, 2], [np.inf]])
    minima = np.flatnonzero((cost[1:-1] <= cost[:-2]) & (cost[1:-1] <= cost[2:]))
    starts = []
    for index in minima[np.argsort(profile[minima, 2])][:count]:
        start = centre.copy()
        start[:2] = profile[index, :2]
        starts.append(start)
    return starts


def _descend(cost: Callable[[FloatArray], float], start: FloatArray) -> FloatArray:
    simplex = np.vstack([start, start + np.diag(2.0 * _STEP)])
    # The pixels make the cost piecewise constant at the finest scale: no gradients.
    result = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "maxfev": 700,
            "xatol": 1e-4,
            "fatol": 1e-6,
            "adaptive": True,
        },
    )
    found: FloatArray = result.x
    return found


def _sandwich_sd(problem: _Problem, values: FloatArray, spread: FloatArray) -> FloatArray:
    """One standard deviation of each parameter: H^-1 G H^-1 over blocks of frames, G the spread of
    the blocks' gradients, H the curvature of their mean with the prior's. One block has no spread:
    nothing is known then."""
    count = values.size
    if problem.blocks < 2:
        return np.full(count, np.inf)
    steps = np.diag(_STEP)
    ahead = [problem.block_costs(values + step) for step in steps]
    behind = [problem.block_costs(values - step) for step in steps]
    middle = problem.block_costs(values)
    gradients = np.stack(
        [(a - b) / (2.0 * h) for a, b, h in zip(ahead, behind, _STEP, strict=True)]
    )
    hessian = np.zeros((count, count))
    for i in range(count):
        hessian[i, i] = np.mean(ahead[i] - 2.0 * middle + behind[i]) / _STEP[i] ** 2
        for j in range(i):
            corners = (
                problem.mean_cost(values + steps[i] + steps[j])
                - problem.mean_cost(values + steps[i] - steps[j])
                - problem.mean_cost(values - steps[i] + steps[j])
                + problem.mean_cost(values - steps[i] - steps[j])
            )
            hessian[i, j] = hessian[j, i] = corners / (4.0 * _STEP[i] * _STEP[j])
    scale = np.diag(_STEP)
    # In units of the steps, so that metres, radians and milliseconds compare.
    curvature = scale @ hessian @ scale + np.diag(
        (_STEP / spread) ** 2 / (problem.blocks * _PRIOR_BLOCKS)
    )
    # A prior's centre is off by its own spread: where the data say nothing, that is the answer.
    prior = (_STEP / spread) ** 2 / (problem.blocks * _PRIOR_BLOCKS) ** 2
    noise = np.cov(scale @ gradients) / problem.blocks + np.diag(prior)
    eigenvalues, vectors = np.linalg.eigh(curvature)
    flat = eigenvalues < 1e-4 * max(float(eigenvalues.max()), 1e-12)
    back = (vectors / np.where(flat, 1.0, eigenvalues)) @ vectors.T
    variance = np.diag(back @ noise @ back)
    # A direction without curvature is not observable, whatever the gradients say.
    loose = (np.abs(vectors[:, flat]) > 0.3).any(axis=1)
    # The finite steps cannot resolve better than a fraction of themselves.
    sd: FloatArray = np.maximum(np.sqrt(variance), 0.25) * _STEP
    sd[loose] = np.inf
    return sd


def _with_delay(
    sd: FloatArray, rates_rad_s: FloatArray, delay_spread_ms: float, settings: MountSettings
) -> FloatArray:
    """The deviations where a delay looks like a yaw: only changes of the turn rate tell the two
    apart (a line fitted to the frames' yaws over their rates, each ``frame_yaw_sd_deg`` off)."""
    changes_rad_s = np.std(rates_rad_s) * np.sqrt(rates_rad_s.size)
    delay_ms = 1e3 * np.deg2rad(settings.frame_yaw_sd_deg) / max(float(changes_rad_s), 1e-6)
    widened = sd.copy()
    widened[5] = max(sd[5], delay_ms)
    delay_s = 1e-3 * min(widened[5], delay_spread_ms)
    widened[0] = np.hypot(sd[0], np.mean(rates_rad_s) * delay_s)
    return widened


def _rivals(problem: _Problem, fits: list[FloatArray], best: FloatArray) -> list[FloatArray]:
    """The fits with another Delta z that explain the recording as well (paired over blocks,
    2 sigma)."""
    reference = problem.block_costs(best)
    rivals = []
    for fit in fits:
        if abs(fit[1] - best[1]) < 0.15:
            continue
        difference = problem.block_costs(fit) - reference
        doubt = 2.0 * np.std(difference) / np.sqrt(difference.size)
        if np.mean(difference) < max(doubt, _RIVAL_COST):
            rivals.append(fit)
    return rivals


@njit(cache=True)
def _tally(
    points: FloatArray,
    first_point: IntArray,
    pixels: Float32Array,
    first_pixel: IntArray,
    lens: FloatArray,
    T_camera_lidar: FloatArray,
    tolerance_m: float,
    tolerance_share: float,
    nearer_cost: float,
    hidden_cost: float,
) -> FloatArray:
    """Per frame: cost, points in front, points on valid depth, points within 2.5 tolerances."""
    frames = lens.shape[0]
    out = np.zeros((frames, 4))
    for frame in range(frames):
        fx, fy, cx, cy, width, height = lens[frame]
        T = T_camera_lidar[frame]
        for index in range(first_point[frame], first_point[frame + 1]):
            x, y = points[index]
            depth = T[2, 0] * x + T[2, 1] * y + T[2, 3]
            if depth < 0.1:
                continue
            u = cx + fx * (T[0, 0] * x + T[0, 1] * y + T[0, 3]) / depth
            if u < -0.5 or u >= width - 0.5:
                continue
            v = cy + fy * (T[1, 0] * x + T[1, 1] * y + T[1, 3]) / depth
            out[frame, 1] += 1.0
            if v < -0.5 or v >= height - 0.5:
                out[frame, 0] += hidden_cost
                continue
            column = int(np.floor(u + 0.5))
            row = int(np.floor(v + 0.5))
            seen = pixels[first_pixel[frame] + row * int(width) + column]
            if np.isnan(seen):
                out[frame, 0] += hidden_cost
                continue
            out[frame, 2] += 1.0
            off = (seen - depth) / (tolerance_m + tolerance_share * depth)
            loss = 1.0 - np.exp(-0.125 * off * off)
            out[frame, 0] += loss if off > 0.0 else nearer_cost * loss
            if abs(off) < 2.5:
                out[frame, 3] += 1.0
    return out
