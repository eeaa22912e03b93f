"""The result of a calibration: where a LiDAR is in a camera's frame, and how sure that is."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, read_only

POSE_PARAMETERS = (
    "rotation_x_rad",
    "rotation_y_rad",
    "rotation_z_rad",
    "x_m",
    "y_m",
    "z_m",
)
"""The order of a pose's errors, all along the axes of the camera's optical frame: with the truth
R, t and the estimate R̂, t̂ they are δ = (Log(R R̂ᵀ), t - t̂)."""

POSE_PARAMETER_WORDS = {
    "rotation_x_rad": "pitch (about the camera's right)",
    "rotation_y_rad": "yaw (about its down)",
    "rotation_z_rad": "roll (about its line of sight)",
    "x_m": "place to the camera's right",
    "y_m": "place below the camera",
    "z_m": "place ahead of the camera",
}
"""What people read for POSE_PARAMETERS."""


def parameters_in_words(names: Iterable[str]) -> str:
    """Some of POSE_PARAMETERS as part of a sentence."""
    return ", ".join(POSE_PARAMETER_WORDS[name] for name in names)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExtrinsicsEstimate:
    """A LiDAR's pose in the optical frame of a camera, as its images are stored.

    ``T_camera_lidar``: (4, 4). ``covariance``: (6, 6) of POSE_PARAMETERS, NaN in the row and column
    of each of ``unobservable``, whose values are the guess's or, without one, assumed.
    ``reprojection_rms_px``: Song's (18) over pairs that the estimate has not seen,
    ``reprojection_rms_used_px`` over those that it has; None where the method has no pairs.
    ``basin``: fraction of disturbed starts that come back, None where it was not tried.
    ``T_guess``: (4, 4) the initial guess, None without one. ``improved``: whether the result is
    better than the guess by evidence that was held out; where it is not, ``T_camera_lidar`` is the
    guess. ``verdict``: a sentence or two for people. ``method``: how it was found.
    """

    T_camera_lidar: FloatArray
    covariance: FloatArray
    method: str
    verdict: str
    improved: bool
    T_guess: FloatArray | None = None
    reprojection_rms_px: float | None = None
    reprojection_rms_used_px: float | None = None
    basin: float | None = None
    unobservable: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, array in (("T_camera_lidar", self.T_camera_lidar), ("T_guess", self.T_guess)):
            if array is not None:
                if array.shape != (4, 4) or not np.isfinite(array).all():
                    raise ValueError(f"{name} must be (4, 4) and finite, got {array.shape}")
                read_only(array)
        unknown = set(self.unobservable) - set(POSE_PARAMETERS)
        if unknown:
            raise ValueError(f"unobservable names no parameter of a pose: {sorted(unknown)}")
        if self.covariance.shape != (6, 6):
            raise ValueError(f"covariance must be (6, 6), got {self.covariance.shape}")
        known = np.array([name not in self.unobservable for name in POSE_PARAMETERS])
        if not np.array_equal(np.isfinite(self.covariance), np.outer(known, known)):
            raise ValueError("covariance must be NaN where unobservable, and finite elsewhere")
        read_only(self.covariance)

    @property
    def sd(self) -> tuple[float | None, ...]:
        """One standard deviation for each of POSE_PARAMETERS, None where it is unobservable."""
        return tuple(
            None if np.isnan(variance) else float(np.sqrt(variance))
            for variance in np.diag(self.covariance)
        )
