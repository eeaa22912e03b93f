"""Better extrinsics of a LiDAR and a camera from a guess, by one cloud and one image of a scene.

    refined = refine_from_guess(points_m, intensity, grey, intrinsics, T_camera_lidar)
    refined.estimate.T_camera_lidar     # the guess itself where nothing better is shown
    refined.estimate.verdict            # why

Neither board nor room is needed; a street will do. The pose is where the intensity's contrast tells
most of the image's (normalised information distance, Pandey et al. 2012) and the depth's steps lie
on the image's edges (Levinson & Thrun 2013), with a prior on how far off the guess may be. Users of
such methods report results worse than their guess, so that a result must pass what it was not
found by:

1. parts of the image are told of better by what the other parts alone have found than at the
   guess, and neither kind of evidence is clearly against it;
2. searches from elsewhere in the prior come back to it, or end where the evidence is clearly less;
3. by its covariance, which is what parts of the image disagree by and a bias that they share, the
   truth is hardly nearer to the guess than to it: in the image, in rotation, and in translation.

The bias is what the scanner's angles, the camera's model and the instants of both have wrong, of
which all parts of one scene tell alike; without a better knowledge, as much as where an edge lies
between two beams. What fails the third goes a part of the way, least of it in the directions that
are least certain: one image shows little of a move along the view, and of far scenes little of any.
Where all fail, the guess is kept.
"""

from dataclasses import dataclass, field
from math import sqrt

import numpy as np

from fusion_core.calibration.pose_error import apply_pose_error
from fusion_core.calibration.refinement.alignment_evidence import (
    EvidenceLevel,
)
from fusion_core.calibration.refinement.guess_acceptance import (
    Candidate,
    best_candidate,
    describe_risk,
    find_objection,
    held_out_gains,
    make_candidates,
    rival_odds,
    squared_in_metric,
    turn_to,
)
from fusion_core.calibration.refinement.guess_input import (
    require_image,
    require_rigid,
    thinned_points,
    usable_points,
)
from fusion_core.calibration.refinement.guess_uncertainty import (
    EvidenceShape,
    bearing_bias,
    evidence_shape,
    jackknife_covariance,
)
from fusion_core.calibration.refinement.pose_search import (
    PosePosterior,
    search_pose,
)
from fusion_core.calibration.refinement.scene_view import (
    BLOCKS,
    SceneView,
    rectify_to_beams,
    view_scene,
)
from fusion_core.model.conventions import BoolArray, ByteArray, FloatArray, read_only
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate
from fusion_core.model.progress import Progress, silent
from fusion_core.model.seeds import SEED_MAX
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting

METHOD = "refinement of a guess by one image (information distance and edges)"
# What a nat counts before the image's parts have been compared.
_FIRST_WEIGHT = 0.3
# The levels of a search without a part.
_LEVELS_WITHOUT = 3
_PROFILE_STEPS = np.linspace(-3.0, 3.0, 13)


class GuessRefinementSettings(StageSettings):
    """Settings of ``refine_from_guess``."""

    guess_rotation_sd_rad: float = setting(
        np.radians(1.0),
        "How far off the guess may be about each axis: standard deviation",
        unit="rad",
        ge=1e-4,
        le=0.2,
    )
    guess_translation_sd_m: float = setting(
        0.05,
        "How far off the guess may be along each axis: standard deviation",
        unit="m",
        ge=1e-4,
        le=1.0,
    )
    starts: int = setting(
        8, "Searches from places around the guess; the share that agrees is the basin", ge=2, le=100
    )
    worse_risk_max: float = setting(
        0.02, "Greatest probability that the result is worse than the guess", ge=1e-6, le=0.5
    )
    bearing_bias_sd_beams: float = setting(
        1.0 / sqrt(12.0),
        "How far off the cloud's bearings may be in the image in a way that one scene does not "
        "show: standard deviation, in angles between neighbouring beams",
        unit="beams",
        ge=0.0,
        le=10.0,
    )
    points_max: int = setting(
        60_000,
        "Most points of the cloud in the image; of more, some are drawn",
        unit="points",
        ge=1_000,
        le=1_000_000,
    )
    seed: int = setting(0, "Seed of the searches' starts", ge=0, le=SEED_MAX)


