"""Intrinsics of a camera from images of a checkerboard: Zhang 2000 (pinhole with the distortion of
Brown) and Kannala and Brandt 2006 (fisheye), both by OpenCV, judged on images they have not seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.board.board import Board
from fusion_core.calibration.board.board_pose import PlanePose, fit_plane_pose
from fusion_core.calibration.board.lens_fit import CameraModel, fit_lens
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.model.conventions import BoolArray, FloatArray, read_only
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting

_NAMES = {"plumb_bob": ("k1", "k2", "p1", "p2", "k3"), "equidistant": ("k1", "k2", "k3", "k4")}
# Cells of the coverage, along the image's sides.
COVERAGE_CELLS = (12, 8)


class IntrinsicsSettings(StageSettings):
    """How intrinsics are estimated and judged."""

    model: CameraModel = setting("pinhole", "Projection and distortion of the lens")
    folds: int = setting(
        20, "Most groups of images that are left out in turn", unit="groups", ge=3, le=200
    )
    outlier_ratio: float = setting(
        4.0,
        "An image is left out when its error, held out, is this multiple of the median image's",
        ge=1.5,
        le=1000.0,
    )
    higher_order_gain: float = setting(
        0.01,
        "Least relative fall of the held-out error for which the highest distortion terms (k3;"
        " fisheye: k3 and k4) are kept",
        ge=0.0,
        le=1.0,
    )
    tilt_min_deg: float = setting(
        5.0, "Least angle between two of the boards", unit="deg", ge=0.0, le=60.0
    )
    focal_sd_max: float = setting(
        0.1, "Largest standard deviation of the focal length, relative to it", ge=1e-6, le=1.0
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class IntrinsicsEstimate:
    """Intrinsics, and how far they can be trusted.

    ``names``, ``values``, ``sd``: fx fy cx cy and the coefficients, with one standard deviation
    each by the jackknife over groups of images. ``rms_held_out_px``: Song's (18) over images that
    the intrinsics have not seen: the pose of such an image is fitted to every other corner, the
    error measured on the others. ``rms_used_px``: over the images that they have seen.
    ``image_rms_px``: (n,) of each image, held out; NaN without a board. ``outliers``: (n,) images
    that were left out. ``residuals_px``: for each image (N, 2), None for those not used.
    ``coverage``: fraction of the image's cells that hold a corner.
    """

    intrinsics: CameraIntrinsics
    names: tuple[str, ...]
    values: FloatArray
    sd: FloatArray
    rms_held_out_px: float
    rms_used_px: float
    image_rms_px: FloatArray
    outliers: BoolArray
    residuals_px: tuple[FloatArray | None, ...]
    coverage: float
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        for array in (self.values, self.sd, self.image_rms_px, self.outliers):
            read_only(array)


def estimate_intrinsics(
    board: Board,
    corners_px: Sequence[FloatArray | None],
    shape: tuple[int, int],
    settings: IntrinsicsSettings | None = None,
) -> IntrinsicsEstimate:
    """Intrinsics from the corners of ``board`` in images of ``shape`` (rows, columns).

    ``corners_px``: for each image (N, 2), None where it shows no board. Raises CalibrationFailed
    for fewer than three boards, for boards that are all parallel, and where the focal length is
    not determined.
    """
    settings = settings or IntrinsicsSettings()
    problem = _Problem(board, corners_px, shape)
    if len(problem.seen) < 3:
        raise CalibrationFailed(
            f"the board is seen whole in {len(problem.seen)} of {len(corners_px)} images, at least"
            " 3 are needed.",
            advice="Take ten or more, with the board tilted and in every part of the image.",
        )
    trial = _better_order(problem, problem.seen, settings)
    _require_tilts(problem, trial, settings)
    kept = _without_outliers(problem, trial, settings)
    if len(kept) < len(problem.seen):
        trial = _better_order(problem, kept, settings)
    values = _vector(trial.intrinsics)
    names = ("fx", "fy", "cx", "cy", *_NAMES[trial.intrinsics.distortion_model])
    sd = trial.jackknife_sd()
    if not sd[0] <= settings.focal_sd_max * values[0]:
        raise CalibrationFailed(
            f"the images do not determine the focal length: {values[0]:.4g} ± {sd[0]:.2g} px.",
            advice="Take more images, with the board tilted by 20° to 45° and near the rim.",
        )
    outliers = np.zeros(len(corners_px), dtype=np.bool_)
    outliers[[index for index in problem.seen if index not in kept]] = True
    poses = {index: problem.pose(index, trial.intrinsics) for index in kept}
    return IntrinsicsEstimate(
        intrinsics=trial.intrinsics,
        names=names[: values.size],
        values=values,
        sd=sd,
        rms_held_out_px=trial.held_out_px,
        rms_used_px=reprojection_rms(
            np.concatenate([pose.residuals_px for pose in poses.values()])
        ),
        image_rms_px=_image_rms(problem, trial, kept),
        outliers=outliers,
        residuals_px=tuple(
            poses[index].residuals_px if index in poses else None
            for index in range(len(corners_px))
        ),
        coverage=_coverage([problem.corners(index) for index in kept], shape),
        notes=_notes(problem, trial, kept),
    )


def held_out_residuals_px(
    board: Board, corners_px: FloatArray, intrinsics: CameraIntrinsics
) -> FloatArray:
    """(N, 2) errors of one image: the pose is fitted to every other corner, the error measured on
    the others, and the other way round. NaN where no pose fits."""
    points_m, errors = board.points_m(), np.full(corners_px.shape, np.nan)
    row, column = np.divmod(np.arange(points_m.shape[0]), board.columns)
    even = (row + column) % 2 == 0
    for fitted in (even, ~even):
        pose = fit_plane_pose(points_m[fitted], corners_px[fitted], intrinsics)
        if pose is not None:
            errors[~fitted] = pose.errors_px(points_m[~fitted], corners_px[~fitted], intrinsics)
    return errors


@dataclass(frozen=True, slots=True)
class _Problem:
    """The corners of all images; functions of it take the indices of those that are used."""

    board: Board
    corners_px: Sequence[FloatArray | None]
    shape: tuple[int, int]

    @property
    def seen(self) -> list[int]:
        return [index for index, corners in enumerate(self.corners_px) if corners is not None]

    def corners(self, index: int) -> FloatArray:
        corners = self.corners_px[index]
        assert corners is not None, "only images with a board are asked for"
        return corners

    def pose(self, index: int, intrinsics: CameraIntrinsics) -> PlanePose:
        pose = fit_plane_pose(self.board.points_m(), self.corners(index), intrinsics)
        if pose is None:
            raise CalibrationFailed(
                f"no pose of the board explains its corners in image {index + 1}.",
                advice="Leave this image out.",
            )
        return pose

    def fit(
        self,
        used: list[int],
        model: CameraModel,
        higher: bool,
        start: CameraIntrinsics | None = None,
    ) -> CameraIntrinsics | None:
        corners = [self.corners(index) for index in used]
        return fit_lens(self.board.points_m(), corners, self.shape, model, higher, start)

    def held_out(self, index: int, intrinsics: CameraIntrinsics) -> FloatArray:
        return held_out_residuals_px(self.board, self.corners(index), intrinsics)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A fit to all images, and one without each group of them."""

    intrinsics: CameraIntrinsics
    without: list[tuple[list[int], CameraIntrinsics]]
    held_out: dict[int, FloatArray]

    @property
    def held_out_px(self) -> float:
        return reprojection_rms(np.concatenate(list(self.held_out.values())))

    def jackknife_sd(self) -> FloatArray:
        """The jackknife over groups: g fits, each without one of them."""
        fits = np.array([_vector(intrinsics) for _, intrinsics in self.without])
        count = fits.shape[0]
        spread: FloatArray = np.sqrt(
            (count - 1) / count * ((fits - fits.mean(axis=0)) ** 2).sum(axis=0)
        )
        return spread


