"""The result of an adjustment by hand, as any other calibration's."""

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate
from fusion_core.workflows.fuse.curve_in_image import CurveAgreement

METHOD = "by hand"


def estimate_by_hand(
    T_camera_lidar: FloatArray,
    agreement: CurveAgreement,
    T_before: FloatArray | None = None,
    agreement_before: CurveAgreement | None = None,
) -> ExtrinsicsEstimate:
    """A pose (4, 4) that a person has set, with what it does to the agreement of the sensors.

    Nothing tells how sure a hand is: no parameter has a deviation. ``T_before``: the pose before.
    """
    before, improved = "", True
    if agreement_before is not None and agreement_before.on_depth:
        before = f", {agreement_before.fraction:.1%} before"
        improved = agreement.fraction > agreement_before.fraction
    agreeing = "no point lies on the depth of an image"
    if agreement.on_depth:
        agreeing = (
            f"{agreement.fraction:.1%} of the LiDAR's points in {agreement.frames} images lie on "
            f"what the camera sees{before}"
        )
    return ExtrinsicsEstimate(
        T_camera_lidar=T_camera_lidar,
        covariance=np.full((6, 6), np.nan),
        method=METHOD,
        verdict=f"Set by hand: {agreeing}.",
        improved=improved,
        T_guess=T_before,
        unobservable=POSE_PARAMETERS,
        notes=("No deviations are known of a pose that is set by hand.",),
    )
