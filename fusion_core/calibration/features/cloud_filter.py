"""The points of a cloud that an intensity image is made of (Song 2022 §2.2.1, Fig. 4)."""

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.sensors import PointCloud
from fusion_core.registration.radius_filter import has_neighbours
from fusion_core.settings import StageSettings, setting

# Fewer points than this show nothing.
_POINTS_MIN = 1000
# No LiDAR measures farther: such lengths are in millimetres.
_RANGE_MAX_M = 1000.0
# Nor does a room or a street lie nearer than this as a whole.
_MEDIAN_RANGE_MIN_M = 0.1


class CloudFilterSettings(StageSettings):
    """Settings of ``usable_points``."""

    range_min_m: float = setting(
        0.3, "Nearer points are the sensor's own mount", unit="m", ge=0.0, le=100.0
    )
    range_max_m: float = setting(200.0, "Farther points are left out", unit="m", ge=1.0, le=1000.0)
    radius_m: float = setting(
        0.02, "Radius filter: least radius d of the ball around a point", unit="m", ge=1e-3, le=5.0
    )
    radius_rad: float = setting(
        0.015,
        "Radius filter: the ball's radius in the distance of the point, where that is more",
        unit="rad",
        ge=0.0,
        le=0.2,
    )
    neighbours_min: int = setting(
        1, "Radius filter: fewest other points in the ball; 0: no filter", ge=0, le=100
    )


PUBLISHED = CloudFilterSettings(radius_m=0.05, radius_rad=0.0, neighbours_min=3)
"""The paper names neither its radius nor its number of points: these are ours."""


def usable_points(
    cloud: PointCloud, settings: CloudFilterSettings
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) points and (N,) intensities, finite and within range.

    Raises CalibrationFailed for a cloud without intensities, or with one intensity throughout, for
    one whose lengths are no metres, and where too few points are left.
    """
    if cloud.intensity is None:
        raise CalibrationFailed(
            "the cloud has no intensities.",
            advice="The intensity image is made of them: record the field, often called intensity "
            "or reflectivity.",
        )
    xyz_m = cloud.xyz_m.astype(np.float64)
    intensity = cloud.intensity.astype(np.float64)
    range_m = np.linalg.norm(xyz_m, axis=1)
    finite = np.isfinite(range_m) & np.isfinite(intensity) & (range_m > 0.0)
    if np.count_nonzero(finite) < _POINTS_MIN:
        raise CalibrationFailed(
            f"only {np.count_nonzero(finite)} of {len(xyz_m)} points are finite with a finite "
            f"intensity; at least {_POINTS_MIN} are needed."
        )
    middle_m = float(np.median(range_m[finite]))
    if not _MEDIAN_RANGE_MIN_M <= middle_m <= _RANGE_MAX_M:
        unit = "millimetres" if middle_m > _RANGE_MAX_M else "another unit"
        raise CalibrationFailed(
            f"half of the points are farther than {middle_m:g} m: the lengths seem to be in "
            f"{unit}.",
            advice="Give the cloud in metres.",
        )
    low, high = float(intensity[finite].min()), float(intensity[finite].max())
    if low == high:
        raise CalibrationFailed(
            f"all points have the intensity {low:g}.",
            advice="Record a LiDAR that measures intensity, and check that the field is not filled "
            "with a constant.",
        )
    kept = finite & (range_m >= settings.range_min_m) & (range_m <= settings.range_max_m)
    if np.count_nonzero(kept) < _POINTS_MIN:
        raise CalibrationFailed(
            f"only {np.count_nonzero(kept)} of {len(xyz_m)} points are left by the range limits.",
            advice="Check that the lengths are in metres, or change cloud.range_min_m and "
            "cloud.range_max_m.",
        )
    return xyz_m[kept], intensity[kept]


def is_no_outlier(points_m: FloatArray, settings: CloudFilterSettings) -> BoolArray:
    """(N,) which of (N, 3) points pass the radius filter (Fig. 4), whose radius grows with the
    distance by steps of two."""
    kept = np.zeros(len(points_m), dtype=np.bool_)
    if settings.neighbours_min == 0 or not len(points_m):
        return np.ones(len(points_m), dtype=np.bool_)
    range_m = np.linalg.norm(points_m, axis=1)
    radius_m = np.maximum(settings.radius_m, settings.radius_rad * range_m)
    octave = np.floor(np.log2(radius_m / settings.radius_m)).astype(np.int64)
    for step in np.unique(octave):
        here = octave == step
        # What lies within a radius is at most one step nearer or farther.
        around = np.abs(octave - step) <= 1
        cloud_m = points_m[around]
        kept[here] = has_neighbours(
            cloud_m if (here == around).all() else points_m[here],
            cloud_m,
            settings.radius_m * 2.0 ** float(step),
            settings.neighbours_min,
        )
    return kept
