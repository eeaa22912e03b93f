"""When an image becomes a keyframe (ORB-SLAM2, Mur-Artal & Tardos 2017, §III-E)."""

import numpy as np

from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.keyframes import NO_LANDMARK
from fusion_core.slam.visual.tracked_frame import TrackedFrame


class KeyframePolicy(StageSettings):
    """Settings of ``wants_keyframe``."""

    tracked_ratio_min: float = setting(
        0.75,
        "Ratio of the landmarks in sight to the most since the last keyframe, below which a "
        "keyframe is made",
        ge=0.0,
        le=1.0,
    )
    close_tracked_min: int = setting(
        100,
        "Landmarks with depth in sight, below which a keyframe is made if it adds as many",
        unit="landmarks",
        ge=0,
        le=10_000,
    )
    close_new_min: int = setting(
        70, "New points that such a keyframe must add", unit="landmarks", ge=0, le=10_000
    )
    images_max: int = setting(
        30, "Images after which a keyframe is made in any case", unit="images", ge=1, le=100_000
    )


def wants_keyframe(
    tracked: TrackedFrame, most_in_sight: int, since_keyframe: int, policy: KeyframePolicy
) -> bool:
    """Whether the image, ``since_keyframe`` images after the last keyframe, becomes one.

    ``most_in_sight``: the most landmarks that any image has seen since.
    """
    has_landmark = tracked.landmarks != NO_LANDMARK
    has_depth = np.isfinite(tracked.features.depths_m)
    close_tracked = int(np.count_nonzero(has_landmark & has_depth))
    close_new = int(np.count_nonzero(~has_landmark & has_depth))
    lacks_close = close_tracked < policy.close_tracked_min and close_new > policy.close_new_min
    is_behind = tracked.in_sight < policy.tracked_ratio_min * most_in_sight
    return lacks_close or is_behind or since_keyframe >= policy.images_max
