"""A 2D LiDAR and a camera from laser points with their pixels: Fu 2024 (1)-(4).

(3) with the distortion of the lens: u = π(R p + t), p = (x, y, 0). The points are all in the plane
of the scanner, so that they determine R and t as a plane does: by a homography, with two solutions
that both are tried, then by Levenberg-Marquardt on SE(3).
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.board.board_pose import fit_plane_poses
from fusion_core.calibration.board.laser_pixel_noise import PairFit, PairNoise, Pairs, fit_pairs
from fusion_core.calibration.board.observability import (
    observable_covariance,
    unobservable_parameters,
)
from fusion_core.calibration.pose_error import rotation_angle_rad
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate, parameters_in_words
from fusion_core.model.seeds import SEED_MAX
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting

# Six parameters, two numbers from each pair: with this many there is something left to judge by.
_PAIRS_MIN = 6
# No 2D LiDAR reaches farther: such points are in millimetres.
_RANGE_MAX_M = 250.0
# A spread across a line of no more than so many deviations of the laser's noise is that noise.
_LINE_NOISE_SD = 3.0
# Of points on a line the spread is 0 but for rounding, as a fraction of that along it.
_ROUNDING = 1e-9
# Pairs in a random start: more than the four of a homography, few enough to miss the outliers.
_DRAWN = 7
# Rotations farther apart than this are two solutions, not one.
_APART_RAD = np.radians(3.0)
# Solutions that are refined.
_CANDIDATES = 4
# Of a Rayleigh distribution, one in 500 lies beyond.
_FAR_OFF = 3.5


class LaserPixelSettings(StageSettings):
    """How R and t are found from pairs."""

    starts: int = setting(
        50, "Random subsets of pairs that the search starts from", ge=0, le=10_000
    )
    folds: int = setting(10, "Groups of pairs that are left out in turn", ge=2, le=1000)
    huber: float = setting(
        2.0,
        "Errors of more standard deviations than this count linearly",
        unit="sigma",
        ge=1.0,
        le=100.0,
    )
    ambiguity: float = setting(
        1.5,
        "A second pose is named where its error is less than this multiple of the best",
        ge=1.0,
        le=100.0,
    )
    rotation_sd_max_deg: float = setting(
        5.0, "An angle less certain than this is unobservable", unit="deg", ge=1e-3, le=90.0
    )
    translation_sd_max_m: float = setting(
        0.3, "A coordinate less certain than this is unobservable", unit="m", ge=1e-4, le=100.0
    )
    seed: int = setting(0, "Seed of the random starts", ge=0, le=SEED_MAX)

    def sd_limits(self) -> FloatArray:
        """(6,) for POSE_PARAMETERS."""
        rotation_rad = np.radians(self.rotation_sd_max_deg)
        return np.array([rotation_rad] * 3 + [self.translation_sd_max_m] * 3)


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserPixelResult:
    """``residuals_px``, ``held_out_px``: (N, 2) measured - projected, the latter each by a pose
    that has not seen its pair. ``guess_px``: (N, 2) those of the guess, None without one.
    ``noise``: found from the residuals.
    """

    estimate: ExtrinsicsEstimate
    residuals_px: FloatArray
    held_out_px: FloatArray
    guess_px: FloatArray | None
    noise: PairNoise

    def __post_init__(self) -> None:
        read_only(self.residuals_px)
        read_only(self.held_out_px)


def calibrate_laser_pixels(
    points_m: FloatArray,
    pixels: FloatArray,
    intrinsics: CameraIntrinsics,
    settings: LaserPixelSettings | None = None,
    *,
    T_guess: FloatArray | None = None,
) -> LaserPixelResult:
    """T_camera_lidar of (N, 2) points of the scanner's plane and their (N, 2) pixels.

    What the pairs leave open keeps the value of ``T_guess`` (4, 4), and the guess is the result
    where the pairs that a fit has not seen lie closer to it. Raises CalibrationFailed for fewer
    than six pairs, for points that cannot be metres, pixels outside the image, points on one line
    without a guess, and where no pose explains the pairs.
    """
    settings = settings or LaserPixelSettings()
    _require_plausible(points_m, pixels, intrinsics)
    flat = np.column_stack([points_m, np.zeros(len(points_m))])
    pairs = Pairs(flat, pixels, intrinsics)
    solutions = _solutions(pairs, settings, T_guess)
    if solutions and _are_on_one_line(points_m, solutions[0].noise.laser_m):
        # Their noise would be taken for a second direction.
        flat[:, :2] = _moved_onto_line(points_m)
        pairs = Pairs(flat, pixels, intrinsics)
        solutions = [] if T_guess is None else _solutions(pairs, settings, T_guess)
    if not solutions and _are_on_one_line(flat[:, :2], 0.0):
        raise CalibrationFailed(
            f"all {len(points_m)} laser points lie on one line, which leaves the pose open.",
            advice="Add pairs at other distances and sides, or give --guess.",
        )
    if not solutions:
        raise CalibrationFailed(
            f"no pose of the LiDAR explains the {len(pixels)} pairs.",
            advice="Check that each line holds x y u v, and that the intrinsics are this camera's.",
        )
    fit = solutions[0]
    unobservable = unobservable_parameters(fit.information, settings.sd_limits())
    free = np.array([name not in unobservable for name in POSE_PARAMETERS])
    if unobservable and (T_guess is None or not free.any()):
        raise CalibrationFailed(
            f"the pairs do not show {parameters_in_words(unobservable)}: the laser points are too "
            "few or lie too close to one line.",
            advice="Add pairs at other distances and sides, or give --guess.",
        )
    if unobservable and T_guess is not None:
        fit = fit_pairs(pairs, T_guess, settings.huber, free)
    held_out_px = _held_out(pairs, fit, settings, free, T_guess)
    guess_px = None if T_guess is None else pairs.residuals_px(T_guess)
    improved = guess_px is None or fit.cost(held_out_px) < fit.cost(guess_px)
    kept_px = held_out_px if improved or guess_px is None else guess_px
    estimate = ExtrinsicsEstimate(
        T_camera_lidar=fit.T_camera_lidar if improved or T_guess is None else T_guess.copy(),
        covariance=observable_covariance(fit.information, unobservable),
        method="laser points with their pixels",
        verdict=_verdict(fit, held_out_px, None if improved else guess_px, unobservable),
        improved=improved,
        T_guess=None if T_guess is None else T_guess.copy(),
        reprojection_rms_px=reprojection_rms(kept_px),
        reprojection_rms_used_px=reprojection_rms(fit.residuals_px),
        unobservable=unobservable,
        notes=_notes(fit, solutions[1:], settings),
    )
    return LaserPixelResult(
        estimate=estimate,
        residuals_px=fit.residuals_px,
        held_out_px=held_out_px,
        guess_px=guess_px,
        noise=fit.noise,
    )


def _require_plausible(
    points_m: FloatArray, pixels: FloatArray, intrinsics: CameraIntrinsics
) -> None:
    count = len(points_m)
    if count < _PAIRS_MIN:
        raise CalibrationFailed(
            f"{count} pairs do not determine a pose, at least {_PAIRS_MIN} are needed.",
            advice="Twenty or more, at several distances and on both sides, are good.",
        )
    farthest_m = float(np.linalg.norm(points_m, axis=1).max())
    if farthest_m > _RANGE_MAX_M:
        raise CalibrationFailed(
            f"a laser point is {farthest_m:g} m away.", advice="Lengths are in metres."
        )
    width, height = intrinsics.width, intrinsics.height
    u, v = pixels[:, 0], pixels[:, 1]
    outside = (u < -0.5) | (v < -0.5) | (u > width - 0.5) | (v > height - 0.5)
    if outside.any():
        first = int(np.argmax(outside))
        raise CalibrationFailed(
            f"pixel ({u[first]:g}, {v[first]:g}) of pair {first + 1} is outside the image of"
            f" {width} x {height} that the intrinsics are for.",
            advice="Give the intrinsics of the images in which the pixels were measured.",
        )


def _are_on_one_line(points_m: FloatArray, noise_m: float) -> bool:
    """Whether (N, 2) points are on one line, or on one point, but for their noise."""
    length, width = np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)
    by_noise = _LINE_NOISE_SD * noise_m * np.sqrt(len(points_m))
    return bool(width <= max(by_noise, _ROUNDING * length))


def _moved_onto_line(points_m: FloatArray) -> FloatArray:
    """(N, 2) points at their nearest places on the line that fits them best."""
    middle = points_m.mean(axis=0)
    _, _, axes = np.linalg.svd(points_m - middle, full_matrices=False)
    moved: FloatArray = middle + np.outer((points_m - middle) @ axes[0], axes[0])
    return moved


def _solutions(
    pairs: Pairs, settings: LaserPixelSettings, T_guess: FloatArray | None
) -> list[PairFit]:
    """Refined poses, the best first. Starts: the guess, all pairs, and random subsets of them."""
    rng = np.random.default_rng(settings.seed)
    count = len(pairs.pixels)
    starts = [] if T_guess is None else [T_guess]
    draws = [np.arange(count)]
    if count > _DRAWN:
        draws += [rng.choice(count, _DRAWN, replace=False) for _ in range(settings.starts)]
    for drawn in draws:
        part = pairs.subset(drawn)
        poses = fit_plane_poses(part.points_m, part.pixels, pairs.intrinsics)
        starts += [pose.T_camera_plane for pose in poses]

    def median_px(T: FloatArray) -> float:
        return float(np.median(np.linalg.norm(pairs.residuals_px(T), axis=1)))

    chosen: list[FloatArray] = []
    for T in sorted(starts, key=median_px):
        if all(rotation_angle_rad(T, other) > _APART_RAD for other in chosen):
            chosen.append(T)
        if len(chosen) == _CANDIDATES:
            break
    fits = [fit_pairs(pairs, T, settings.huber) for T in chosen]
    ahead = [fit for fit in fits if pairs.are_ahead(fit.T_camera_lidar)]
    return sorted(ahead, key=lambda fit: fit.median_px)


def _held_out(
    pairs: Pairs,
    fit: PairFit,
    settings: LaserPixelSettings,
    free: BoolArray,
    T_guess: FloatArray | None,
) -> FloatArray:
    """(N, 2) residuals, each by a fit without its group of pairs."""
    count = len(pairs.pixels)
    order = np.random.default_rng(settings.seed).permutation(count)
    folds = min(settings.folds, count)
    held_out_px = np.empty((count, 2))
    T_start = fit.T_camera_lidar if free.all() or T_guess is None else T_guess
    for fold in range(folds):
        left_out = order[fold::folds]
        rest = pairs.subset(np.setdiff1d(order, left_out))
        T = fit_pairs(rest, T_start, settings.huber, free).T_camera_lidar
        held_out_px[left_out] = pairs.subset(left_out).residuals_px(T)
    return held_out_px


def _verdict(
    fit: PairFit,
    held_out_px: FloatArray,
    kept_guess_px: FloatArray | None,
    unobservable: tuple[str, ...],
) -> str:
    count, held_out_rms_px = len(held_out_px), reprojection_rms(held_out_px)
    if kept_guess_px is not None:
        guess_rms_px = reprojection_rms(kept_guess_px)
        verdict = (
            f"The guess is kept: its {count} pairs are {guess_rms_px:.2f} px off, against"
            f" {held_out_rms_px:.2f} px of a result that has not seen them."
        )
    else:
        used_rms_px = reprojection_rms(fit.residuals_px)
        verdict = (
            f"Found from {count} pairs: {held_out_rms_px:.2f} px on pairs that were left out,"
            f" {used_rms_px:.2f} px on those used."
        )
    if unobservable:
        verdict += f" Not observable, and as in the guess: {parameters_in_words(unobservable)}."
    return verdict


def _notes(fit: PairFit, others: list[PairFit], settings: LaserPixelSettings) -> tuple[str, ...]:
    notes = [
        f"the residuals show noise of {fit.noise.pixel_px:.2g} px in the pixels and"
        f" {fit.noise.laser_m * 1000:.2g} mm in the laser points"
    ]
    far_off = np.flatnonzero(fit.distances(fit.residuals_px) > _FAR_OFF)
    if far_off.size:
        named = ", ".join(str(index + 1) for index in far_off[:10])
        notes.append(f"pairs that lie far off and count little: {named}")
    for other in others:
        apart_rad = rotation_angle_rad(other.T_camera_lidar, fit.T_camera_lidar)
        if apart_rad > _APART_RAD and other.median_px < settings.ambiguity * fit.median_px:
            notes.append(
                f"a second pose, turned by {np.degrees(apart_rad):.1f}°, explains the pairs nearly"
                f" as well (median {other.median_px:.2f} px, not {fit.median_px:.2f} px): points of"
                " one plane leave that open; pairs nearer to the camera decide"
            )
            break
    return tuple(notes)
