"""PL-ICP: the motion between two sweeps of a 2D LiDAR, with its covariance (Censi 2008).

    import numpy as np
    from fusion_core.registration.pl_icp import match_scans

    match = match_scans(
        first_m, second_m, angle_min_rad=-np.pi, angle_increment_rad=2.0 * np.pi / 720
    )
    x_m, y_m, yaw_rad = match.pose_first_second     # where the second sweep was taken
    match.covariance                                # (3, 3) of these three
    match.is_observable                             # False in a corridor

``first_m`` and ``second_m`` are plain arrays of ranges in metres, NaN (or inf, or 0) for a beam
without a return. An initial guess is optional: starts are searched within ``search_translation_m``
and ``search_rotation_rad`` of it by correlative matching. Sweeps that cannot be matched raise
RegistrationFailed with the reason.

To match many sweeps with one, prepare it once:

    reference = ReferenceScan.of(first_m, angle_min_rad=..., angle_increment_rad=...)
    match = match_to_reference(reference, second_m, angle_min_rad=..., angle_increment_rad=...)

Li 2022 eq. 4 is the cost: Σ (n_i · (p_i ⊕ q - Π(p_i ⊕ q_k)))², the projection Π on the reference
being on the line of local_lines.py and n_i its normal. Unlike Censi 2008, lines are fitted to runs
of beams, and each pair is weighted by the range noise across its line, which brings the estimate
close to the Cramér-Rao bound.
"""

from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import Self

import numpy as np
from pydantic import model_validator

from fusion_core.model.conventions import FloatArray, read_only, wrap_angle
from fusion_core.model.errors import RegistrationFailed
from fusion_core.registration.correlative import (
    POSES_MAX,
    SearchWindow,
    count_poses,
    find_best_pose,
)
from fusion_core.registration.likelihood_grid import LikelihoodPyramid, make_likelihood_pyramid
from fusion_core.registration.line_icp import iterate_pl_icp
from fusion_core.registration.local_lines import LocalLines, estimate_range_sigma_m, fit_local_lines
from fusion_core.registration.match_covariance import match_covariance, trimmed_gaussian_variance
from fusion_core.registration.polar_correspondence import PolarScan, make_polar_scan
from fusion_core.settings import StageSettings, setting

# Set by hand: top blocks of 2⁴ = 16 cells are about as wide as the default window, so that few are
# scored.
_SEARCH_LEVELS = 5


class PlIcpSettings(StageSettings):
    """Settings of ``match_scans``."""

    range_sigma_m: float | None = setting(
        None,
        "Standard deviation of a range; estimated from the sweep if not given",
        unit="m",
        ge=1e-6,
        le=1.0,
    )
    pair_distance_max_m: float = setting(
        0.3,
        "Greatest distance between a point and its nearest point in the reference",
        unit="m",
        ge=1e-6,
        le=10.0,
        formerly="pair_distance_m",
    )
    trim_sigmas: float = setting(
        3.0, "Pairs with residuals of more standard deviations are trimmed", ge=1.0, le=10.0
    )
    iterations_max: int = setting(50, "Most iterations from one start", ge=1, le=1_000)
    beams_min: int = setting(30, "Fewest valid beams of a sweep", unit="beams", ge=6, le=10_000)
    inlier_ratio_min: float = setting(
        0.4,
        "Least ratio of inliers to the second sweep's valid beams",
        ge=1e-6,
        le=1.0,
        formerly="inlier_share_min",
    )
    inlier_ratio_sufficient: float = setting(
        0.7,
        "Inlier ratio at which no other start is tried",
        ge=1e-6,
        le=1.0,
        formerly="inlier_share_sure",
    )
    residual_ratio_max: float = setting(
        4.0,
        "Greatest ratio of the robust residual to that of range noise",
        gt=1.0,
        le=1e3,
        formerly="residual_max",
    )
    search_translation_m: float = setting(
        1.0, "Start search: half width along x and y", unit="m", ge=0.0, le=50.0
    )
    search_rotation_rad: float = setting(
        np.pi / 3.0, "Start search: half width in rotation", unit="rad", ge=0.0, le=np.pi
    )
    search_resolution_m: float = setting(0.1, "Start search: cell size", unit="m", ge=0.01, le=2.0)
    search_step_rad: float = setting(
        0.0175, "Start search: rotation step", unit="rad", ge=0.0005, le=0.5
    )
    search_points: int = setting(
        90, "Start search: points of the second sweep", unit="points", ge=10, le=10_000
    )

    @model_validator(mode="after")
    def _searchable(self) -> Self:
        translation_m, rotation_rad = _widest_window(self)
        poses = count_poses(
            translation_m, rotation_rad, self.search_resolution_m, self.search_step_rad
        )
        if poses > POSES_MAX:
            raise ValueError(
                f"search_translation_m = {self.search_translation_m:g} over search_resolution_m = "
                f"{self.search_resolution_m:g} and search_step_rad = {self.search_step_rad:g} "
                f"makes {poses:.1g} poses to search, more than {POSES_MAX:.0e}"
            )
        return self


