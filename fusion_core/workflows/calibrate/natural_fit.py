"""The pose of a depth camera by walls and floor, from the guess and the chain's mount as starts."""

from dataclasses import dataclass, replace

import numpy as np

from fusion_core.alignment.in_plane_mount import OBSERVABLE_SD
from fusion_core.calibration.planar.natural_settings import NaturalSettings
from fusion_core.calibration.planar.planar_extrinsics import PlanarFit, PlanarPriors, PlanarProblem
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import AlignmentFailed, CalibrationFailed
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.progress import Progress
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.workflows.calibrate.planar_observations import observe_planar
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.camera_rig import CameraRig, build_camera_rig
from fusion_core.workflows.fuse.session import Session, session_of
from fusion_core.workflows.map.recorded_mount_check import recorded_mount_problem

# Furniture stands before walls at other heights; a wrong pose leaves a tenth of the surfaces.
_LEAST_AGREEMENT = 0.3
# What the chain calls not observable in its mount is not known to a metre.
_UNKNOWN_UP_SD_M = 1.0
_MS_PER_S = 1e3
# A basin is the same with every so many patches.
_COARSE = 3
_DELTA_Z = MOUNT_PARAMETERS.index("delta_z_m")


@dataclass(frozen=True, slots=True, kw_only=True)
class UprightImages:
    """The upright view of the camera's images, in which the pose is found: ``size`` is its width
    and height, ``T_guess`` the guess in it."""

    R_stored_view: FloatArray
    size: tuple[int, int]
    T_guess: FloatArray | None

    @classmethod
    def of(cls, rig: CameraRig, T_guess: FloatArray | None) -> "UprightImages":
        """That of a rig's first camera, with a guess for its stored images."""
        view = rig.views[0]
        upright = make_transform(view.R_stored_view.T, np.zeros(3))
        return cls(
            R_stored_view=view.R_stored_view,
            size=(view.intrinsics.width, view.intrinsics.height),
            T_guess=None if T_guess is None else upright @ T_guess,
        )

    def stored_pose(self, T_view_lidar: FloatArray) -> FloatArray:
        """(4, 4) in the frame of the images as they are stored."""
        T: FloatArray = make_transform(self.R_stored_view, np.zeros(3)) @ T_view_lidar
        return T

    def stored_covariance(self, covariance: FloatArray) -> FloatArray:
        """(6, 6) the same of a covariance by POSE_PARAMETERS."""
        turn = np.kron(np.eye(2), self.R_stored_view)
        turned: FloatArray = turn @ covariance @ turn.T
        return turned


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFit:
    """The best fit from all starts. ``problem``, ``priors``: for fits to parts of the frames;
    ``coarse``: with fewer patches, for other starts."""

    fit: PlanarFit
    covariance: FloatArray
    problem: PlanarProblem
    coarse: PlanarProblem
    priors: PlanarPriors


