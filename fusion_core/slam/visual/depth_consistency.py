"""Whether depth images agree with the motion that features say.

Features may follow something that moves with them in the image. The rest of the image then shows
surfaces where the image before saw through: that cannot be occlusion, only a wrong motion, or
something that has moved in between.
"""

import numpy as np

from fusion_core.compiled import compiled
from fusion_core.model.conventions import Float32Array, FloatArray
from fusion_core.model.geometry import invert_transform
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.depth_surface import DepthSurface, SurfaceSampler, find_block
from fusion_core.slam.visual.doubtful_stretches import PoseCheck
from fusion_core.slam.visual.local_map import LocalMap
from fusion_core.slam.visual.tracked_frame import TrackedFrame

# A block contradicts where it lies so many standard deviations before the other surface.
_GATE = 5.0


class DepthCheckSettings(StageSettings):
    """Settings of ``depth_check``."""

    check_images: int = setting(
        5, "Images from one comparison of depth with the motion to the next", ge=1, le=1000
    )
    contradicted_max: float = setting(
        0.1,
        "Part of a depth image in contradiction to the motion, above which a pose is doubtful",
        ge=0.0,
        le=1.0,
    )


def depth_check(
    intrinsics: CameraIntrinsics, settings: DepthCheckSettings, depth_sigma_per_m2: float
) -> PoseCheck:
    """Doubts poses that depth images contradict."""
    return PoseCheck(
        _DepthContradiction(intrinsics, depth_sigma_per_m2),
        check_images=settings.check_images,
        share_max=settings.contradicted_max,
        gap_images=0,
        says="of the depth image contradicts the motion: features may follow something that "
        "moves, or colour and depth differ in time",
    )


class _DepthContradiction:
    def __init__(self, intrinsics: CameraIntrinsics, depth_sigma_per_m2: float) -> None:
        self._sampler, self._sigma = SurfaceSampler(intrinsics), depth_sigma_per_m2
        self._reference: tuple[int, DepthSurface] | None = None

    def __call__(
        self, depth_m: Float32Array, tracked: TrackedFrame, local: LocalMap
    ) -> float | None:
        if local.reduced_depth_m is None:
            return None
        if self._reference is None or self._reference[0] != local.reference:
            self._reference = local.reference, self._sampler.surface(local.reduced_depth_m)
        return contradicted_share(
            self._sampler.surface(self._sampler.reduce(depth_m)),
            self._reference[1],
            invert_transform(local.T_map_reference) @ tracked.T_map_camera,
            self._sigma,
        )


def contradicted_share(
    first: DepthSurface, second: DepthSurface, T_second_first: FloatArray, depth_sigma_per_m2: float
) -> float:
    """Part of the blocks in sight of both images that lie before what the other saw, in either."""
    one = _counts(first.points_m, second, T_second_first, depth_sigma_per_m2)
    other = _counts(second.points_m, first, invert_transform(T_second_first), depth_sigma_per_m2)
    return sum(before / max(shared, 1) for shared, before in (one, other))


def _counts(
    points_m: FloatArray, target: DepthSurface, T_target_source: FloatArray, sigma_per_m2: float
) -> tuple[int, int]:
    """How many blocks both show, and how many of these lie before the target's surface."""
    shared, before = _count_before(
        points_m.reshape(-1, 3),
        target.points_m,
        target.normals,
        target.camera,
        np.ascontiguousarray(T_target_source),
        sigma_per_m2,
        _GATE,
    )
    return int(shared), int(before)


@compiled(nogil=True)
def _count_before(
    points: FloatArray,
    target_points: FloatArray,
    target_normals: FloatArray,
    camera: FloatArray,
    T: FloatArray,
    sigma_per_m2: float,
    gate: float,
) -> tuple[int, int]:
    height, width = target_points.shape[0], target_points.shape[1]
    p = np.zeros(3)
    shared, before = 0, 0
    for k in range(len(points)):
        if np.isnan(points[k, 2]):
            continue
        row, column = find_block(points, k, T, camera, height, width, p)
        if row < 0:
            continue
        n, q = target_normals[row, column], target_points[row, column]
        if np.isnan(n[0]):
            continue
        shared += 1
        off, slope = 0.0, 0.0
        for i in range(3):
            off += n[i] * (p[i] - q[i])
            slope += n[i] * q[i]
        # As ``align_depths``: a depth errs along its ray.
        sigma = sigma_per_m2 * abs(slope / q[2]) * np.sqrt(points[k, 2] ** 4 + q[2] ** 4)
        before += p[2] < q[2] and abs(off) > gate * sigma
    return shared, before
