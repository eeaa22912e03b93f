"""A mount that a person gives, and what the recording shows of it.

Without a covariance it is used as it is. With one it is a prior, as sharp as that says: the pairs
of scans and images move it within its doubt, and what the covariance calls not observable, such as
the height of the LiDAR's plane, is found as where no mount is given.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from fusion_core.alignment.in_plane_mount import (
    CLOCK,
    OBSERVABLE_SD,
    InPlaneMount,
    fit_in_plane,
)
from fusion_core.alignment.mount import MountEstimate
from fusion_core.alignment.mount_cost import MIN_POINTS, MountCost
from fusion_core.alignment.mount_height import heights_to_try, sample_heights
from fusion_core.alignment.mount_observation import MountObservation
from fusion_core.alignment.mount_refinement import IN_PLANE, ScanLines
from fusion_core.alignment.mount_search import is_significantly_better
from fusion_core.alignment.mount_settings import MountPriors, MountSettings
from fusion_core.alignment.recorded_mount import find_refusal
from fusion_core.model.conventions import FloatArray, wrap_angle
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.given_extrinsics import CameraPose
from fusion_core.model.number_text import with_deviation
from fusion_core.model.rig import Mount

# A fit that lies this many standard deviations from the given mount contradicts it.
_CONTRADICTION_SD = 3.0
# Where it also lies farther than what is shown of it.
_SHOWN = np.array([np.deg2rad(0.05), np.nan, 0.005, 0.005, np.nan, np.nan])
# A smaller deviation than this, in rad or m, is that of no instrument, and has no inverse.
_LEAST_SD = 1e-6
_IN_PLANE_NAMES = {0: "yaw", 2: "forward", 3: "left"}


def given_mount_sd(poses: Sequence[CameraPose], settings: MountSettings) -> FloatArray:
    """(5,) standard deviations of the mount of a rig with these cameras, as MOUNT_PARAMETERS
    without the clock: the largest of the cameras' own.

    A camera without covariance has the doubt of a recorded mount. What its covariance calls not
    observable has the doubt of a mount of which nothing is known.
    """
    largest: FloatArray = np.max([_pose_sd(pose, settings) for pose in poses], axis=0)
    return largest


def _pose_sd(pose: CameraPose, settings: MountSettings) -> FloatArray:
    if pose.covariance is None:
        angle_rad = np.deg2rad(settings.recorded_angle_sd_deg)
        place_m = settings.recorded_position_sd_m
        return np.array([angle_rad, place_m, place_m, place_m, angle_rad])
    unknown = np.repeat([np.deg2rad(settings.prior_pitch_sd_deg), settings.prior_delta_z_sd_m], 3)
    is_known = np.isfinite(np.diag(pose.covariance))
    covariance = np.diag(np.where(is_known, 0.0, unknown**2))
    covariance[np.ix_(is_known, is_known)] = pose.covariance[np.ix_(is_known, is_known)]
    J = mount_jacobian(pose.T_camera_lidar)
    variance = np.einsum("ij,jk,ik->i", J, covariance, J)
    sd: FloatArray = np.sqrt(np.maximum(variance, _LEAST_SD**2))
    return sd


def mount_jacobian(T_camera_lidar: FloatArray) -> FloatArray:
    """(5, 6): how yaw, Delta z, forward, left and pitch of a camera change with an error of its
    pose, by POSE_PARAMETERS.

    With R = Exp(omega) R' and t = t' + tau the camera is at -R^T t and looks along R^T e_z.
    """
    R, t = T_camera_lidar[:3, :3], T_camera_lidar[:3, 3]
    place = np.hstack([-R.T @ _cross_matrix(t), -R.T])
    axis, turn = R[2], R.T @ _cross_matrix(np.array([0.0, 0.0, 1.0]))
    level2 = float(axis[0] ** 2 + axis[1] ** 2)
    yaw = np.append((axis[0] * turn[1] - axis[1] * turn[0]) / level2, np.zeros(3))
    pitch = np.append(-turn[2] / np.sqrt(level2), np.zeros(3))
    return np.stack([yaw, place[2], place[0], place[1], pitch])


def _cross_matrix(vector: FloatArray) -> FloatArray:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def hold_given_mount(
    frames: Sequence[MountObservation],
    settings: MountSettings,
    *,
    given: Mount,
    sd: FloatArray,
    within_doubt: bool = False,
    on_step: Callable[[], None] = lambda: None,
) -> MountEstimate:
    """The given mount with its deviations ``sd`` (5,), and the clock offset that belongs to it.

    Its pairs lie along the projected curve whatever the recording says; what that says against the
    mount as it is given is in ``contradictions``. ``within_doubt``: scans and images move it
    within ``sd``, unless they refuse it; else nothing of it is estimated but the clock offset.
    ``on_step``: as for ``estimate_mount``.

    Raises AlignmentFailed without any paired depth image.
    """
    if not frames:
        raise AlignmentFailed(
            "no depth image is paired with a scan.", advice="Use a longer recording."
        )
    problem = MountCost(frames, settings, on_step)
    lines = ScanLines(problem)
    centre = given.vector()
    deviations = np.append(sd, settings.prior_clock_sd_ms)
    priors = MountPriors(centre=centre, sd=deviations, stretch_sd=settings.depth_scale_sd)
    own = fit_in_plane(problem, lines, [centre], priors)
    values = centre.copy()
    is_clock_known = bool(own.sd[CLOCK] <= OBSERVABLE_SD[CLOCK])
    if is_clock_known:
        values[CLOCK] = own.values[CLOCK]
    agreement, visible = problem.agreement_and_visibility(values)
    free = fit_in_plane(problem, lines, [centre], MountPriors.around(given, settings))
    refusal = ""
    if agreement < settings.min_agreement:
        # Not by the yaw of the rows, which need not follow the LiDAR's plane.
        refusal = find_refusal(problem, Mount.from_vector(values), settings, None)
    contradictions: tuple[str, ...] = ()
    if refusal:
        # Far from it, the nearest optimum says nothing.
        contradictions = (refusal,)
    elif is_significantly_better(problem, free.values, values):
        # Else the fit has run off to a worse optimum, which says nothing either.
        contradictions = tuple(_offsets(free, values, sd, settings))
    shown_sd, moved = np.append(sd, own.sd[CLOCK]), ""
    if within_doubt and not refusal:
        values, shown_sd = _move_within_doubt(problem, lines, own, priors, settings)
        agreement, visible = problem.agreement_and_visibility(values)
        moved = _describe_move(values - centre)
    shown_sd = np.where(shown_sd <= OBSERVABLE_SD, shown_sd, np.inf)
    return MountEstimate(
        mount=Mount.from_vector(
            values, tuple(float(one) if np.isfinite(one) else None for one in shown_sd)
        ),
        agreement=agreement,
        visible=visible,
        is_confident=True,
        is_from_recorded=False,
        delta_z_profile=np.empty((0, 2)),
        is_given=True,
        is_confirmed=agreement >= settings.min_agreement,
        contradictions=contradictions,
        moved_from_given=moved,
    )


def _move_within_doubt(
    problem: MountCost,
    lines: ScanLines,
    own: InPlaneMount,
    priors: MountPriors,
    settings: MountSettings,
) -> tuple[FloatArray, FloatArray]:
    """(6,) a given mount with what the recording adds to its ``priors``, and (6,) its deviations,
    from its fit in the LiDAR's plane."""
    sd = own.sd.copy()
    sd[[1, 4]] = priors.sd[[1, 4]]
    if problem.tallies_per_frame(own.values)[:, 2].sum() < MIN_POINTS:
        # The recording does not constrain it.
        sd[:CLOCK] = priors.sd[:CLOCK]
        return own.values, sd
    if priors.sd[1] <= OBSERVABLE_SD[1]:
        return own.values, sd
    lowest_surface_m = problem.lowest_surface_m(float(own.values[4]))
    heights_m = heights_to_try(lowest_surface_m, settings)
    heights = sample_heights(problem, own.values, heights_m, priors)
    found = fit_in_plane(problem, lines, [heights.best], priors)
    sd[IN_PLANE] = found.sd[IN_PLANE]
    spread = heights.sd()
    sd[1] = spread[1]
    sd[2] = np.hypot(sd[2], spread[2])
    return found.values, sd


