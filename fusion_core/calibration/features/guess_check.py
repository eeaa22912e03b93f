"""A result is taken only where it is better than the initial guess on pairs that were held out."""

from dataclasses import replace

import numpy as np

from fusion_core.calibration.features.pose_fit import reprojection_residuals
from fusion_core.calibration.features.reprojection import image_blocks
from fusion_core.calibration.reprojection_rms import reprojection_rms
from fusion_core.model.conventions import FloatArray
from fusion_core.model.extrinsics import ExtrinsicsEstimate
from fusion_core.model.sensors import CameraIntrinsics

# Standard errors of the difference: about 98 % one-sided.
_SURE = 2.0


def keep_better(
    estimate: ExtrinsicsEstimate,
    T_guess: FloatArray,
    points_m: FloatArray,
    pixels: FloatArray,
    held_out_px: FloatArray,
    intrinsics: CameraIntrinsics,
) -> ExtrinsicsEstimate:
    """The estimate, or the guess where the estimate is not clearly better than it.

    ``held_out_px``: (N, 2) residuals of the N pairs by estimates that have not seen them, NaN where
    there is none. Each part of the image has one vote, its mean square error by either pose; the
    difference must be two standard errors above zero.
    """
    judged = np.isfinite(held_out_px).all(axis=1)
    by_guess_px = reprojection_residuals(T_guess, points_m[judged], pixels[judged], intrinsics)
    gain = (by_guess_px**2).sum(axis=1) - (held_out_px[judged] ** 2).sum(axis=1)
    blocks = image_blocks(pixels[judged], intrinsics)
    means = np.array([gain[blocks == block].mean() for block in np.unique(blocks)])
    error = means.std(ddof=1) / np.sqrt(means.size) if means.size > 1 else np.inf
    guess_rms = reprojection_rms(by_guess_px)
    own_rms = reprojection_rms(held_out_px[judged])
    compared = (
        f"on pairs that were held out the result has {own_rms:.2f} px, the guess {guess_rms:.2f} px"
    )
    if means.mean() > _SURE * error:
        return replace(
            estimate,
            T_guess=T_guess.copy(),
            verdict=f"{estimate.verdict} It replaces the guess: {compared}.",
        )
    return replace(
        estimate,
        T_camera_lidar=T_guess.copy(),
        T_guess=T_guess.copy(),
        improved=False,
        reprojection_rms_px=guess_rms,
        verdict=f"The guess is kept: {compared}, which is no clear improvement.",
    )
