"""What the Calibrate step shows of a view: the LiDAR's curve in the image, now and before."""

from dataclasses import dataclass

from fusion_core.model.rig import Mount
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.curve_in_image import (
    CurveAgreement,
    CurveInImage,
    SeenScan,
    curve_agreement,
    curve_in_image,
    seen_scan,
)
from fusion_core.workflows.fuse.moved_rig import camera_pose_of
from fusion_core.workflows.fuse.pairing import PairedImage
from scanloom.state.hand_pose import HandPose


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseView:
    """A pose of the camera, the frame's curve by it, and its agreement over some frames. ``curve``
    is None for a frame without a scan."""

    pose: HandPose
    curve: CurveInImage | None
    agreement: CurveAgreement


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationView:
    """``before``: the pose without a person's; None where there is no other."""

    now: PoseView
    before: PoseView | None


def pose_view(chain: CachedChain, paired: PairedImage, sampled: tuple[SeenScan, ...]) -> PoseView:
    """A chain's pose, in a frame and over ``sampled`` ones."""
    shown = seen_scan(chain.session, paired)
    return PoseView(
        pose=pose_of(chain),
        curve=None if shown is None else _curve(chain, shown),
        agreement=curve_agreement(_curve(chain, seen) for seen in sampled),
    )


def pose_of(chain: CachedChain, mount: Mount | None = None) -> HandPose:
    """The pose of the first camera by the chain's mount, or by another."""
    rig = chain.session.rig
    return HandPose.of_transform(camera_pose_of(rig, mount or chain.alignment.mount))


def _curve(chain: CachedChain, seen: SeenScan) -> CurveInImage:
    session = chain.session
    return curve_in_image(
        seen, session.rig.cameras[seen.camera], chain.alignment.mount, session.settings.mount
    )