@dataclass(frozen=True, eq=False)
class ReferenceScan:
    """A sweep prepared as reference: its beams, range noise, local lines and likelihood grid."""

    scan: PolarScan
    sigma_m: float
    lines: LocalLines
    settings: PlIcpSettings

    @classmethod
    def of(
        cls,
        ranges_m: FloatArray,
        *,
        angle_min_rad: float,
        angle_increment_rad: float,
        settings: PlIcpSettings | None = None,
    ) -> "ReferenceScan":
        """Prepare a sweep (N,); arguments and errors as in ``match_scans``."""
        settings = settings or PlIcpSettings()
        scan, sigma_m = _prepare_sweep(
            "first", ranges_m, angle_min_rad, angle_increment_rad, settings
        )
        lines: LocalLines = fit_local_lines(scan, sigma_m)
        return cls(scan=scan, sigma_m=sigma_m, lines=lines, settings=settings)

    @cached_property
    def pyramid(self) -> LikelihoodPyramid:
        """The likelihood grid of the start search."""
        resolution_m = self.settings.search_resolution_m
        return make_likelihood_pyramid(
            _scan_points(self.scan),
            resolution_m=resolution_m,
            truncation_m=2.0 * resolution_m,
            levels=_SEARCH_LEVELS,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanMatch:
    """The motion between two sweeps, and its quality.

    ``pose_first_second``: (3,) x, y, yaw of the second sweep in the first one's frame.
    ``covariance``: (3, 3) of it, see match_covariance.py. ``unobservable_directions``: (k, 3)
    directions of (x, y, yaw) that the sweeps do not determine, as along a corridor; there the pose
    keeps the guess and the standard deviation is 100 m. ``rms_error_m``: root mean square distance
    of the inliers from their lines. ``residual_ratio``: the pairs' robust residual over that of
    range noise. ``inlier_ratio``: of the second sweep's valid beams. ``iterations``: of all starts.
    ``start``: (3,) the pose from which the match was found; ``starts``: how many were tried.
    ``converged``: False where the best match fits but its steps had not become small when
    ``iterations_max`` ended them.
    """

    pose_first_second: FloatArray
    covariance: FloatArray
    unobservable_directions: FloatArray
    rms_error_m: float
    residual_ratio: float
    inlier_ratio: float
    iterations: int
    start: FloatArray
    starts: int
    converged: bool

    def __post_init__(self) -> None:
        for array in (
            self.pose_first_second,
            self.covariance,
            self.unobservable_directions,
            self.start,
        ):
            read_only(array)

    @property
    def is_observable(self) -> bool:
        """Whether the sweeps determine the motion in every direction."""
        return bool(self.unobservable_directions.shape[0] == 0)


def match_scans(
    first_ranges_m: FloatArray,
    second_ranges_m: FloatArray,
    *,
    angle_min_rad: float,
    angle_increment_rad: float,
    guess: FloatArray | None = None,
    settings: PlIcpSettings | None = None,
) -> ScanMatch:
    """The pose of the second sweep in the frame of the first.

    ``first_ranges_m``, ``second_ranges_m``: (N,) and (M,) metres; what is not finite and positive
    is a missing beam. Both have the given angles, counter-clockwise; the increment may be
    negative. ``guess``: (3,) x, y, yaw in metres and radians. With a guess it is refined, and a
    search about it is the fallback; without, the search about the first sweep's own pose comes
    first. Raises RegistrationFailed where a sweep has too few beams or no start leads to a match.
    """
    reference = ReferenceScan.of(
        first_ranges_m,
        angle_min_rad=angle_min_rad,
        angle_increment_rad=angle_increment_rad,
        settings=settings,
    )
    return match_to_reference(
        reference,
        second_ranges_m,
        angle_min_rad=angle_min_rad,
        angle_increment_rad=angle_increment_rad,
        guess=guess,
    )


def match_to_reference(
    reference: ReferenceScan,
    ranges_m: FloatArray,
    *,
    angle_min_rad: float,
    angle_increment_rad: float,
    guess: FloatArray | None = None,
) -> ScanMatch:
    """As ``match_scans``, with a first sweep that has been prepared."""
    settings = reference.settings
    moving, sigma_m = _prepare_sweep(
        "second", ranges_m, angle_min_rad, angle_increment_rad, settings
    )
    centre = np.zeros(3) if guess is None else np.array(guess, dtype=np.float64)
    if centre.shape != (3,) or not np.isfinite(centre).all():
        raise ValueError(f"a guess must be (3,) and finite, got {guess}")

    best: _Candidate | None = None
    failures = []
    iterations = starts = 0
    for attempt in _search_windows(guess is not None, settings):
        start = centre if attempt is None else _search_start(reference, moving, centre, attempt)
        found, steps = _refine(reference, moving, sigma_m, start)
        starts += 1
        iterations += steps
        if isinstance(found, str):
            failures.append(found)
            continue
        if attempt is not None and found.unobservable_directions.size:
            # The search picks an arbitrary pose along an unobservable direction: keep the centre's.
            again, steps = _refine(reference, moving, sigma_m, _move_towards_guess(found, centre))
            iterations += steps
            found = found if isinstance(again, str) else again
        if best is None or (found.converged, found.inlier_ratio) > (
            best.converged,
            best.inlier_ratio,
        ):
            best = found
        if best.converged and best.inlier_ratio >= settings.inlier_ratio_sufficient:
            break
    if best is None:
        raise RegistrationFailed(
            f"the two sweeps do not match from any of {starts} starts ({'; '.join(failures)}).",
            advice="Give a guess, widen the search, or match sweeps that are nearer to each other.",
        )
    best.pose[2] = wrap_angle(best.pose[2])
    return ScanMatch(
        pose_first_second=best.pose,
        covariance=best.covariance,
        unobservable_directions=best.unobservable_directions,
        rms_error_m=best.rms_error_m,
        residual_ratio=best.residual_ratio,
        inlier_ratio=best.inlier_ratio,
        iterations=iterations,
        start=best.start,
        starts=starts,
        converged=best.converged,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Candidate:
    """The match from one start; the fields are those of ScanMatch."""

    start: FloatArray
    pose: FloatArray
    covariance: FloatArray
    unobservable_directions: FloatArray
    lever_m: float
    rms_error_m: float
    residual_ratio: float
    inlier_ratio: float
    converged: bool


def _refine(
    reference: ReferenceScan, moving: PolarScan, sigma_m: float, start: FloatArray
) -> tuple[_Candidate | str, int]:
    """PL-ICP from one start: the match, or why it failed; the iterations."""
    settings = reference.settings
    sigmas_m = (reference.sigma_m, sigma_m)
    pose, pairs, iterations, converged, residual = iterate_pl_icp(
        reference.scan,
        reference.lines,
        moving,
        start,
        sigmas_m,
        settings.pair_distance_max_m,
        settings.trim_sigmas,
        settings.iterations_max,
    )
    inliers = pairs.partner >= 0
    inlier_ratio = np.count_nonzero(inliers) / inliers.size
    if inlier_ratio < settings.inlier_ratio_min:
        return (
            f"{inlier_ratio:.0%} of the beams fit, {settings.inlier_ratio_min:.0%} must",
            iterations,
        )
    if residual > settings.residual_ratio_max:
        return f"residuals are {residual:.3g} times the ranges' noise", iterations
    covariance, unobservable_directions, lever_m = match_covariance(
        pairs,
        reference.scan,
        reference.lines,
        moving,
        pose,
        sigmas_m,
        trimmed_gaussian_variance(settings.trim_sigmas),
    )
    residual_m = pairs.residual_m[inliers]
    candidate = _Candidate(
        start=start,
        pose=pose,
        covariance=covariance,
        unobservable_directions=unobservable_directions,
        lever_m=lever_m,
        rms_error_m=sqrt(residual_m @ residual_m / residual_m.size),
        residual_ratio=residual,
        inlier_ratio=inlier_ratio,
        converged=converged,
    )
    return candidate, iterations


def _move_towards_guess(found: _Candidate, centre: FloatArray) -> FloatArray:
    """The match moved along its unobservable directions to be nearest to ``centre``."""
    scale = np.array([1.0, 1.0, found.lever_m])
    difference = found.pose - centre
    difference[2] = wrap_angle(difference[2])
    directions = found.unobservable_directions * scale
    moved: FloatArray = found.pose - directions.T @ (directions @ (difference * scale)) / scale
    return moved


def _search_windows(has_guess: bool, settings: PlIcpSettings) -> list[tuple[float, float] | None]:
    """How each start is found: None for the guess itself, else the half widths of a search."""
    near = (settings.search_translation_m, settings.search_rotation_rad)
    return [*([None] if has_guess else []), near, _widest_window(settings)]


def _widest_window(settings: PlIcpSettings) -> tuple[float, float]:
    """The last search: every rotation, and twice the translation."""
    return 2.0 * settings.search_translation_m, float(np.pi)


def _search_start(
    reference: ReferenceScan,
    moving: PolarScan,
    centre: FloatArray,
    half_widths: tuple[float, float],
) -> FloatArray:
    """The start that fits best within (metres, radians) of a pose."""
    settings = reference.settings
    points_m = _scan_points(moving)
    stride = max(1, points_m.shape[0] // settings.search_points)
    window = SearchWindow(
        centre=(float(centre[0]), float(centre[1]), float(centre[2])),
        translation_m=half_widths[0],
        rotation_rad=half_widths[1],
    )
    return find_best_pose(
        reference.pyramid, points_m[::stride], window, step_rad=settings.search_step_rad
    )


def _scan_points(scan: PolarScan) -> FloatArray:
    """(M, 2) of the valid beams."""
    points_m: FloatArray = scan.range_m[:, np.newaxis] * np.stack([scan.cos, scan.sin], axis=1)
    return points_m


def _prepare_sweep(
    which: str,
    ranges_m: FloatArray,
    angle_min_rad: float,
    angle_increment_rad: float,
    settings: PlIcpSettings,
) -> tuple[PolarScan, float]:
    scan = make_polar_scan(ranges_m, angle_min_rad, angle_increment_rad)
    if scan.range_m.size < settings.beams_min:
        raise RegistrationFailed(
            f"{scan.range_m.size} of the {which} sweep's {np.size(ranges_m)} beams are valid; "
            f"{settings.beams_min} are needed.",
            advice="Skip this sweep, or lower beams_min.",
        )
    given = settings.range_sigma_m
    return scan, estimate_range_sigma_m(scan) if given is None else given
