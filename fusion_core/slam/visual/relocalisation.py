"""Relocalisation: where in the map a camera is that has lost its way."""

from dataclasses import dataclass

from fusion_core.model.conventions import FloatArray, read_only
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.loop_candidates import group_candidates
from fusion_core.slam.visual.loop_gate import LostMotionSettings, distance_m, lost_reach_m
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.place_recognition import PlaceIndex
from fusion_core.slam.visual.relative_pose import (
    RelativePose,
    RelativePoseSettings,
    estimate_relative_pose,
)
from fusion_core.slam.visual.visual_map import VisualMap


class RelocalisationSettings(StageSettings):
    """Search of a lost camera in the map."""

    candidates_max: int = setting(5, "Groups of keyframes that are tried", ge=1, le=1000)
    score_ratio_min: float = setting(
        0.2, "Least score of a group as a part of the best one's", ge=0.0, le=1.0
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LastKnownPose:
    """``T_map_camera``: (4, 4), where the camera was seen last. ``lost_ns``: how long ago."""

    T_map_camera: FloatArray
    lost_ns: int

    def __post_init__(self) -> None:
        read_only(self.T_map_camera)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relocalisation:
    """``T_map_camera``: (4, 4), by ``keyframe`` and its features that agree, ``found``."""

    T_map_camera: FloatArray
    keyframe: int
    found: RelativePose

    def __post_init__(self) -> None:
        read_only(self.T_map_camera)


def relocalise(
    visual_map: VisualMap,
    index: PlaceIndex,
    features: FrameFeatures,
    intrinsics: CameraIntrinsics,
    noise: ObservationNoise,
    pose_settings: RelativePoseSettings,
    settings: RelocalisationSettings | None = None,
    *,
    last_known: LastKnownPose | None = None,
    lost_motion: LostMotionSettings | None = None,
) -> Relocalisation | str:
    """The pose of an image by the keyframe that agrees with most of its features, or why there is
    none.

    ``last_known``: keyframes that the camera cannot have reached since are left out. Without it,
    and in one of two places that look alike, the likelier one is taken.
    """
    settings = settings or RelocalisationSettings()
    lost_motion = lost_motion or LostMotionSettings()
    candidates = group_candidates(
        visual_map, index, features, set(), settings.candidates_max, settings.score_ratio_min
    )
    if not candidates:
        return "no keyframe looks like the image"
    best: Relocalisation | None = None
    reason = ""
    for candidate, _ in candidates:
        found = estimate_relative_pose(
            visual_map.keyframes[candidate].features, features, intrinsics, noise, pose_settings
        )
        if isinstance(found, str):
            reason = reason or f"keyframe {candidate}: {found}"
            continue
        T_map_camera = visual_map.pose_of(candidate) @ found.T_first_second
        if last_known is not None:
            away_m = distance_m(last_known.T_map_camera, T_map_camera)
            reach_m = lost_reach_m(last_known.lost_ns, lost_motion)
            if away_m > reach_m:
                reason = (
                    f"keyframe {candidate} has the camera move {away_m:.2f} m, more than the "
                    f"{reach_m:.2f} m that its time allows"
                )
                continue
        if best is None or len(found.matches) > len(best.found.matches):
            best = Relocalisation(T_map_camera=T_map_camera, keyframe=candidate, found=found)
    return reason if best is None else best
