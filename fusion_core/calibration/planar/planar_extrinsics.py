"""The pose of a LiDAR in a depth camera's frame from walls that both see, and from the floor.

Walls and furniture are upright: whatever its height, a depth patch of such a surface lies above or
below the line that the scan draws there, and its distance from that line, along the camera's ray,
is the residual. Patches at several heights show tilt and roll as well as the place in the LiDAR's
plane. The LiDAR sweeps parallel to the floor: patches of it lie at one height, which gives tilt and
roll once more. Neither shows the height of the LiDAR's plane: only a prior does.

Gauss-Newton, reweighted by Welsch's loss, over the pose's six degrees and what would bias them: by
which fraction the depths are too long, how late the camera's clock is, and the floor's height. What
stands before or behind a scan's line at other heights is always on one side, and would tilt a pose
until much of it fits: the tilt that the surfaces' directions show is held until the place in the
LiDAR's plane is found.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.calibration.planar.level_start import turn_level
from fusion_core.calibration.planar.patch_noise import PatchNoise
from fusion_core.calibration.planar.planar_frames import FlatFrames, ScanWithPatches
from fusion_core.calibration.planar.planar_residuals import (
    CLOCK,
    FLOOR,
    POSE,
    STRETCH,
    UNKNOWNS,
    PlanarState,
    SurfaceResiduals,
    find_floor_m,
    surface_residuals,
)
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.robust import welsch_weight
from fusion_core.model.two_way_covariance import frame_blocks, two_way_covariance
from fusion_core.patches.up_direction import find_up

# So long the place in the LiDAR's plane moves alone; then so long the noise is learned as well.
_IN_PLANE_ITERATIONS = 5
_NOISE_ITERATIONS = 4
# By the deviations of independent patches, which are far smaller than those of the pose.
_LAST_STEP_SD = 0.1
# Patches with less of their weight left are of something else.
_AGREEING = 0.05
# Information that no data moves.
_HELD = 1e15
# Fewer patches on lines show nothing.
_MIN_PATCHES = 200


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarPriors:
    """What is held before the data.

    ``up_m``, ``up_sd_m``: the camera's height above the LiDAR's plane. ``angle_sd_rad``,
    ``place_sd_m``: of the pose that the fit starts from, wide. ``stretch_sd``: of the fraction by
    which depths are too long, ``range_sd_m``: of how much too short all ranges are, which is not
    estimated but counted in. ``clock_s``, ``clock_sd_s``: the camera's stamps are late by.
    ``lidar_height_m``: of the LiDAR above the floor, None where it is not known.
    """

    up_m: float
    up_sd_m: float
    angle_sd_rad: float
    place_sd_m: float
    stretch_sd: float
    range_sd_m: float
    clock_s: float
    clock_sd_s: float
    lidar_height_m: float | None = None
    lidar_height_sd_m: float = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanarFit:
    """A fitted pose, ``T_camera_lidar``, with what its deviations are made from.

    ``stretch``: by which fraction the depths are too long, ``clock_s``: how late the camera's
    stamps are, ``floor_m``: the camera's height above the floor, NaN where none is seen.
    ``covariance``: (6, 6) of POSE_PARAMETERS, None where the frames and places are too few to tell.
    ``wall_patches``, ``floor_patches``: how many agree, ``agreement``: of the patches of walls on a
    scan's line. ``support``: how many walls' patches fit with the noise that is assumed of all,
    each by its weight. ``noise``: of patches, ``residual_rms_m``: of those of walls that agree.
    """

    T_camera_lidar: FloatArray
    stretch: float
    clock_s: float
    floor_m: float
    covariance: FloatArray | None
    wall_patches: int
    floor_patches: int
    agreement: float
    support: float
    noise: PatchNoise
    residual_rms_m: float

    def __post_init__(self) -> None:
        read_only(self.T_camera_lidar)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseCost:
    """``mean``: mean loss of the patches, 0 where all lie on their lines and 1 where none does, NaN
    without any. ``residual_rms_m``: along the ray, of those of walls that agree."""

    mean: float
    residual_rms_m: float


class PlanarProblem:
    """The frames of a recording, and the fit of a pose to them."""

    def __init__(
        self, frames: Sequence[ScanWithPatches], image_size: tuple[int, int], patches_max: int
    ) -> None:
        """``image_size``: width and height; ``patches_max``: patches used of an image.

        Raises CalibrationFailed without frames or patches.
        """
        if not frames or not sum(frame.patches.pixel.size for frame in frames):
            raise CalibrationFailed(
                "no depth image that is paired with a scan shows a plane surface.",
                advice="Record while the robot moves slowly along walls.",
            )
        self._flat = FlatFrames.of(frames, patches_max)
        self._size = image_size
        self.frames = len(frames)

    def fit(
        self,
        T_start: FloatArray,
        priors: PlanarPriors,
        *,
        used: BoolArray | None = None,
        with_covariance: bool = True,
        iterations_max: int = 30,
    ) -> PlanarFit:
        """The pose that the frames of ``used`` (F,), by default all, fit best, near the start.

        Raises CalibrationFailed where hardly any patch is on a line.
        """
        kept = np.ones(self.frames, dtype=bool) if used is None else used
        up = find_up(self._flat.normal_in_camera[kept[self._flat.frame]], T_start[:3, 2])
        T_start = turn_level(T_start, up)
        state = PlanarState(T_start, 0.0, priors.clock_s, np.nan)
        noise = PatchNoise()
        all_learned = _IN_PLANE_ITERATIONS + _NOISE_ITERATIONS
        for iteration in range(iterations_max):
            in_plane = iteration < _IN_PLANE_ITERATIONS
            if iteration <= _IN_PLANE_ITERATIONS:
                state.floor_m = find_floor_m(self._flat, state, kept)
            found = surface_residuals(self._flat, state, kept, self._size)
            if np.count_nonzero(~found.is_floor) < _MIN_PATCHES:
                raise CalibrationFailed(
                    "hardly any surface is seen by both sensors.",
                    advice="Start from better extrinsics (--guess), or record along walls.",
                )
            # Learned again and again, it would move the optimum with it.
            if _IN_PLANE_ITERATIONS < iteration <= all_learned:
                noise = noise.learn(found.depth_m, found.value, found.is_floor)
            step, sd = self._step(found, state, T_start, priors, noise, in_plane)
            state.T = apply_pose_error(state.T, step[:POSE])
            state.stretch += float(step[STRETCH])
            state.clock_s += float(step[CLOCK])
            state.floor_m += float(step[FLOOR])
            if iteration > all_learned and (np.abs(step) < _LAST_STEP_SD * sd).all():
                break
        found = surface_residuals(self._flat, state, kept, self._size)
        return self._result(found, state, T_start, priors, noise, with_covariance)

    def evaluate(self, fit: PlanarFit, T_camera_lidar: FloatArray, frames: IntArray) -> PoseCost:
        """How well some frames (K,) agree with a pose, with a fit's noise, clock and stretch."""
        kept = np.zeros(self.frames, dtype=bool)
        kept[frames] = True
        state = PlanarState(T_camera_lidar, fit.stretch, fit.clock_s, np.nan)
        state.floor_m = find_floor_m(self._flat, state, kept)
        if not np.isfinite(state.floor_m):
            state.floor_m = fit.floor_m
        found = surface_residuals(self._flat, state, kept, self._size)
        sigma = fit.noise.at(found.depth_m, found.is_floor)
        loss = 1.0 - welsch_weight(found.value, sigma)
        near = (loss < 1.0 - _AGREEING) & ~found.is_floor
        return PoseCost(
            mean=float(loss.mean()) if loss.size else np.nan,
            residual_rms_m=float(np.sqrt(np.mean(found.value[near] ** 2)))
            if near.any()
            else np.nan,
        )

    def _prior(
        self, state: PlanarState, T_start: FloatArray, priors: PlanarPriors
    ) -> tuple[FloatArray, FloatArray]:
        """(9,) gradient and (9, 9) information of the priors at a state."""
        R, t = state.T[:3, :3], state.T[:3, 3]
        up = R[:, 2]
        rows = [
            # c_z = -(R^T t)_z; d c_z = -(up x t) . omega - up . tau.
            (
                -float(up @ t) - priors.up_m,
                np.concatenate([-np.cross(up, t), -up, np.zeros(3)]),
                priors.up_sd_m,
            ),
            (state.stretch, _unit(STRETCH), priors.stretch_sd),
            (state.clock_s - priors.clock_s, _unit(CLOCK), priors.clock_sd_s),
        ]
        if priors.lidar_height_m is not None and np.isfinite(state.floor_m):
            row = _unit(FLOOR)
            row[:POSE] = np.concatenate([np.cross(up, t), up])
            off = state.floor_m + float(up @ t) - priors.lidar_height_m
            rows.append((off, row, priors.lidar_height_sd_m))
        information = np.zeros((UNKNOWNS, UNKNOWNS))
        gradient = np.zeros(UNKNOWNS)
        for off, row, row_sd in rows:
            information += np.outer(row, row) / row_sd**2
            gradient -= row * off / row_sd**2
        # Wide, so that what nothing shows stays where it was.
        sd = np.repeat([priors.angle_sd_rad, priors.place_sd_m], 3)
        from_start = -pose_error(T_start, state.T)
        information[:POSE, :POSE] += np.diag(1.0 / sd**2)
        gradient[:POSE] -= from_start / sd**2
        if not np.isfinite(state.floor_m):
            information[FLOOR, FLOOR] = 1.0
        return gradient, information

    def _step(
        self,
        found: SurfaceResiduals,
        state: PlanarState,
        T_start: FloatArray,
        priors: PlanarPriors,
        noise: PatchNoise,
        in_plane: bool,
    ) -> tuple[FloatArray, FloatArray]:
        """(9,) the step and (9,) its deviations, of independent patches. ``in_plane``: of the place
        in the LiDAR's plane, and of the heights, alone."""
        gradient, information = self._prior(state, T_start, priors)
        sigma = noise.at(found.depth_m, found.is_floor)
        weight = welsch_weight(found.value, sigma) / sigma**2
        J = found.jacobian
        information = information + J.T @ (J * weight[:, None])
        gradient = gradient - J.T @ (weight * found.value)
        if in_plane:
            up = state.T[:3, 2]
            information[:3, :3] += _HELD * (np.eye(3) - np.outer(up, up))
            information[[STRETCH, CLOCK], [STRETCH, CLOCK]] += _HELD
        try:
            back = np.linalg.inv(information)
        except np.linalg.LinAlgError as error:
            raise CalibrationFailed(
                "the surfaces that both sensors see do not determine a pose.",
                advice="Start from better extrinsics (--guess), or record along walls.",
            ) from error
        step: FloatArray = back @ gradient
        sd: FloatArray = np.sqrt(np.diag(back))
        return step, sd

    def _result(
        self,
        found: SurfaceResiduals,
        state: PlanarState,
        T_start: FloatArray,
        priors: PlanarPriors,
        noise: PatchNoise,
        with_covariance: bool,
    ) -> PlanarFit:
        sigma = noise.at(found.depth_m, found.is_floor)
        welsch = welsch_weight(found.value, sigma)
        assumed = PatchNoise().at(found.depth_m, found.is_floor)
        support = welsch_weight(found.value, assumed)[~found.is_floor].sum()
        counts = welsch > _AGREEING
        walls = counts & ~found.is_floor
        covariance = None
        if with_covariance:
            _, prior = self._prior(state, T_start, priors)
            weight = welsch / sigma**2
            J, L = found.jacobian, found.line_error
            scores = -(weight * found.value)[:, None] * J
            information = weight[:, None, None] * (
                J[:, :, None] * J[:, None, :] - L[:, :, None] * L[:, None, :]
            )
            # Along the LiDAR's axes, so that its height, which nothing shows, is one of them.
            turn = np.eye(UNKNOWNS)
            turn[:3, :3] = turn[3:6, 3:6] = state.T[:3, :3]
            scores = scores[counts] @ turn
            covariance = two_way_covariance(
                scores,
                turn.T @ information[counts] @ turn,
                turn.T @ prior @ turn,
                frame_blocks(scores, found.frame[counts]),
                found.place[counts],
            )
            if covariance is not None:
                # An offset of all ranges moves the optimum; it is hardly to be told from the place.
                total = prior + information.sum(axis=0)
                moved = np.linalg.solve(total, J.T @ (weight * found.by_range))
                covariance = turn @ covariance @ turn.T
                covariance = covariance + priors.range_sd_m**2 * np.outer(moved, moved)
                covariance = covariance[:POSE, :POSE]
        return PlanarFit(
            T_camera_lidar=state.T,
            stretch=state.stretch,
            clock_s=state.clock_s,
            floor_m=state.floor_m,
            covariance=covariance,
            wall_patches=int(np.count_nonzero(walls)),
            floor_patches=int(np.count_nonzero(counts & found.is_floor)),
            agreement=float(walls.sum() / max(np.count_nonzero(~found.is_floor), 1)),
            support=float(support),
            noise=noise,
            residual_rms_m=_rms(found.value[walls]),
        )


def _unit(index: int) -> FloatArray:
    vector = np.zeros(UNKNOWNS)
    vector[index] = 1.0
    return vector


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
