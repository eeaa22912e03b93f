"""The mount of the rig on the LiDAR, estimated once from the whole recording.

The LiDAR's plane does not meet the image in a row: what lies Delta z below the camera at depth z
appears Delta z f / z below the centre. So the offset u of the rows gives the yaw (Xu 2024's idea,
over the whole recording), and from there the mount is refined where LiDAR points, projected into
the image, agree best with the depth found there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fusion_core.alignment.in_plane_mount import (
    CLOCK,
    OBSERVABLE_SD,
    InPlaneMount,
    fit_in_plane,
    moved_by_height,
)
from fusion_core.alignment.mount_cost import MIN_POINTS, MountCost
from fusion_core.alignment.mount_floor import find_floor_tilt
from fusion_core.alignment.mount_height import (
    heights_to_try,
    keep_sight,
    sample_heights,
)
from fusion_core.alignment.mount_observation import MountObservation
from fusion_core.alignment.mount_refinement import ScanLines
from fusion_core.alignment.mount_search import (
    choose_mount,
    delta_z_profile,
    have_same_yaw,
    is_significantly_better,
    search_mounts,
)
from fusion_core.alignment.mount_settings import MountPriors, MountSettings
from fusion_core.alignment.mount_walls import find_wall_tilt
from fusion_core.alignment.parabola import parabola_offset
from fusion_core.alignment.recorded_mount import find_refusal
from fusion_core.alignment.rig_tilt import RigTilt
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.rig import Mount

# The search may move the pitch that is seen by this, so that it is not caught in a narrow valley.
_SEARCHED_PITCH_SD_RAD = float(np.deg2rad(0.5))


@dataclass(frozen=True, slots=True, kw_only=True)
class MountEstimate:
    """The mount, and how far the recording supports it.

    ``agreement``: fraction of visible points within the tolerance; ``visible``: fraction of points
    in front of a camera that fall on a valid depth; ``delta_z_profile``: (K, 2) Delta z and cost.
    ``refusal``: why a recorded mount is not used, as part of a sentence, "" where there is none.
    ``yaw_per_delay_rad_s``: where the clock offset is not observable, by how much a delay that the
    stamps do not show would turn the best yaw; the yaw's deviation does not count that.
    ``is_given``: a person gave it; ``is_confirmed``: whether enough points agree under it;
    ``contradictions``: what speaks against it, as parts of a sentence; ``moved_from_given``: how
    far it was moved within its covariance, in the same way, "" where it is used as it is given.
    ``tilt``: the rig's, by the floor or walls; None where neither shows it or where the transforms
    are known.
    """

    mount: Mount
    agreement: float
    visible: float
    is_confident: bool
    is_from_recorded: bool
    delta_z_profile: FloatArray
    refusal: str = ""
    yaw_per_delay_rad_s: float = 0.0
    is_given: bool = False
    is_confirmed: bool = True
    contradictions: tuple[str, ...] = ()
    moved_from_given: str = ""
    tilt: RigTilt | None = None

    @property
    def roll_rad(self) -> float:
        """By how much the cameras' poses have to be rolled for this mount (``Camera.rolled``), 0
        where nothing shows that the rig is rolled."""
        return self.tilt.roll_rad if self.tilt is not None and self.tilt.is_rolled else 0.0


def estimate_mount(
    frames: Sequence[MountObservation],
    settings: MountSettings,
    *,
    yaw_rad: float,
    recorded: Mount | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> MountEstimate:
    """Refine the mount from the yaw of the recording's offset u.

    Where the LiDAR's plane follows no single row, the rows can favour a wrong yaw: other yaws are
    tried as well, and taken only where they agree significantly better.
    ``recorded``: extrinsics that the recording itself gives; used as a prior where they explain
    what is seen (``find_refusal``), unless too few points agree and another mount explains them
    significantly. Where nothing is recorded and floor or walls show that the rig is rolled, the
    mount is that of the rolled cameras. Of a mount that the recording does not give, and under
    which too few points agree, nothing but their pitch is observable. ``on_step`` is called before
    each mount that is tried, and may raise to end the search.

    Raises AlignmentFailed where there are too few frames or points.
    """
    if len(frames) < 4 or sum(frame.points_m.shape[0] for frame in frames) < MIN_POINTS:
        raise AlignmentFailed(
            f"the mount needs 4 paired depth images with {MIN_POINTS} LiDAR points, got "
            f"{len(frames)}.",
            advice="Use a longer recording.",
        )
    problem = MountCost(frames, settings, on_step)
    tilt = None
    if recorded is None:
        tilt = _find_tilt(frames, problem, settings)
        if tilt is not None and tilt.is_rolled:
            rolled = [frame.rolled(tilt.roll_rad) for frame in frames]
            problem = MountCost(rolled, settings, on_step)
    lines = ScanLines(problem)
    refusal = "" if recorded is None else find_refusal(problem, recorded, settings, yaw_rad)
    found = None
    if recorded is not None and not refusal:
        found = _refine_recorded(problem, lines, recorded, settings)
    if found is None or found.agreement(problem) < settings.min_agreement:
        seen = tilt if recorded is None else _find_tilt(frames, problem, settings)
        free = _find_mount(problem, lines, yaw_rad, seen, settings)
        if found is not None:
            refusal = _reason_to_prefer_free_fit(problem, found.values, free.values, settings)
        if found is None or refusal:
            found = free
    agreement, visible = problem.agreement_and_visibility(found.values)
    is_from_recorded = recorded is not None and not refusal
    sd = np.where(found.sd <= OBSERVABLE_SD, found.sd, np.inf)
    if agreement < settings.min_agreement and not is_from_recorded:
        # The pitch is that of floor or walls, whatever the points say.
        sd[[0, 1]] = np.inf
    if not np.isfinite(sd[0]):
        # Forward and left are along the yaw, and a delay turns it.
        sd[[2, 3, CLOCK]] = np.inf
    heights_m = heights_to_try(problem.lowest_surface_m(float(found.values[4])), settings)
    mount = Mount.from_vector(
        found.values, tuple(float(value) if np.isfinite(value) else None for value in sd)
    )
    return MountEstimate(
        mount=mount,
        agreement=agreement,
        visible=visible,
        is_confident=bool(agreement >= settings.min_agreement and np.isfinite(sd[0])),
        is_from_recorded=is_from_recorded,
        delta_z_profile=delta_z_profile(problem, found.values, heights_m)[:, 1:],
        refusal=refusal,
        yaw_per_delay_rad_s=0.0 if np.isfinite(sd[CLOCK]) else found.yaw_per_delay_rad_s,
        tilt=tilt,
    )


def _find_tilt(
    frames: Sequence[MountObservation], problem: MountCost, settings: MountSettings
) -> RigTilt | None:
    headings_rad = problem.headings_rad()
    floor = find_floor_tilt(frames, headings_rad, settings)
    return find_wall_tilt(frames, headings_rad, settings) if floor is None else floor


def _refine_recorded(
    problem: MountCost, lines: ScanLines, recorded: Mount, settings: MountSettings
) -> InPlaneMount:
    """A recorded mount, moved in the LiDAR's plane as far as its doubt lets the data move it."""
    priors = MountPriors.from_recorded(recorded, settings)
    found = fit_in_plane(problem, lines, [recorded.vector()], priors)
    values, sd = found.values, found.sd.copy()
    sd[[1, 4]] = priors.sd[[1, 4]]
    # What looks along with the pitch's doubt.
    sd[2] = np.hypot(sd[2], abs(values[1]) * priors.sd[4])
    if problem.tallies_per_frame(values)[:, 2].sum() < MIN_POINTS:
        # The recording does not constrain it: it is used as recorded.
        sd[:] = np.inf
    return replace(found, sd=sd)


