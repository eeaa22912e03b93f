"""Whether a pose by walls and floor is better than the guess, from how far it is found, and the
words for it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.planar.natural_settings import NaturalSettings
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.extrinsics import (
    POSE_PARAMETER_WORDS,
    POSE_PARAMETERS,
    ExtrinsicsEstimate,
    parameters_in_words,
)
from fusion_core.model.progress import Progress
from fusion_core.workflows.calibrate.natural_fit import PoseFit, UprightImages

_METHOD = "walls and floor that both see (natural scene), Gauss-Newton on their distances"
# An optimum this near is the same, as are the bars of a good result: 0.3 deg and 3 cm.
_SAME_RAD, _SAME_M = float(np.deg2rad(0.3)), 0.03
# A gain of so many standard errors over the guess is one.
_GAIN_SE = 2.0
_MS_PER_S = 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutFrames:
    """``gains``: (K,) by how much less each held-out block costs than under the guess, empty
    without one. ``residual_rms_m``: of the held-out blocks."""

    gains: FloatArray
    residual_rms_m: float

    @property
    def is_better(self) -> bool:
        """Whether the gain is more than chance."""
        error = np.std(self.gains, ddof=1) / np.sqrt(self.gains.size)
        return bool(np.mean(self.gains) > _GAIN_SE * error)


def _hold_out(
    found: PoseFit, view: UprightImages, settings: NaturalSettings, progress: Progress
) -> HeldOutFrames:
    """Each block of frames under the pose that the others give, and under the guess."""
    problem = found.problem
    blocks = np.array_split(np.arange(problem.frames), settings.held_out_blocks)
    gains, squares = [], []
    for number, block in enumerate(blocks, start=1):
        progress(number, len(blocks), "checking on held-out frames")
        used = np.ones(problem.frames, dtype=bool)
        used[block] = False
        try:
            fit = problem.fit(
                found.fit.T_camera_lidar, found.priors, used=used, with_covariance=False
            )
        except CalibrationFailed:
            # Nearly all that is seen is in this block.
            continue
        own = problem.evaluate(fit, fit.T_camera_lidar, block)
        if np.isfinite(own.residual_rms_m):
            squares.append(own.residual_rms_m**2)
        if view.T_guess is not None:
            guess = problem.evaluate(fit, view.T_guess, block)
            if np.isfinite(own.mean):
                gains.append((guess.mean if np.isfinite(guess.mean) else 1.0) - own.mean)
    rms_m = float(np.sqrt(np.mean(squares))) if squares else np.nan
    return HeldOutFrames(gains=np.array(gains), residual_rms_m=rms_m)


def _try_basin(found: PoseFit, settings: NaturalSettings, progress: Progress) -> float | None:
    """Fraction of disturbed starts that come back; the height counts where it is observable."""
    if settings.basin_starts == 0:
        return None
    rng = np.random.default_rng(settings.seed)
    T = found.fit.T_camera_lidar
    back = 0
    for number in range(settings.basin_starts):
        progress(number + 1, settings.basin_starts, "trying disturbed starts")
        directions = rng.normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        sizes = [np.deg2rad(settings.basin_angle_deg), settings.basin_place_m]
        start = apply_pose_error(T, (directions * np.array(sizes)[:, np.newaxis]).ravel())
        try:
            fit = found.coarse.fit(start, found.priors, with_covariance=False)
        except CalibrationFailed:
            continue
        off = pose_error(T, fit.T_camera_lidar)
        in_lidar = T[:3, :3].T @ off[3:]
        back += bool(
            np.linalg.norm(off[:3]) < _SAME_RAD and np.hypot(in_lidar[0], in_lidar[1]) < _SAME_M
        )
    return back / settings.basin_starts


def judge_fit(
    found: PoseFit, view: UprightImages, settings: NaturalSettings, progress: Progress
) -> ExtrinsicsEstimate:
    """The fit as a result, or the guess where frames that were held out do not prefer the fit."""
    held_out = _hold_out(found, view, settings, progress)
    basin = _try_basin(found, settings, progress)
    T_view, covariance = found.fit.T_camera_lidar, found.covariance
    improved = view.T_guess is None or (held_out.gains.size > 1 and held_out.is_better)
    if not improved:
        assert view.T_guess is not None, "without one there is nothing to keep"
        # The guess is off by what the fit is off, and by how far it lies from the fit.
        apart = pose_error(T_view, view.T_guess)
        T_view, covariance = view.T_guess, covariance + np.outer(apart, apart)
    covariance = view.stored_covariance(covariance)
    greatest = np.repeat([np.deg2rad(settings.observable_sd_deg), settings.observable_sd_m], 3)
    # How far the guess lies off does not say what the recording shows.
    sd = np.sqrt(np.diag(view.stored_covariance(found.covariance)))
    is_unseen = sd > greatest
    unobservable = tuple(
        name for name, unseen in zip(POSE_PARAMETERS, is_unseen, strict=True) if unseen
    )
    covariance[is_unseen, :] = np.nan
    covariance[:, is_unseen] = np.nan
    return ExtrinsicsEstimate(
        T_camera_lidar=view.stored_pose(T_view),
        covariance=covariance,
        method=_METHOD,
        verdict=_verdict(found, view, held_out, improved, unobservable),
        improved=improved,
        T_guess=None if view.T_guess is None else view.stored_pose(view.T_guess),
        basin=basin,
        unobservable=unobservable,
        notes=tuple(_notes(found, settings, held_out, sd, unobservable)),
    )


def _verdict(
    found: PoseFit,
    view: UprightImages,
    held_out: HeldOutFrames,
    improved: bool,
    unobservable: tuple[str, ...],
) -> str:
    fit = found.fit
    text = (
        f"{fit.agreement:.0%} of the surfaces on the scans' lines agree, within "
        f"{100.0 * fit.residual_rms_m:.1f} cm along the ray."
    )
    if view.T_guess is not None:
        off = pose_error(fit.T_camera_lidar, view.T_guess)
        apart = (
            f"{np.rad2deg(np.linalg.norm(off[:3])):.2f} deg and "
            f"{100.0 * np.linalg.norm(off[3:]):.1f} cm from the guess"
        )
        if improved:
            text += f" The result lies {apart}, and is better on frames that were held out."
        else:
            text += (
                f" The guess is kept: the result, {apart}, is not better on frames that were held "
                "out."
            )
    if unobservable:
        text += f" Not observable: {parameters_in_words(unobservable)}."
    return text


def _notes(
    found: PoseFit,
    settings: NaturalSettings,
    held_out: HeldOutFrames,
    sd: FloatArray,
    unobservable: tuple[str, ...],
) -> Iterator[str]:
    fit = found.fit
    yield (
        f"{fit.wall_patches} patches of walls and {fit.floor_patches} of the floor in "
        f"{found.problem.frames} images."
    )
    yield (
        "There are no pairs of pixels: the residual is that of depths along their rays, "
        f"{100.0 * held_out.residual_rms_m:.2f} cm (rms) on held-out frames and "
        f"{100.0 * fit.residual_rms_m:.2f} cm on the used ones."
    )
    tilt = "the floor and upright walls" if fit.floor_patches else "upright walls, no floor,"
    yield (
        f"Tilt and roll are against {tilt}: they are the LiDAR's as far as it sweeps level (within "
        f"{settings.lidar_level_sd_deg:g} deg)."
    )
    for name in unobservable:
        deviation = dict(zip(POSE_PARAMETERS, sd, strict=True))[name]
        shown = f"{np.rad2deg(deviation):.2f} deg" if name.endswith("rad") else f"{deviation:.3f} m"
        yield (
            f"Not observable: {POSE_PARAMETER_WORDS[name]}, known to {shown} (one standard "
            "deviation)."
        )
    if settings.lidar_height_m is None and any(name.endswith("_m") for name in unobservable):
        yield (
            "Walls do not show how high the LiDAR's plane is: measure its height above the floor "
            "(lidar_height_m), and the height between the sensors becomes observable."
        )
    yield (
        f"Depths are {100.0 * fit.stretch:+.2f} % too long, and the camera's stamps "
        f"{_MS_PER_S * fit.clock_s:+.1f} ms late; both are taken out."
    )


def keep_guess(T_guess: FloatArray, problem: str) -> ExtrinsicsEstimate:
    """The guess where the recording determines no pose: ``problem`` says why."""
    return ExtrinsicsEstimate(
        T_camera_lidar=T_guess,
        covariance=np.full((6, 6), np.nan),
        method=_METHOD,
        verdict=f"The guess is kept: {problem}",
        improved=False,
        T_guess=T_guess.copy(),
        unobservable=POSE_PARAMETERS,
    )
