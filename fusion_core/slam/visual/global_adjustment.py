"""Bundle adjustment of the whole map, by gtsam's sparse solver.

The same cost as that of the local map; but the system of hundreds of keyframes is sparse, and the
time of a dense one would grow with the cube of their number.
"""

from typing import TYPE_CHECKING

import numpy as np

from fusion_core.model.conventions import BoolArray, FloatArray
from fusion_core.model.geometry import invert_transform, transform_points
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.bundle_adjustment import BundleProblem, BundleResult
from fusion_core.slam.visual.observation_noise import (
    CHI2_DEPTH,
    CHI2_PIXEL,
    CHI2_POSE,
    ObservationNoise,
)
from fusion_core.slam.visual.pinhole import camera_parameters
from fusion_core.slam.visual.visual_map import VisualMap

if TYPE_CHECKING:
    import gtsam

# A depth is given as the disparity to a second camera at this distance. Any serves: it drops out.
_BASELINE_M = 1.0
_ANCHOR_SIGMA = 1e-6
_DEPTH_MIN_M = 0.05
# Relative decrease of the cost at which the optimisation ends; set by hand.
_TOLERANCE = 1e-4


class GlobalAdjustmentSettings(StageSettings):
    """Bundle adjustment of all keyframes and landmarks."""

    is_used: bool = setting(True, "Adjust the whole map after loops are closed")
    iterations: int = setting(10, "Most iterations", ge=1, le=1000)
    sightings_min: int = setting(
        2, "Fewest keyframes that see a landmark", unit="keyframes", ge=2, le=100
    )


def adjust_globally(
    visual_map: VisualMap,
    intrinsics: CameraIntrinsics,
    noise: ObservationNoise,
    settings: GlobalAdjustmentSettings,
) -> BundleResult | None:
    """Adjust the kept keyframes and the landmarks that several of them see, and write them to the
    map; None where there is nothing to adjust. A landmark that one keyframe sees moves with it.

    The first keyframe stays. Sightings that do not fit are taken from the map.
    """
    observations = visual_map.observations()
    kept = np.array([keyframe.index for keyframe in visual_map.kept_keyframes], dtype=np.int64)
    counts = np.bincount(observations.landmarks, minlength=len(visual_map.positions_in_map_m))
    rows = np.flatnonzero(counts[observations.landmarks] >= settings.sightings_min)
    landmarks = np.unique(observations.landmarks[rows])
    if landmarks.size == 0 or kept.size < 2:
        return None
    T_before = np.array([visual_map.keyframes[index].T_map_camera for index in kept])
    problem = BundleProblem(
        T_camera_map=np.array([invert_transform(T) for T in T_before]),
        is_fixed=np.arange(kept.size) == 0,
        points_in_map_m=visual_map.positions_in_map_m[landmarks].copy(),
        keyframes=np.searchsorted(kept, observations.keyframes[rows]),
        landmarks=np.searchsorted(landmarks, observations.landmarks[rows]),
        pixels=observations.pixels[rows],
        depths_m=observations.depths_m[rows],
        pixel_sigmas=noise.pixel_sigmas(observations.octaves[rows]),
        camera=camera_parameters(intrinsics),
        depth_sigma_per_m2=noise.depth_sigma_per_m2,
        alignments=visual_map.alignments_between(kept),
    )
    result = adjust_sparse(problem, settings.iterations)
    for index, T_camera_map in zip(kept.tolist(), result.T_camera_map, strict=True):
        visual_map.keyframes[index].T_map_camera = invert_transform(T_camera_map)
    visual_map.positions_in_map_m[landmarks] = result.points_in_map_m
    is_alone = counts[observations.landmarks] == 1
    for row, index in enumerate(kept.tolist()):
        alone = observations.landmarks[is_alone & (observations.keyframes == index)]
        T_after_before = visual_map.keyframes[index].T_map_camera @ invert_transform(T_before[row])
        visual_map.positions_in_map_m[alone] = transform_points(
            T_after_before, visual_map.positions_in_map_m[alone]
        )
        is_bad = ~result.is_inlier & (observations.keyframes[rows] == index)
        visual_map.forget(index, observations.features[rows][is_bad])
    return result