def _describe_move(moved: FloatArray) -> str:
    yaw_rad, up_m, forward_m, left_m = moved[:4]
    return (
        f"{np.rad2deg(wrap_angle(yaw_rad)):+.2f} deg in yaw, {forward_m:+.3f} m forward, "
        f"{left_m:+.3f} m to the left and {up_m:+.2f} m up"
    )


def _offsets(
    free: InPlaneMount, values: FloatArray, sd: FloatArray, settings: MountSettings
) -> Iterator[str]:
    """How far the mount that scans and images agree best with, near the given one, lies from it."""
    for index, name in _IN_PLANE_NAMES.items():
        own_sd = float(free.sd[index])
        if index == 0 and not np.isfinite(free.sd[CLOCK]):
            # A delay that the stamps do not show looks like a yaw.
            delay_s = 1e-3 * settings.prior_clock_sd_ms
            own_sd = float(np.hypot(own_sd, free.yaw_per_delay_rad_s * delay_s))
        off = float(free.values[index] - values[index])
        if index == 0:
            off = float(wrap_angle(off))
        # Infinite where scans and images do not show it.
        if abs(off) <= max(_CONTRADICTION_SD * np.hypot(own_sd, sd[index]), _SHOWN[index]):
            continue
        if index == 0:
            number, deviation = with_deviation(np.rad2deg(off), np.rad2deg(own_sd))
            yield f"they agree best with a yaw {number} deg from it (+- {deviation})"
        else:
            number, deviation = with_deviation(off, own_sd)
            yield f"they agree best {number} m {name} of it (+- {deviation})"
