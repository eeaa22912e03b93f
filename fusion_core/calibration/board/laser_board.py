"""A 2D LiDAR and a camera that both see a board at several places: Fu 2024 §2 by planes.

The camera gives the board's pose at each place, the LiDAR a segment on it. The segment's points lie
in the board's plane: nᵀ(R p + t) = d (Zhang and Pless 2004).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.board.board import Board
from fusion_core.calibration.board.board_pose import PlanePose
from fusion_core.calibration.board.laser_board_search import (
    ROUGH_M,
    Candidates,
    associate,
    choose_candidates,
    search_pose,
)
from fusion_core.calibration.board.laser_planes import (
    LaserPlanes,
    PlaneFit,
    fit_planes,
    huber_cost,
    offset_effect,
    plane_information,
)
from fusion_core.calibration.board.laser_segments import Segment, SegmentSettings, find_segments
from fusion_core.calibration.board.observability import (
    observable_covariance,
    unobservable_parameters,
)
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate, parameters_in_words
from fusion_core.model.seeds import SEED_MAX
from fusion_core.settings import StageSettings, setting

_VIEWS_MIN = 5
_ROUNDS = 5
# Basin: disturbed starts, as users' hand-measured guesses are.
_BASIN_STARTS = 10
_BASIN_RAD, _BASIN_M = np.radians(2.0), 0.1
_RETURNED_RAD, _RETURNED_M = np.radians(0.1), 0.005
# A guess may be this far off the segments that are on the board.
_GUESS_M = 0.2
_TILT_MIN_DEG = 3.0


class LaserBoardSettings(StageSettings):
    """How R and t are found from a board."""

    draws: int = setting(
        4000, "Random draws of views and segments for the initial pose", ge=10, le=1_000_000
    )
    folds: int = setting(10, "Groups of views that are left out in turn", ge=2, le=1000)
    huber: float = setting(
        2.5, "Errors of more standard deviations count linearly", unit="sigma", ge=1.0, le=100.0
    )
    rotation_sd_max_deg: float = setting(
        3.0, "An angle less certain than this is unobservable", unit="deg", ge=1e-3, le=90.0
    )
    translation_sd_max_m: float = setting(
        0.1, "A coordinate less certain than this is unobservable", unit="m", ge=1e-4, le=100.0
    )
    range_offset_sd_m: float = setting(
        0.005,
        "Doubt of the LiDAR's ranges, by one offset of all, which the deviations count",
        unit="m",
        ge=0.0,
        le=0.2,
    )
    seed: int = setting(0, "Seed of the random draws", ge=0, le=SEED_MAX)

    def sd_limits(self) -> FloatArray:
        """(6,) for POSE_PARAMETERS."""
        rotation_rad = np.radians(self.rotation_sd_max_deg)
        return np.array([rotation_rad] * 3 + [self.translation_sd_max_m] * 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardView:
    """The board at one place: its pose in the camera's frame, and the sweep of that time.

    ``ranges_m``, ``angles_rad``: (N,), NaN where there is no return.
    """

    pose: PlanePose
    ranges_m: FloatArray
    angles_rad: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserBoardResult:
    """``views_used``: how many of the views have a segment on the board. ``distance_rms_m``,
    ``distance_rms_used_m``: of the segments to the planes of views that the pose has not, and has,
    seen. ``guess_rms_m``: of the guess, None without one. ``pixel_sd_px``: of the corners.
    """

    estimate: ExtrinsicsEstimate
    views_used: int
    distance_rms_m: float
    distance_rms_used_m: float
    guess_rms_m: float | None
    pixel_sd_px: float


def calibrate_laser_board(
    views: Sequence[BoardView],
    board: Board,
    settings: LaserBoardSettings | None = None,
    segment_settings: SegmentSettings | None = None,
    *,
    T_guess: FloatArray | None = None,
) -> LaserBoardResult:
    """T_camera_lidar of views of ``board``.

    What the board's places leave open keeps the value of ``T_guess`` (4, 4), and the guess is the
    result where views that a fit has not seen agree with it better. Raises CalibrationFailed for
    fewer than five places, where the LiDAR does not see the board, and for places that leave
    parameters open where there is no guess.
    """
    settings = settings or LaserBoardSettings()
    if len(views) < _VIEWS_MIN:
        raise CalibrationFailed(
            f"the board is seen at {len(views)} places, at least {_VIEWS_MIN} are needed.",
            advice="Show it at twenty or more, tilted about both axes, near and far.",
        )
    corners_m = board.points_m()[:, :2]
    candidates = choose_candidates(
        [find_segments(view.ranges_m, view.angles_rad, segment_settings) for view in views],
        [view.pose.T_camera_plane for view in views],
        corners_m.min(axis=0) - board.square_m,
        corners_m.max(axis=0) + board.square_m,
    )
    pixel_sd_px = _pixel_sd(views)
    problem, T_start, free = _start(views, candidates, pixel_sd_px, settings, T_guess)
    fit = fit_planes(problem, T_start, settings.huber, free)
    held_out, held_out_cost = _held_out(problem, fit, T_start, settings, free)
    unobservable = tuple(
        name for name, is_free in zip(POSE_PARAMETERS, free, strict=True) if not is_free
    )
    guess_rms_m, improved = None, True
    if T_guess is not None:
        guess_residuals, guess_white = fit.planes.residuals(T_guess)
        guess_rms_m = _rms(guess_residuals)
        improved = held_out_cost < huber_cost(guess_white, settings.huber)
    used = len(problem.ends_m)
    estimate = ExtrinsicsEstimate(
        T_camera_lidar=fit.T if improved or T_guess is None else T_guess.copy(),
        covariance=_covariance(fit, unobservable, settings),
        method="board seen by both",
        verdict=_verdict(used, len(views), _rms(held_out), guess_rms_m, improved, unobservable),
        improved=improved,
        T_guess=None if T_guess is None else T_guess.copy(),
        basin=_basin(views, candidates, pixel_sd_px, fit.T, settings) if free.all() else None,
        unobservable=unobservable,
        notes=_notes(problem, fit, pixel_sd_px, len(views)),
    )
    return LaserBoardResult(
        estimate=estimate,
        views_used=used,
        distance_rms_m=_rms(held_out),
        distance_rms_used_m=_rms(fit.residuals_m),
        guess_rms_m=guess_rms_m,
        pixel_sd_px=pixel_sd_px,
    )


def _covariance(
    fit: PlaneFit, unobservable: tuple[str, ...], settings: LaserBoardSettings
) -> FloatArray:
    """Of the residuals, and of an offset of all ranges: more places do not average that out."""
    covariance = observable_covariance(fit.information, unobservable)
    effect = offset_effect(fit.planes, fit.T, settings.huber)
    moved = np.where(np.isfinite(covariance), covariance, 0.0) @ effect
    total: FloatArray = covariance + settings.range_offset_sd_m**2 * np.outer(moved, moved)
    return total


def _planes(
    views: Sequence[BoardView],
    candidates: Candidates,
    T: FloatArray,
    limit_m: float,
    pixel_sd_px: float,
) -> LaserPlanes:
    """The segments that lie on the board under a pose."""
    chosen, places = associate(candidates, T, limit_m)
    segments: list[Segment] = [
        candidates.segments[view][place] for view, place in zip(chosen, places, strict=True)
    ]
    count = len(segments)
    ends_m, across = np.zeros((count, 2, 3)), np.zeros((count, 3))
    for index, segment in enumerate(segments):
        ends_m[index, :, :2] = segment.ends_m
        across[index, :2] = segment.normal
    poses = [views[view].pose for view in chosen]
    return LaserPlanes(
        ends_m=ends_m,
        across=across,
        line_sd_m=np.array([segment.sd_m for segment in segments]),
        T_camera_board=np.array([pose.T_camera_plane for pose in poses]).reshape(-1, 4, 4),
        board_covariance=np.array([pixel_sd_px**2 * pose.covariance for pose in poses]).reshape(
            -1, 6, 6
        ),
    )


def _start(
    views: Sequence[BoardView],
    candidates: Candidates,
    pixel_sd_px: float,
    settings: LaserBoardSettings,
    T_guess: FloatArray | None,
) -> tuple[LaserPlanes, FloatArray, BoolArray]:
    """The segments on the board, a pose to start from, and which parameters they determine."""
    everything = np.ones(6, dtype=np.bool_)
    trials: list[tuple[LaserPlanes, FloatArray, BoolArray]] = []
    found = search_pose(candidates, settings.draws, settings.seed)
    if found is not None:
        planes, T = _settle(
            views, candidates, pixel_sd_px, found, 2.0 * ROUGH_M, settings, everything
        )
        free = _free(planes, T, settings)
        # What the views leave open, no search has found.
        if planes is not None and free.all():
            trials.append((planes, T, free))
    if T_guess is not None:
        near = _planes(views, candidates, T_guess, _GUESS_M, pixel_sd_px)
        free = _free(near, T_guess, settings)
        planes, T = _settle(views, candidates, pixel_sd_px, T_guess, _GUESS_M, settings, free)
        if planes is not None and free.any():
            trials.append((planes, T if free.all() else T_guess, free))
    trials = [trial for trial in trials if len(trial[0].ends_m) >= _VIEWS_MIN]
    if trials:
        return max(trials, key=lambda trial: len(trial[0].ends_m))
    if T_guess is None:
        _require_tilts(views)
        if found is not None and planes is not None and len(planes.ends_m) >= _VIEWS_MIN:
            names = [
                name for name, is_free in zip(POSE_PARAMETERS, free, strict=True) if not is_free
            ]
            raise CalibrationFailed(
                f"the board's {len(planes.ends_m)} places leave {', '.join(names)} open.",
                advice="Tilt the board about both of its axes, near and far, or give --guess.",
            )
    raise CalibrationFailed(
        f"the LiDAR's segments do not agree with the board at {_VIEWS_MIN} of {len(views)} places.",
        advice="Hold the board so that the LiDAR's plane crosses it by 20 cm or more, and check"
        " --square (in metres) and the intrinsics.",
    )


def _free(planes: LaserPlanes | None, T: FloatArray, settings: LaserBoardSettings) -> BoolArray:
    """(6,) which parameters the segments determine."""
    if planes is None or len(planes.ends_m) == 0:
        return np.zeros(6, dtype=np.bool_)
    information = plane_information(planes, T, settings.huber)
    unobservable = unobservable_parameters(information, settings.sd_limits())
    return np.array([name not in unobservable for name in POSE_PARAMETERS])


def _require_tilts(views: Sequence[BoardView]) -> None:
    """Planes whose normals lie in one plane leave a shift along its normal open, and with it the
    linear solution."""
    normals = np.array([view.pose.T_camera_plane[:3, 2] for view in views])
    # The angle by which the normals leave the plane that they are nearest to.
    off_deg = np.degrees(np.linalg.svd(normals)[1][2] / np.sqrt(len(normals)))
    if off_deg < _TILT_MIN_DEG:
        raise CalibrationFailed(
            f"the board's {len(views)} places leave the pose open: it is turned about one axis"
            f" only, to within {off_deg:.1f}°.",
            advice="Tilt the board about both of its axes, near and far, or give --guess.",
        )


def _settle(
    views: Sequence[BoardView],
    candidates: Candidates,
    pixel_sd_px: float,
    T_start: FloatArray,
    limit_m: float,
    settings: LaserBoardSettings,
    free: BoolArray,
) -> tuple[LaserPlanes | None, FloatArray]:
    """Segments and pose in turn, with a limit that shrinks to the rough one."""
    T, planes = T_start, None
    for _ in range(_ROUNDS):
        planes = _planes(views, candidates, T, limit_m, pixel_sd_px)
        if len(planes.ends_m) < 3:
            return None, T
        T = fit_planes(planes, T_start if not free.all() else T, settings.huber, free).T
        limit_m = max(0.7 * limit_m, ROUGH_M)
    return _planes(views, candidates, T, ROUGH_M, pixel_sd_px), T


def _held_out(
    planes: LaserPlanes,
    fit: PlaneFit,
    T_start: FloatArray,
    settings: LaserBoardSettings,
    free: BoolArray,
) -> tuple[FloatArray, float]:
    """(M, 2) distances, each by a fit without its group of views, and Huber's cost of them."""
    count = len(planes.ends_m)
    order = np.random.default_rng(settings.seed).permutation(count)
    distances = np.empty((count, 2))
    cost = 0.0
    start = fit.T if free.all() else T_start
    folds = min(settings.folds, count)
    for fold in range(folds):
        left_out = np.zeros(count, dtype=np.bool_)
        left_out[order[fold::folds]] = True
        T = fit_planes(planes.subset(~left_out), start, settings.huber, free).T
        distances[left_out], white = fit.planes.subset(left_out).residuals(T)
        cost += huber_cost(white, settings.huber)
    return distances, cost