def _better_order(problem: _Problem, used: list[int], settings: IntrinsicsSettings) -> _Trial:
    """The highest terms of the distortion are kept where images that were left out gain by them."""
    low, high = (_trial(problem, used, settings, higher) for higher in (False, True))
    trials = [trial for trial in (low, high) if trial is not None]
    if not trials:
        raise CalibrationFailed(
            f"no {settings.model} camera explains the corners of {len(used)} images.",
            advice="Check the size of the board, and try the other --model.",
        )
    if low is None or high is None:
        return trials[0]
    gain = 1.0 - high.held_out_px / low.held_out_px
    return high if gain > settings.higher_order_gain else low


def _trial(
    problem: _Problem, used: list[int], settings: IntrinsicsSettings, higher: bool
) -> _Trial | None:
    whole = problem.fit(used, settings.model, higher)
    if whole is None:
        return None
    groups = min(settings.folds, len(used))
    without, held_out = [], {}
    for group in range(groups):
        left_out = used[group::groups]
        rest = [index for index in used if index not in left_out]
        fitted = problem.fit(rest, settings.model, higher, start=whole)
        if fitted is None:
            return None
        without.append((left_out, fitted))
        for index in left_out:
            held_out[index] = problem.held_out(index, fitted)
    if not np.isfinite(reprojection_rms(np.concatenate(list(held_out.values())))):
        return None
    return _Trial(whole, without, held_out)