@dataclass(frozen=True, slots=True, kw_only=True)
class GuessRefinement:
    """A refined guess and the evidence for it.

    ``T_best``: (4, 4) where the evidence and the prior put the pose, whether it was accepted or
    not. ``distance_before``, ``distance_after``: normalised information distance of each family at
    the guess and at the result; ``information_...`` the nats. ``held_out_gain``: for each family
    the nats that each part of the image gains by the result of the others. ``risk``: of being worse
    in the image, in rotation and in translation; empty where the guess is kept. ``profile``:
    (6, steps) nats of the evidence along each of POSE_PARAMETERS through the result, at
    ``profile_offsets`` (6, steps). ``starts``: searches of the basin. ``evidence``: the finest
    level, which tells the information at any other pose.
    """

    estimate: ExtrinsicsEstimate
    T_best: FloatArray
    distance_before: dict[str, float]
    distance_after: dict[str, float]
    information_before: float
    information_after: float
    held_out_gain: dict[str, tuple[float, ...]]
    risk: dict[str, float]
    starts: int
    profile_offsets: FloatArray
    profile: FloatArray
    evidence: EvidenceLevel = field(repr=False)

    def __post_init__(self) -> None:
        for array in (self.T_best, self.profile_offsets, self.profile):
            read_only(array)


def refine_from_guess(
    points_in_lidar_m: FloatArray,
    intensity: FloatArray | None,
    grey: ByteArray,
    intrinsics: CameraIntrinsics,
    T_guess: FloatArray,
    settings: GuessRefinementSettings = GuessRefinementSettings(),  # noqa: B008 - frozen
    progress: Progress = silent,
) -> GuessRefinement:
    """T_camera_lidar (4, 4) near ``T_guess`` from (N, 3) points, NaN for missing, their intensity
    (N,) in any unit, and an image (H, W) of grey values taken at the same time.

    Raises CalibrationFailed where the input does not belong together, or where too few points lie
    in the image at the guess.
    """
    notes: list[str] = []
    points, intensity = usable_points(points_in_lidar_m, intensity, notes)
    require_image(grey, intrinsics)
    require_rigid(T_guess)
    points, intensity = thinned_points(
        points, intensity, intrinsics, T_guess, settings.points_max, settings.seed, notes
    )
    image = rectify_to_beams(points, grey, intrinsics, T_guess)
    sds = np.repeat([settings.guess_rotation_sd_rad, settings.guess_translation_sd_m], 3)
    precision = np.diag(sds**-2.0)
    posterior = PosePosterior(T_guess=T_guess, precision=precision, weight=_FIRST_WEIGHT)

    sigma_rad = settings.guess_rotation_sd_rad
    view = view_scene(points, intensity, image, T_guess, precision, sigma_rad)
    levels, without = len(view.levels), min(len(view.levels), _LEVELS_WITHOUT)
    work = settings.starts * (levels - 1) + 4 + BLOCKS[0] * without
    steps = _Steps(progress, work)
    starts = _starts(sds, settings)
    steps.what = "search from places around the guess"
    # The finest level would move them by less than neighbouring beams are apart.
    found = [
        search_pose(posterior, view.levels[:-1], view.bases[:-1], start, report=steps)
        for start in starts
    ]
    from_guess = view.levels[-2]
    first = min(found, key=lambda error: posterior.cost(error, from_guess))
    tolerance = view.cloud.spacing_rad**2
    agrees = np.array(
        [squared_in_metric(error - first, view.metric) < tolerance for error in found]
    )
    basin = float(np.mean(agrees))

    # Seen from the result, other points may be hidden.
    T_first = apply_pose_error(T_guess, first)
    view = view_scene(points, intensity, image, T_first, precision, sigma_rad)
    steps.what = "refine"
    error = search_pose(posterior, view.levels[-2:], view.bases[-2:], first, report=steps)
    shape = _shape(view, T_guess, error, settings)
    posterior = PosePosterior(T_guess=T_guess, precision=precision, weight=shape.weight)
    error = search_pose(posterior, view.levels[-2:], view.bases[-2:], error, report=steps)
    shape = _shape(view, T_guess, error, settings)

    steps.what = "search without each part of the image"
    parts = _parts()
    results = np.array(
        [_search_without(posterior, view, part, first, error, steps) for part in parts]
    )
    gains = held_out_gains(view, T_guess, results, parts)
    bias = bearing_bias(view.metric, settings.bearing_bias_sd_beams * view.cloud.spacing_rad)
    gain, covariance = shape.posterior(precision, posterior.weight, bias)
    # Both are there: the slopes of the evidence see the parts' disagreement near the result, the
    # jackknife also that of a result which jumps where a part is missing.
    covariance = covariance + gain @ jackknife_covariance(results) @ gain.T
    error = turn_to(posterior, view, gain @ error)

    rival = rival_odds(posterior, from_guess, np.array(found)[~agrees], first)
    reason = find_objection(gains, rival, settings.worse_risk_max)
    chosen = None
    if not reason:
        candidates = make_candidates(error, covariance, view.metric)
        chosen = best_candidate(candidates, error, covariance, view.metric, settings.worse_risk_max)
        if chosen is None:
            reason = describe_risk(candidates, error, covariance, view)
    notes += _notes(view, covariance, sds, chosen)
    result = np.zeros(6) if chosen is None else chosen.error
    T_result = T_guess if chosen is None else apply_pose_error(T_guess, result)
    if chosen is None and rival > settings.worse_risk_max:
        covariance, error = np.diag(sds**2), result
    # About the value that is given, where that is not the mean.
    beside = error - result
    covariance = covariance + np.outer(beside, beside)
    finest = view.levels[-1]
    offsets, profile = _profile(finest, T_result, covariance)
    estimate = ExtrinsicsEstimate(
        T_camera_lidar=T_result.copy(),
        covariance=covariance,
        method=METHOD,
        verdict=_verdict(view, T_guess, chosen, reason, basin),
        improved=chosen is not None,
        T_guess=T_guess.copy(),
        basin=basin,
        notes=tuple(notes),
    )
    return GuessRefinement(
        estimate=estimate,
        T_best=apply_pose_error(T_guess, error),
        distance_before=finest.distances(T_guess),
        distance_after=finest.distances(T_result),
        information_before=float(finest.information(T_guess).sum()),
        information_after=float(finest.information(T_result).sum()),
        held_out_gain=gains,
        risk={} if chosen is None else chosen.risk,
        starts=settings.starts,
        profile_offsets=offsets,
        profile=profile,
        evidence=finest,
    )