def adjust_sparse(problem: BundleProblem, iterations: int) -> BundleResult:
    """Adjust the free keyframes and all landmarks of a problem of any size."""
    import gtsam

    fx, fy, cx, cy = problem.camera.tolist()
    calibration = gtsam.Cal3_S2Stereo(fx, fy, 0.0, cx, cy, _BASELINE_M)
    plain_calibration = gtsam.Cal3_S2(fx, fy, 0.0, cx, cy)
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    keyframe_count = len(problem.T_camera_map)
    anchor = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
    for index, T_camera_map in enumerate(problem.T_camera_map):
        pose = gtsam.Pose3(invert_transform(T_camera_map))
        values.insert(index, pose)
        if problem.is_fixed[index]:
            graph.add(gtsam.PriorFactorPose3(index, pose, anchor))
    for landmark, point in enumerate(problem.points_in_map_m):
        values.insert(keyframe_count + landmark, point)
    has_depth = np.isfinite(problem.depths_m)
    disparities_px = fx * _BASELINE_M / np.where(has_depth, problem.depths_m, 1.0)
    stereo_noises: dict[float, gtsam.noiseModel.Base] = {}
    plain_noises: dict[float, gtsam.noiseModel.Base] = {}
    disparity_variance = (fx * _BASELINE_M * problem.depth_sigma_per_m2) ** 2
    chi2_before = observation_chi2(problem, problem.T_camera_map, problem.points_in_map_m)
    limits = np.where(has_depth, CHI2_DEPTH, CHI2_PIXEL)
    for row in np.flatnonzero(np.isfinite(chi2_before)).tolist():
        sigma = float(problem.pixel_sigmas[row])
        keyframe = int(problem.keyframes[row])
        landmark = keyframe_count + int(problem.landmarks[row])
        u, v = problem.pixels[row].tolist()
        factor: gtsam.NonlinearFactor
        if has_depth[row]:
            if sigma not in stereo_noises:
                # Of u, of the second camera's u, and of v.
                covariance = sigma**2 * np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1]])
                covariance[1, 1] += disparity_variance
                stereo_noises[sigma] = _robust(gtsam.noiseModel.Gaussian.Covariance(covariance), 3)
            measured = gtsam.StereoPoint2(u, u - disparities_px[row], v)
            factor = gtsam.GenericStereoFactor3D(
                measured, stereo_noises[sigma], keyframe, landmark, calibration
            )
        else:
            if sigma not in plain_noises:
                plain_noises[sigma] = _robust(gtsam.noiseModel.Isotropic.Sigma(2, sigma), 2)
            factor = gtsam.GenericProjectionFactorCal3_S2(
                problem.pixels[row], plain_noises[sigma], keyframe, landmark, plain_calibration
            )
        graph.add(factor)
    for alignment in problem.alignments:
        # gtsam's error is in the frame of the second of its keys, as the information is.
        graph.add(
            gtsam.BetweenFactorPose3(
                alignment.first,
                alignment.second,
                gtsam.Pose3(invert_transform(alignment.T_second_first)),
                _robust(gtsam.noiseModel.Gaussian.Information(alignment.information), 6),
            )
        )
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(_TOLERANCE)
    parameters.setMaxIterations(iterations)
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
    before = float(graph.error(values))
    best = optimiser.optimize()
    T_camera_map = np.array(
        [invert_transform(best.atPose3(index).matrix()) for index in range(keyframe_count)]
    )
    points = np.array(
        [best.atPoint3(keyframe_count + row) for row in range(len(problem.points_in_map_m))]
    )
    is_inlier: BoolArray = observation_chi2(problem, T_camera_map, points) <= limits
    return BundleResult(
        T_camera_map=T_camera_map,
        points_in_map_m=points,
        is_inlier=is_inlier,
        cost=(before, float(graph.error(best))),
    )


def observation_chi2(
    problem: BundleProblem, T_camera_map: FloatArray, points_in_map_m: FloatArray
) -> FloatArray:
    """(O,) squared, normalised errors; infinite behind the camera."""
    T = T_camera_map[problem.keyframes]
    points = points_in_map_m[problem.landmarks]
    x, y, z = (np.einsum("oij,oj->oi", T[:, :3, :3], points) + T[:, :3, 3]).T
    is_ahead = z > _DEPTH_MIN_M
    z = np.where(is_ahead, z, 1.0)
    fx, fy, cx, cy = problem.camera
    off_u = (fx * x / z + cx - problem.pixels[:, 0]) / problem.pixel_sigmas
    off_v = (fy * y / z + cy - problem.pixels[:, 1]) / problem.pixel_sigmas
    off_depth = np.nan_to_num((1.0 / z - 1.0 / problem.depths_m) / problem.depth_sigma_per_m2)
    return np.where(is_ahead, off_u**2 + off_v**2 + off_depth**2, np.inf)


def _robust(noise: "gtsam.noiseModel.Base", degrees: int) -> "gtsam.noiseModel.Base":
    import gtsam

    limit = {2: CHI2_PIXEL, 3: CHI2_DEPTH, 6: CHI2_POSE}[degrees]
    return gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(float(np.sqrt(limit))), noise
    )