def _vector(intrinsics: CameraIntrinsics) -> FloatArray:
    focal_and_centre = (intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy)
    return np.array([*focal_and_centre, *intrinsics.distortion])


def _require_tilts(problem: _Problem, trial: _Trial, settings: IntrinsicsSettings) -> None:
    """Boards that are all parallel leave the focal length open: Zhang 2000, §4."""
    normals = np.array(
        [problem.pose(index, trial.intrinsics).T_camera_plane[:3, 2] for index in problem.seen]
    )
    cosines = np.abs(normals @ normals.T)
    tilt_deg = float(np.degrees(np.arccos(np.clip(cosines.min(), 0.0, 1.0))))
    if tilt_deg < settings.tilt_min_deg:
        raise CalibrationFailed(
            f"the {len(normals)} boards are parallel to within {tilt_deg:.1f}°, which leaves the"
            " focal length open.",
            advice="Tilt the board by 20° to 45° about both of its axes.",
        )


def _without_outliers(problem: _Problem, trial: _Trial, settings: IntrinsicsSettings) -> list[int]:
    rms_px = {index: reprojection_rms(errors) for index, errors in trial.held_out.items()}
    limit_px = settings.outlier_ratio * float(np.median(list(rms_px.values())))
    kept = [index for index in problem.seen if rms_px[index] <= limit_px]
    return kept if len(kept) >= 3 else problem.seen


def _image_rms(problem: _Problem, trial: _Trial, kept: list[int]) -> FloatArray:
    rms_px = np.full(len(problem.corners_px), np.nan)
    for index in problem.seen:
        errors = trial.held_out[index] if index in kept else None
        if errors is None:
            errors = problem.held_out(index, trial.intrinsics)
        rms_px[index] = reprojection_rms(errors)
    return rms_px


def _coverage(corners_px: list[FloatArray], shape: tuple[int, int]) -> float:
    across, down = COVERAGE_CELLS
    all_px = np.concatenate(corners_px)
    column = np.clip(all_px[:, 0] / shape[1] * across, 0, across - 1).astype(int)
    row = np.clip(all_px[:, 1] / shape[0] * down, 0, down - 1).astype(int)
    return len(np.unique(row * across + column)) / (across * down)


def _notes(problem: _Problem, trial: _Trial, kept: list[int]) -> tuple[str, ...]:
    notes = [
        f"image {index + 1}: the board is not found"
        for index, corners in enumerate(problem.corners_px)
        if corners is None
    ]
    notes += [
        f"image {index + 1} is left out: its error is far above the others'"
        for index in problem.seen
        if index not in kept
    ]
    all_px = np.concatenate([problem.corners(index) for index in kept])
    height, width = problem.shape
    edges = {
        "left": all_px[:, 0].min() / width,
        "right": 1.0 - all_px[:, 0].max() / width,
        "top": all_px[:, 1].min() / height,
        "bottom": 1.0 - all_px[:, 1].max() / height,
    }
    empty = [f"{edge} {share:.0%}" for edge, share in edges.items() if share > 0.15]
    if empty:
        notes.append(
            f"no corners in the image's {', '.join(empty)}: the distortion there is extrapolated"
        )
    return tuple(notes)