def _find_mount(
    problem: MountCost,
    lines: ScanLines,
    yaw_rad: float,
    tilt: RigTilt | None,
    settings: MountSettings,
) -> InPlaneMount:
    """The mount where nothing is recorded of it."""
    priors = MountPriors.without_recorded(yaw_rad, settings)
    if tilt is not None:
        priors = priors.with_pitch(tilt.pitch_rad, max(tilt.pitch_sd_rad, _SEARCHED_PITCH_SD_RAD))
    lowest_surface_m = problem.lowest_surface_m(float(priors.centre[4]))
    # Walls look alike at all heights: what nothing shows stays where LiDARs usually are.
    assumed_m, assumed_sd_m = settings.assumed_lidar_height_m, settings.assumed_lidar_height_sd_m
    if tilt is not None and tilt.height_m is not None:
        priors = priors.with_height(tilt.height_m - assumed_m, assumed_sd_m)
    elif assumed_m < -lowest_surface_m < np.inf:
        # The floor is no higher than anything seen: so high is the camera at least.
        least_m = -lowest_surface_m - assumed_m
        priors = priors.with_height(least_m, assumed_sd_m, settings.prior_delta_z_sd_m)
    heights_m = heights_to_try(lowest_surface_m, settings)
    fits = search_mounts(problem, priors, heights_m)
    best, is_yaw_ambiguous = choose_mount(problem, fits, yaw_rad)
    priors = priors.with_yaw(float(best[0]))
    if tilt is not None:
        priors = priors.with_pitch(tilt.pitch_rad, tilt.pitch_sd_rad)
    heights = sample_heights(problem, best, heights_m, priors)
    near = [fit for fit in fits if have_same_yaw(fit[0], best[0])]
    for at in (heights.best, heights.least):
        starts = [keep_sight(fit, heights.range_m, float(at[1]), float(at[4])) for fit in near]
        found = fit_in_plane(problem, lines, [at, *starts], priors)
        if np.isfinite(found.sd).any():
            break
        # Where no fit holds, pixels at the height that shows most are not of upright surfaces.
    sd = found.sd.copy()
    heights = sample_heights(problem, found.values, heights_m, priors)
    sd = np.hypot(sd, moved_by_height(lines, found, heights.least, priors))
    spread = heights.sd()
    sd[1] = spread[1]
    sd[4] = np.inf if tilt is None else tilt.pitch_sd_rad
    tilt_m = spread[2] if tilt is None else abs(heights.best[1]) * tilt.pitch_sd_rad
    sd[2] = np.hypot(sd[2], tilt_m)
    if is_yaw_ambiguous:
        sd[0] = np.inf
    return replace(found, values=heights.best, sd=sd)