class _Steps:
    """Progress of searches, of which each reports every level."""

    def __init__(self, progress: Progress, total: int) -> None:
        self.what = ""
        self._progress = progress
        self._done = 0
        self._total = total

    def __call__(self) -> None:
        self._done = min(self._done + 1, self._total)
        self._progress(self._done, self._total, self.what)


def _starts(sds: FloatArray, settings: GuessRefinementSettings) -> list[FloatArray]:
    """The guess, and places drawn from its prior."""
    drawn = np.random.default_rng(settings.seed).normal(size=(settings.starts - 1, 6))
    return [np.zeros(6), *(drawn * sds)]


def _parts() -> list[BoolArray]:
    """Which blocks belong to each part: one above and one below, half the image's width apart."""
    columns, rows = BLOCKS
    number = np.arange(columns * rows)
    part = (number % columns + number // columns * (columns // rows)) % columns
    return [part == one for one in range(columns)]


def _search_without(
    posterior: PosePosterior,
    view: SceneView,
    part: BoolArray,
    half_way: FloatArray,
    whole: FloatArray,
    steps: _Steps,
) -> FloatArray:
    """The result of the other parts: found from where the whole's search was half-way, far enough
    to forget what this part had to do with it, or near the whole's if they like that more."""
    levels = [level.chosen(~part) for level in view.levels[-_LEVELS_WITHOUT:]]
    bases = view.bases[-_LEVELS_WITHOUT:]
    found = (
        search_pose(posterior, levels, bases, half_way, report=steps),
        search_pose(posterior, levels[-1:], bases[-1:], whole),
    )
    return min(found, key=lambda error: posterior.cost(error, levels[-1]))


def _shape(
    view: SceneView, T_guess: FloatArray, error: FloatArray, settings: GuessRefinementSettings
) -> EvidenceShape:
    return evidence_shape(
        view.levels[-1],
        T_guess,
        error,
        view.bases[-1],
        blocks=BLOCKS[0] * BLOCKS[1],
        seed=settings.seed,
    )


def _notes(
    view: SceneView, covariance: FloatArray, sds: FloatArray, chosen: Candidate | None
) -> list[str]:
    notes = []
    weak = [
        name
        for name, variance, sd in zip(POSE_PARAMETERS, np.diag(covariance), sds, strict=True)
        if np.sqrt(variance) > 0.5 * sd
    ]
    if weak:
        notes.append(
            f"The image says little of {', '.join(weak)}: less than half of the guess's standard "
            "deviation is taken away."
        )
    if chosen is not None and chosen.note:
        notes.append(chosen.note)
    return notes


def _profile(
    level: EvidenceLevel, T_camera_lidar: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(6, steps) errors of each parameter, and the evidence at each."""
    offsets = np.sqrt(np.diag(covariance))[:, np.newaxis] * _PROFILE_STEPS
    nats = np.array(
        [
            [
                level.information(apply_pose_error(T_camera_lidar, offset * axis)).sum()
                for offset in row
            ]
            for row, axis in zip(offsets, np.eye(6), strict=True)
        ]
    )
    return offsets, nats


def _verdict(
    view: SceneView,
    T_guess: FloatArray,
    chosen: Candidate | None,
    reason: str,
    basin: float,
) -> str:
    if chosen is None:
        return f"The guess is kept: {reason}."
    rotation_deg = np.degrees(np.linalg.norm(chosen.error[:3]))
    translation_cm = 100.0 * np.linalg.norm(chosen.error[3:])
    return (
        f"Better than the guess in parts of the image that were held out: turned by "
        f"{rotation_deg:.2f}° and moved by {translation_cm:.1f} cm; {basin:.0%} of the searches "
        f"agree."
    )