def _basin(
    views: Sequence[BoardView],
    candidates: Candidates,
    pixel_sd_px: float,
    T: FloatArray,
    settings: LaserBoardSettings,
) -> float:
    """Fraction of starts, disturbed by up to 2° and 10 cm, that come back within 0.1° and 5 mm."""
    rng = np.random.default_rng(settings.seed)
    everything, returned = np.ones(6, dtype=np.bool_), 0
    for _ in range(_BASIN_STARTS):
        error = np.concatenate([_in_ball(rng, _BASIN_RAD), _in_ball(rng, _BASIN_M)])
        planes, back = _settle(
            views,
            candidates,
            pixel_sd_px,
            apply_pose_error(T, error),
            _GUESS_M,
            settings,
            everything,
        )
        off = pose_error(T, back)
        returned += planes is not None and bool(
            np.linalg.norm(off[:3]) < _RETURNED_RAD and np.linalg.norm(off[3:]) < _RETURNED_M
        )
    return returned / _BASIN_STARTS


def _in_ball(rng: np.random.Generator, radius: float) -> FloatArray:
    direction = rng.standard_normal(3)
    vector: FloatArray = radius * rng.random() * direction / np.linalg.norm(direction)
    return vector


def _pixel_sd(views: Sequence[BoardView]) -> float:
    """Standard deviation of the corners, from all residuals with the poses' parameters counted."""
    squares = sum(float((view.pose.residuals_px**2).sum()) for view in views)
    freedom = sum(max(view.pose.residuals_px.size - 6, 1) for view in views)
    return max(float(np.sqrt(squares / freedom)), 1e-3)