def frame_yaw_offset_rad(frame: MountObservation, mount: Mount, settings: MountSettings) -> float:
    """How far one frame's own best yaw lies from the mount's: its check against the recording.

    The sum of what the frame shows and of a prior of ``frame_yaw_sd_deg`` around the mount: a
    plain wall fits at any yaw and must not pull. What remains is the turn that stamps do not
    explain (a clock offset, a scan that is not instantaneous).
    """
    problem = MountCost([frame], settings)
    sd_rad = np.deg2rad(settings.frame_yaw_sd_deg)
    offsets = np.linspace(-3.0, 3.0, 25) * sd_rad
    # Four neighbouring beams count as one observation; the loss is 1/16 of a log likelihood.
    costs = 4.0 * problem.costs_at_yaws(mount, mount.yaw_rad + offsets)
    costs += 0.5 * (offsets / sd_rad) ** 2
    best = int(costs.argmin())
    return float(offsets[best] + parabola_offset(costs, best) * (offsets[1] - offsets[0]))


def _reason_to_prefer_free_fit(
    problem: MountCost, stated: FloatArray, free: FloatArray, settings: MountSettings
) -> str:
    """Why the fit of a recorded mount, under which too few points agree, is not to be used: the
    points agree under a free fit, which is significantly better; "" where that is not so.

    Points that fall on no valid depth do not contradict a mount: walls agree at other heights, too.
    """
    agreement, visible = problem.agreement_and_visibility(stated)
    free_agreement, _ = problem.agreement_and_visibility(free)
    least = settings.min_agreement
    if min(visible, free_agreement) < least or not is_significantly_better(problem, free, stated):
        return ""
    return (
        f"{agreement:.0%} of the visible points agree under it, and {free_agreement:.0%} under the "
        "mount that fits them best"
    )
