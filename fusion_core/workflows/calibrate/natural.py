"""Calibration of a 2D LiDAR and a depth camera without a board: walls and floor that both see.

Started from a guess and from the mount that the chain of ``fuse`` finds, all six degrees of freedom
are refined (``calibration/planar_extrinsics.py``). Frames that were held out decide whether the
result is better than the guess, and disturbed starts show from how far it is found.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from fusion_core.alignment.in_plane_mount import OBSERVABLE_SD
from fusion_core.calibration.planar.natural_settings import NaturalSettings
from fusion_core.calibration.planar.planar_extrinsics import PlanarFit, PlanarPriors, PlanarProblem
from fusion_core.calibration.pose_error import apply_pose_error, pose_error
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import AlignmentFailed, CalibrationFailed, MissingStream
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.rig import MOUNT_PARAMETERS, Mount
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.calibrate.planar_observations import observe_planar
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.camera_rig import CameraRig, build_camera_rig
from fusion_core.workflows.fuse.session import Session, session_of
from fusion_core.workflows.fuse.settings import PRESETS
from fusion_core.workflows.map.recorded_mount_check import recorded_mount_problem

_METHOD = "walls and floor that both see (natural scene), Gauss-Newton on their distances"
# Furniture stands before walls at other heights; a wrong pose leaves a tenth of the surfaces.
_LEAST_AGREEMENT = 0.3
# An optimum this near is the same, as are the bars of a good result: 0.3 deg and 3 cm.
_SAME_RAD, _SAME_M = float(np.deg2rad(0.3)), 0.03
# A gain of so many standard errors over the guess is one.
_GAIN_SE = 2.0
# What the chain calls not observable in its mount is not known to a metre.
_UNKNOWN_UP_SD_M = 1.0
_MS_PER_S = 1e3
# A basin is the same with every so many patches.
_COARSE = 3
_DELTA_Z = MOUNT_PARAMETERS.index("delta_z_m")


def calibrate_without_board(
    recording: Recording,
    settings: NaturalSettings | None = None,
    *,
    T_guess: FloatArray | None = None,
    lidar_topic: str | None = None,
    depth_topic: str | None = None,
    ignore_transforms: bool = False,
    progress: Progress = silent,
) -> ExtrinsicsEstimate:
    """T_camera_lidar of a recording's depth camera, whose stored images it is of.

    ``T_guess``: (4, 4), by default the recording's own transforms unless ``ignore_transforms``.
    A guess is kept, with the reason, where the result is not better on held-out frames or where the
    recording determines none.

    Raises MissingStream without LiDAR or depth images, SettingsError for a guess that no camera
    can have, CalibrationFailed where the recording does not determine the pose and there is no
    guess.
    """
    settings = settings or NaturalSettings()
    # Sums of several threads would depend on the number of cores.
    with threadpool_limits(1, user_api="blas"):
        session, T_guess = _open(recording, lidar_topic, depth_topic, T_guess, ignore_transforms)
        view = _View.of(session.rig, T_guess)
        try:
            found = _find(session, view, settings, progress)
        except (CalibrationFailed, AlignmentFailed) as error:
            if T_guess is None:
                if isinstance(error, CalibrationFailed):
                    raise
                raise CalibrationFailed(
                    error.problem, file=recording.path, advice=error.advice
                ) from error
            return _kept_without_result(T_guess, error.problem)
        return _conclude(found, view, settings, progress)


@dataclass(frozen=True, slots=True, kw_only=True)
class _View:
    """The upright view of the camera's images, in which the pose is found: ``size`` is its width
    and height, ``T_guess`` the guess in it."""

    R_stored_view: FloatArray
    size: tuple[int, int]
    T_guess: FloatArray | None

    @classmethod
    def of(cls, rig: CameraRig, T_guess: FloatArray | None) -> "_View":
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
class _Found:
    """The best fit from all starts. ``problem``, ``priors``: for fits to parts of the frames;
    ``coarse``: with fewer patches, for other starts."""

    fit: PlanarFit
    covariance: FloatArray
    problem: PlanarProblem
    coarse: PlanarProblem
    priors: PlanarPriors


def _open(
    recording: Recording,
    lidar_topic: str | None,
    depth_topic: str | None,
    T_guess: FloatArray | None,
    ignore_transforms: bool,
) -> tuple[Session, FloatArray | None]:
    """The recording with the camera alone, its mount unknown to the chain; and the guess."""
    streams = choose_streams(
        recording, lidar=lidar_topic, depth=None if depth_topic is None else (depth_topic,)
    )
    if len(streams.depth) > 1:
        raise MissingStream(
            f"has {len(streams.depth)} depth cameras: {', '.join(streams.depth)}.",
            file=recording.path,
            advice="Name the one to calibrate with --depth.",
        )
    chain = PRESETS["default"]
    if ignore_transforms:
        streams = replace(streams, tf_static=None)
    rig = build_camera_rig(recording, streams, chain.sampling)
    if not rig.cameras[0].calibrated:
        raise CalibrationFailed(
            f"{rig.cameras[0].topic} has no usable intrinsics.",
            file=recording.path,
            advice="Record its CameraInfo.",
        )
    if T_guess is None and rig.recorded_mount is not None:
        T_guess = _pose_of(rig, rig.recorded_mount)
    if T_guess is not None:
        given = GivenExtrinsics(
            source="the guess", cameras={None: CameraPose(T_camera_lidar=T_guess.copy())}
        )
        rig = build_camera_rig(recording, streams, chain.sampling, given=given)
    unknown = replace(rig, recorded_mount=None, given=None)
    return session_of(recording, streams, unknown, chain), T_guess


def _pose_of(rig: CameraRig, mount: Mount) -> FloatArray:
    """T_camera_lidar of the first camera, as its images are stored."""
    T_lidar_view = mount.T_lidar_rig @ rig.cameras[0].T_rig_camera
    back = make_transform(rig.views[0].R_stored_view, np.zeros(3))
    T_camera_lidar: FloatArray = back @ invert_transform(T_lidar_view)
    return T_camera_lidar


def _find(session: Session, view: _View, settings: NaturalSettings, progress: Progress) -> _Found:
    starts = [] if view.T_guess is None else [view.T_guess]
    chain_mount: Mount | None = None
    problem_of_chain = ""
    try:
        chain_mount = align_recording(session, progress).mount
    except AlignmentFailed as error:
        if not starts:
            raise
        problem_of_chain = error.problem
    if chain_mount is not None:
        rig = session.rig
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
    best = max(fits, key=lambda fit: fit.wall_patches)
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
    return _Found(
        fit=fit,
        covariance=_with_lidar_tilt(fit, fit.covariance, settings),
        problem=problem,
        coarse=PlanarProblem(frames, view.size, max(1, settings.patches // _COARSE)),
        priors=priors,
    )


def _require_explained(session: Session, view: _View, fit: PlanarFit) -> None:
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


def _priors(view: _View, chain: Mount | None, settings: NaturalSettings) -> PlanarPriors:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _HeldOut:
    """``gains``: (K,) by how much less each held-out block costs than under the guess, empty
    without one. ``residual_rms_m``: of the held-out blocks."""

    gains: FloatArray
    residual_rms_m: float

    @property
    def is_better(self) -> bool:
        """Whether the gain is more than chance."""
        error = np.std(self.gains, ddof=1) / np.sqrt(self.gains.size)
        return bool(np.mean(self.gains) > _GAIN_SE * error)


def _hold_out(
    found: _Found, view: _View, settings: NaturalSettings, progress: Progress
) -> _HeldOut:
    """Each block of frames under the pose that the others give, and under the guess."""
    problem = found.problem
    blocks = np.array_split(np.arange(problem.frames), settings.held_out_blocks)
    gains, squares = [], []
    for number, block in enumerate(blocks, start=1):
        progress(number, len(blocks), "checking on held-out frames")
        used = np.ones(problem.frames, dtype=bool)
        used[block] = False
        try:
            fit = problem.fit(
                found.fit.T_camera_lidar, found.priors, used=used, with_covariance=False
            )
        except CalibrationFailed:
            # Nearly all that is seen is in this block.
            continue
        own = problem.evaluate(fit, fit.T_camera_lidar, block)
        if np.isfinite(own.residual_rms_m):
            squares.append(own.residual_rms_m**2)
        if view.T_guess is not None:
            guess = problem.evaluate(fit, view.T_guess, block)
            if np.isfinite(own.mean):
                gains.append((guess.mean if np.isfinite(guess.mean) else 1.0) - own.mean)
    rms_m = float(np.sqrt(np.mean(squares))) if squares else np.nan
    return _HeldOut(gains=np.array(gains), residual_rms_m=rms_m)


def _try_basin(found: _Found, settings: NaturalSettings, progress: Progress) -> float | None:
    """Fraction of disturbed starts that come back; the height counts where it is observable."""
    if settings.basin_starts == 0:
        return None
    rng = np.random.default_rng(settings.seed)
    T = found.fit.T_camera_lidar
    back = 0
    for number in range(settings.basin_starts):
        progress(number + 1, settings.basin_starts, "trying disturbed starts")
        directions = rng.normal(size=(2, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        sizes = [np.deg2rad(settings.basin_angle_deg), settings.basin_place_m]
        start = apply_pose_error(T, (directions * np.array(sizes)[:, np.newaxis]).ravel())
        try:
            fit = found.coarse.fit(start, found.priors, with_covariance=False)
        except CalibrationFailed:
            continue
        off = pose_error(T, fit.T_camera_lidar)
        in_lidar = T[:3, :3].T @ off[3:]
        back += bool(
            np.linalg.norm(off[:3]) < _SAME_RAD and np.hypot(in_lidar[0], in_lidar[1]) < _SAME_M
        )
    return back / settings.basin_starts


def _conclude(
    found: _Found, view: _View, settings: NaturalSettings, progress: Progress
) -> ExtrinsicsEstimate:
    held_out = _hold_out(found, view, settings, progress)
    basin = _try_basin(found, settings, progress)
    T_view, covariance = found.fit.T_camera_lidar, found.covariance
    improved = view.T_guess is None or (held_out.gains.size > 1 and held_out.is_better)
    if not improved:
        assert view.T_guess is not None, "without one there is nothing to keep"
        # The guess is off by what the fit is off, and by how far it lies from the fit.
        apart = pose_error(T_view, view.T_guess)
        T_view, covariance = view.T_guess, covariance + np.outer(apart, apart)
    covariance = view.stored_covariance(covariance)
    greatest = np.repeat([np.deg2rad(settings.observable_sd_deg), settings.observable_sd_m], 3)
    # How far the guess lies off does not say what the recording shows.
    sd = np.sqrt(np.diag(view.stored_covariance(found.covariance)))
    is_unseen = sd > greatest
    unobservable = tuple(
        name for name, unseen in zip(POSE_PARAMETERS, is_unseen, strict=True) if unseen
    )
    covariance[is_unseen, :] = np.nan
    covariance[:, is_unseen] = np.nan
    return ExtrinsicsEstimate(
        T_camera_lidar=view.stored_pose(T_view),
        covariance=covariance,
        method=_METHOD,
        verdict=_verdict(found, view, held_out, improved, unobservable),
        improved=improved,
        T_guess=None if view.T_guess is None else view.stored_pose(view.T_guess),
        basin=basin,
        unobservable=unobservable,
        notes=tuple(_notes(found, settings, held_out, sd, unobservable)),
    )


def _verdict(
    found: _Found, view: _View, held_out: _HeldOut, improved: bool, unobservable: tuple[str, ...]
) -> str:
    fit = found.fit
    text = (
        f"{fit.agreement:.0%} of the surfaces on the scans' lines agree, within "
        f"{100.0 * fit.residual_rms_m:.1f} cm along the ray."
    )
    if view.T_guess is not None:
        off = pose_error(fit.T_camera_lidar, view.T_guess)
        apart = (
            f"{np.rad2deg(np.linalg.norm(off[:3])):.2f} deg and "
            f"{100.0 * np.linalg.norm(off[3:]):.1f} cm from the guess"
        )
        if improved:
            text += f" The result lies {apart}, and is better on frames that were held out."
        else:
            text += (
                f" The guess is kept: the result, {apart}, is not better on frames that were held "
                "out."
            )
    if unobservable:
        text += f" Not observable: {', '.join(unobservable)}."
    return text


def _notes(
    found: _Found,
    settings: NaturalSettings,
    held_out: _HeldOut,
    sd: FloatArray,
    unobservable: tuple[str, ...],
) -> Iterator[str]:
    fit = found.fit
    yield (
        f"{fit.wall_patches} patches of walls and {fit.floor_patches} of the floor in "
        f"{found.problem.frames} images."
    )
    yield (
        "There are no pairs of pixels: the residual is that of depths along their rays, "
        f"{100.0 * held_out.residual_rms_m:.2f} cm (rms) on held-out frames and "
        f"{100.0 * fit.residual_rms_m:.2f} cm on the used ones."
    )
    tilt = "the floor and upright walls" if fit.floor_patches else "upright walls, no floor,"
    yield (
        f"Tilt and roll are against {tilt}: they are the LiDAR's as far as it sweeps level (within "
        f"{settings.lidar_level_sd_deg:g} deg)."
    )
    for name in unobservable:
        deviation = dict(zip(POSE_PARAMETERS, sd, strict=True))[name]
        shown = f"{np.rad2deg(deviation):.2f} deg" if name.endswith("rad") else f"{deviation:.3f} m"
        yield f"{name} is not observable: it is known to {shown} (one standard deviation)."
    if settings.lidar_height_m is None and any(name.endswith("_m") for name in unobservable):
        yield (
            "Walls do not show how high the LiDAR's plane is: measure its height above the floor "
            "(lidar_height_m), and the height between the sensors becomes observable."
        )
    yield (
        f"Depths are {100.0 * fit.stretch:+.2f} % too long, and the camera's stamps "
        f"{_MS_PER_S * fit.clock_s:+.1f} ms late; both are taken out."
    )


def _kept_without_result(T_guess: FloatArray, problem: str) -> ExtrinsicsEstimate:
    return ExtrinsicsEstimate(
        T_camera_lidar=T_guess,
        covariance=np.full((6, 6), np.nan),
        method=_METHOD,
        verdict=f"The guess is kept: {problem}",
        improved=False,
        T_guess=T_guess.copy(),
        unobservable=POSE_PARAMETERS,
    )