def _rms(distances_m: FloatArray) -> float:
    return float(np.sqrt((distances_m**2).mean()))


def _verdict(
    used: int,
    seen: int,
    held_out_m: float,
    guess_m: float | None,
    improved: bool,
    unobservable: tuple[str, ...],
) -> str:
    if improved:
        verdict = (
            f"Found from the board at {used} of {seen} places; where it was left out, the LiDAR's"
            f" points lie {held_out_m * 1000:.1f} mm from it."
        )
    else:
        assert guess_m is not None, "only a guess can be better"
        verdict = (
            f"The guess is kept: the LiDAR's points lie {guess_m * 1000:.1f} mm from the board by"
            f" it, {held_out_m * 1000:.1f} mm by a result that has not seen them."
        )
    if unobservable:
        verdict += f" Not observable, and as in the guess: {parameters_in_words(unobservable)}."
    return verdict


def _notes(planes: LaserPlanes, fit: PlaneFit, pixel_sd_px: float, seen: int) -> tuple[str, ...]:
    used = len(planes.ends_m)
    notes = [
        f"corners are known to {pixel_sd_px:.2g} px, lines on the board to"
        f" {float(np.median(planes.line_sd_m)) * 1000:.2g} mm"
    ]
    if used < seen:
        notes.append(f"at {seen - used} places no segment of the LiDAR lies on the board")
    if fit.planes.view_sd_m > 0.0:
        notes.append(
            f"the residuals show {fit.planes.view_sd_m * 1000:.2g} mm besides, from place to place:"
            " the deviations count it"
        )
    return tuple(notes)