def find_pose(
    session: Session, view: UprightImages, settings: NaturalSettings, progress: Progress
) -> PoseFit:
    """The best fit from the guess and from the chain's mount.

    Raises AlignmentFailed without any start, CalibrationFailed where the recording does not
    determine the pose.
    """
    starts = [] if view.T_guess is None else [view.T_guess]
    chain_mount: Mount | None = None
    rig = session.rig
    problem_of_chain = ""
    try:
        alignment = align_recording(session, progress)
        chain_mount, rig = alignment.mount, alignment.on_rig(session).rig
    except AlignmentFailed as error:
        if not starts:
            raise
        problem_of_chain = error.problem
    if chain_mount is not None:
        starts.append(invert_transform(chain_mount.T_lidar_rig @ rig.cameras[0].T_rig_camera))
    frames = observe_planar(session, settings.frames, progress)
    problem = PlanarProblem(frames, view.size, settings.patches)
    priors = _priors(view, chain_mount, settings)
    fits: list[PlanarFit] = []
    failure = CalibrationFailed(problem_of_chain)
    for number, start in enumerate(starts, start=1):
        progress(number, len(starts), "refining the pose")
        try:
            fits.append(problem.fit(start, priors, with_covariance=False))
        except CalibrationFailed as error:
            failure = error
    if not fits:
        raise failure
    # By one noise for all: a wrong pose learns that its surfaces are noisy, and agrees with more.
    best = max(fits, key=lambda fit: fit.support)
    fit = problem.fit(best.T_camera_lidar, priors)
    if fit.agreement < _LEAST_AGREEMENT:
        raise CalibrationFailed(
            f"only {fit.agreement:.0%} of the surfaces that both sensors see agree on a pose.",
            advice="Record slowly, along walls and past corners, with nobody walking about.",
        )
    if fit.covariance is None:
        raise CalibrationFailed(
            f"{problem.frames} images of too few places do not show how sure a pose is.",
            advice="Record longer, with turns, past walls in several directions.",
        )
    up = fit.T_camera_lidar[:3, 2]
    yaw_sd_rad = float(np.sqrt(up @ fit.covariance[:3, :3] @ up))
    if yaw_sd_rad > OBSERVABLE_SD[0]:
        raise CalibrationFailed(
            "the recording does not show where the camera looks: its yaw is known to "
            f"{np.rad2deg(yaw_sd_rad):.1f} deg.",
            advice="Give --guess, above all for a camera that is mounted on its side, or record "
            "where both sensors see walls in several directions.",
        )
    _require_explained(session, view, fit)
    return PoseFit(
        fit=fit,
        covariance=_with_lidar_tilt(fit, fit.covariance, settings),
        problem=problem,
        coarse=PlanarProblem(frames, view.size, max(1, settings.patches // _COARSE)),
        priors=priors,
    )


def _require_explained(session: Session, view: UprightImages, fit: PlanarFit) -> None:
    """Raises CalibrationFailed where LiDAR points and depths agree no more than by chance: walls
    of another side of a room fit well, too."""
    T_camera_lidar = view.stored_pose(fit.T_camera_lidar)
    given = GivenExtrinsics(
        source="the result", cameras={None: CameraPose(T_camera_lidar=T_camera_lidar)}
    )
    chain = session.settings
    rig = build_camera_rig(session.recording, session.streams, chain.sampling, given=given)
    placed = replace(rig, recorded_mount=rig.known_mount, given=None)
    refusal = recorded_mount_problem(session_of(session.recording, session.streams, placed, chain))
    if refusal:
        raise CalibrationFailed(
            f"the pose that fits walls and floor best is not used: {refusal}.",
            advice="Give --guess, or record where both sensors see the same walls.",
        )


def _priors(view: UprightImages, chain: Mount | None, settings: NaturalSettings) -> PlanarPriors:
    """The height between the sensors: of the guess, else as the chain and the usual height of a
    LiDAR have it; of a measured height of the LiDAR in each case."""
    height = settings.lidar_height_m, settings.lidar_height_sd_m
    if view.T_guess is not None:
        up_m, up_sd_m = float(invert_transform(view.T_guess)[2, 3]), settings.up_sd_m
    else:
        assert chain is not None, "there is a start"
        sd = chain.sd[_DELTA_Z]
        up_m, up_sd_m = chain.delta_z_m, _UNKNOWN_UP_SD_M if sd is None else sd
        if settings.lidar_height_m is None:
            height = settings.assumed_lidar_height_m, settings.assumed_lidar_height_sd_m
    return PlanarPriors(
        up_m=up_m,
        up_sd_m=up_sd_m,
        angle_sd_rad=float(np.deg2rad(settings.start_angle_sd_deg)),
        place_sd_m=settings.start_place_sd_m,
        stretch_sd=settings.depth_scale_sd,
        range_sd_m=settings.range_offset_sd_m,
        clock_s=0.0,
        clock_sd_s=settings.clock_sd_ms / _MS_PER_S,
        lidar_height_m=height[0],
        lidar_height_sd_m=height[1],
    )


def _with_lidar_tilt(
    fit: PlanarFit, covariance: FloatArray, settings: NaturalSettings
) -> FloatArray:
    """(6, 6) with the doubt of how level the LiDAR is, which turns the camera about all level axes
    of the LiDAR."""
    up = fit.T_camera_lidar[:3, 2]
    tilted = covariance.copy()
    sd_rad = np.deg2rad(settings.lidar_level_sd_deg)
    tilted[:3, :3] += sd_rad**2 * (np.eye(3) - np.outer(up, up))
    return tilted
