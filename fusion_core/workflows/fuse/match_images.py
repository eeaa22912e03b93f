"""Pass 2, first half: one image or the images of one panorama searched, paired and registered."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.curves import (
    CurveSampling,
    RowSampling,
    offset_of_yaw,
    row_samples_m,
    sample_curve,
    sample_row,
    yaw_of_offset_rad,
)
from fusion_core.alignment.mount_observation import MountObservation
from fusion_core.alignment.panorama import Panorama, PastedPanorama
from fusion_core.alignment.scan_motion import ScanMotion, estimate_motion
from fusion_core.denoising.correspondence import (
    Correspondence,
    compare_samples,
    map_through_A,
    match_along_curve,
    match_by_sample,
    match_in_row,
    planar_points,
)
from fusion_core.model.conventions import NS_PER_S, BoolArray, FloatArray
from fusion_core.model.errors import AlignmentFailed, RegistrationFailed
from fusion_core.model.geometry import transform_points
from fusion_core.model.polar import unwrap_towards
from fusion_core.model.rig import Camera, Mount
from fusion_core.registration.ransac import Registration, register
from fusion_core.workflows.fuse.align import (
    RecordingAlignment,
    T_lidar_camera_at,
    motion_to_image,
    observe_mount,
)
from fusion_core.workflows.fuse.frame_match import FrameMatch, PastedPairs
from fusion_core.workflows.fuse.offset_search import NO_SEARCH, OffsetSearch, search_offset
from fusion_core.workflows.fuse.pairing import FramePair, PairedImage, UprightDepth, share_scan
from fusion_core.workflows.fuse.settings import ChainSettings


def split_into_frames(
    group: Sequence[PairedImage], settings: ChainSettings
) -> list[Sequence[PairedImage]]:
    """What of a group is searched as one: all of it where its images make a panorama, else each
    image by itself. Samples of a pasted panorama are compared with a single scan."""
    if len(group) > 1 and settings.pairing == "frame":
        shared = share_scan(group, settings.time)
        if shared is not None:
            return [shared]
    elif all(entry.window is not None for entry in group):
        return [group]
    return [[entry] for entry in group]


def match_images(
    pairs: Sequence[FramePair],
    alignment: RecordingAlignment,
    settings: ChainSettings,
    *,
    picked: tuple[float, float] | None = None,
    pairs_only: bool = False,
) -> list[FrameMatch]:
    """Search, pair and register one image, or the images of a panorama: one of each camera, of
    nearly the same instant, which are searched as one.

    ``picked``: an offset (u, v), chosen by hand, of the row that is searched; the pairs are then
    those of row v. ``pairs_only``: without fields and peaks where the pairs do not rest on them.

    Raises AlignmentFailed where the frame is paired by its own (u, v) and has none, and for a
    picked row that the image does not have.
    """
    height = pairs[0].depth_m.shape[0]
    if picked is not None and not -0.5 <= picked[1] < height - 0.5:
        raise AlignmentFailed(
            f"row v = {picked[1]:g} is not in the image.",
            advice=f"Pick one from 0 to {height - 1}.",
        )
    panorama = alignment.panorama_for(settings) if len(pairs) > 1 else None
    if settings.pairing == "frame":
        assert not isinstance(panorama, Panorama), "frames paired by themselves are pasted"
        searched, registered = _match_by_own_peak(pairs, panorama, alignment, settings, picked)
    else:
        mounted = [_pair_by_mount(pair, alignment, settings, picked=picked) for pair in pairs]
        is_searched = not pairs_only or any(one.along_curve is None for one in mounted)
        searched = _search_by_mount(mounted, panorama, alignment, settings, is_searched=is_searched)
        offset = searched.offset(settings, picked)
        registered = [
            _register_mounted(one, searched, offset, alignment, settings) for one in mounted
        ]
    return [
        FrameMatch(
            pair=one.pair,
            moved=one.moved,
            motion=one.motion,
            curve=searched.curve,
            row=searched.row,
            search=searched.search,
            u_of_rig=(
                _offset_to_rig(one.correspondence, searched.row, one.pair.camera, alignment.row)
                if panorama is None
                else 0.0
            ),
            row_model=one.correspondence.model,
            registration=one.registration,
            refusal=one.refusal,
            correspondence=one.correspondence,
            images=len(pairs),
            pasted=one.pasted,
        )
        for one in registered
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Searched:
    """The search of a frame, and the samplings of its fields."""

    curve: CurveSampling
    row: RowSampling
    search: OffsetSearch

    def offset(
        self, settings: ChainSettings, picked: tuple[float, float] | None
    ) -> tuple[float, float] | None:
        """(u, v): the picked one, else that of the peak, None where the field has none."""
        peak = self.search.peaks.get(settings.search.metric)
        return picked if picked is not None or peak is None else (peak.u, peak.v)


@dataclass(frozen=True, slots=True, kw_only=True)
class _RegisteredPair:
    """An image with its pairs and their transform A, as in FrameMatch."""

    pair: FramePair
    correspondence: Correspondence
    registration: Registration | None
    refusal: str
    motion: ScanMotion | None
    moved: FloatArray
    pasted: PastedPairs | None = None


def _search_by_mount(
    mounted: Sequence["_MountedPair"],
    panorama: Panorama | PastedPanorama | None,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    *,
    is_searched: bool,
) -> _Searched:
    """The search around the offset that the mount expects; empty unless ``is_searched``."""
    pairs = [one.pair for one in mounted]
    scan = min(pairs, key=lambda pair: abs(pair.gap_ns)).aligned_scan
    row = sample_row(pairs[0].camera, settings.sampling) if panorama is None else panorama.sampling
    curve = sample_curve(scan, settings.sampling, width=row.columns.size)
    if not is_searched:
        return _Searched(curve=curve, row=row, search=NO_SEARCH)
    if panorama is None:
        rows_m = row_samples_m(pairs[0].depth_m, row)
    else:
        rows_m = panorama.samples_m([pair.depth_m for pair in pairs])
    prior_u = _expected_offset(mounted, curve, row, alignment, is_panorama=panorama is not None)
    search = search_offset(scan, curve, rows_m, prior_u, settings)
    return _Searched(curve=curve, row=row, search=search)


def _register_mounted(
    paired: "_MountedPair",
    searched: _Searched,
    offset: tuple[float, float] | None,
    alignment: RecordingAlignment,
    settings: ChainSettings,
) -> _RegisteredPair:
    """Pairs along the LiDAR's curve by the mount; in a row where that is not refined, and at a
    picked offset."""
    own = paired.along_curve
    if own is None:
        own = _pair_in_row(paired, searched, offset, alignment)
    registration, refusal = _register(
        planar_points(own, own.lidar_range_m),
        planar_points(own, own.depth_as_range_m),
        settings,
    )
    if paired.along_curve is None and registration is not None:
        own = map_through_A(own, registration.A, registration.A_inverse)
    return _RegisteredPair(
        pair=paired.pair,
        correspondence=own,
        registration=registration,
        refusal=refusal,
        motion=paired.observation.motion,
        moved=paired.moved,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _MountedPair:
    """An image as the mount has it. ``along_curve``: its pairs along the projected curve, None
    where they are taken in a row."""

    pair: FramePair
    observation: MountObservation
    moved: FloatArray
    along_curve: Correspondence | None


def _pair_by_mount(
    pair: FramePair,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    *,
    picked: tuple[float, float] | None,
) -> _MountedPair:
    observation = observe_mount(pair, settings)
    moved = np.zeros(3)
    along = None
    if picked is None and alignment.along_curve:
        moved = motion_to_image(observation, alignment.mount, settings)
        T_lidar_camera = T_lidar_camera_at(pair.camera, alignment.mount, moved)
        along = match_along_curve(
            pair.scan, pair.depth_m, observation.depth_m, pair.camera, T_lidar_camera
        )
    return _MountedPair(pair=pair, observation=observation, moved=moved, along_curve=along)


def _pair_in_row(
    paired: _MountedPair,
    searched: _Searched,
    offset: tuple[float, float] | None,
    alignment: RecordingAlignment,
) -> Correspondence:
    """The pairs of one row: by an offset (u, v), else by the recording's."""
    pair, yaw_rad, v = paired.pair, alignment.mount.yaw_rad, alignment.peak.v
    if offset is not None:
        yaw_rad = yaw_of_offset_rad(offset[0], searched.curve, searched.row.left_rad)
        v = offset[1]
    # The offset is that of the scan which was searched; the values are the paired one's.
    turned = 0.0 if offset is None else _turned_to_aligned_rad(pair, paired.observation.motion)
    turn = np.array([0.0, 0.0, turned])
    T_lidar_camera = T_lidar_camera_at(pair.camera, Mount(yaw_rad=yaw_rad), turn)
    smooth_m = paired.observation.depth_m
    return match_in_row(pair.scan, pair.depth_m, smooth_m, pair.camera, T_lidar_camera, round(v))


def _turned_to_aligned_rad(pair: FramePair, motion: ScanMotion | None) -> float:
    """The LiDAR's turn from the paired scan to the one that is searched."""
    seconds = (pair.aligned_scan.stamp_ns - pair.scan.stamp_ns) / NS_PER_S
    return 0.0 if motion is None else motion.turn_rate_rad_s * seconds


def _paste_previous(panorama: PastedPanorama, pairs: Sequence[FramePair]) -> UprightDepth | None:
    """The panorama of the images before, None where one is missing."""
    before = [pair.previous for pair in pairs if pair.previous is not None]
    if len(before) < len(pairs):
        return None
    return UprightDepth(
        stamp_ns=before[0].stamp_ns, depth_m=panorama.paste([own.depth_m for own in before])
    )


def _expected_offset(
    mounted: Sequence[_MountedPair],
    curve: CurveSampling,
    row: RowSampling,
    alignment: RecordingAlignment,
    *,
    is_panorama: bool,
) -> float:
    """The offset u of a frame by the mount: the median over the pairs, which includes the effect of
    the lever arm at their ranges; that of the mount's yaw where there is no pair."""
    offsets = [np.empty(0)]
    for paired in mounted:
        pairs, camera = paired.along_curve, paired.pair.camera
        if pairs is None:
            continue
        # The search does not correct the turn between the stamps: it is removed from the offset
        # that is expected.
        turned = float(paired.moved[2]) / curve.step_rad
        compared = np.isfinite(pairs.residual_m)
        on_curve = curve.sample_of_azimuth(pairs.azimuth_rad[compared])
        if is_panorama:
            from_left_rad = row.from_left_rad(_azimuths_in_rig_rad(pairs, camera, compared))
        else:
            column = pairs.column[compared].astype(np.float64)
            from_left_rad = row.left_rad - camera.yaw_rad - camera.column_azimuths_rad(column)
        offsets.append(on_curve - from_left_rad / row.step_rad + turned)
    known = np.concatenate(offsets)
    of_mount = offset_of_yaw(alignment.mount.yaw_rad, curve, row)
    if not known.size:
        return of_mount
    if curve.turn_samples is not None:
        # Each camera's pairs count on, over the seam.
        known = unwrap_towards(known, of_mount, curve.turn_samples)
    return float(np.median(known))


def _azimuths_in_rig_rad(pairs: Correspondence, camera: Camera, shown: BoolArray) -> FloatArray:
    """Azimuths of the ``shown`` pairs' pixels, seen from the rig's origin."""
    rays = camera.rays(pairs.row[shown], pairs.column[shown])
    in_rig = transform_points(camera.T_rig_camera, pairs.depth_m[shown, np.newaxis] * rays)
    return np.arctan2(in_rig[:, 1], in_rig[:, 0])


def _offset_to_rig(
    pairs: Correspondence, row: RowSampling, camera: Camera, rig_row: RowSampling
) -> float:
    """The recording's u minus a camera's own: the median over the pairs of how much further left
    their pixels lie on the camera's row than on the rig's, whose origin is elsewhere."""
    paired = np.isfinite(pairs.residual_m) & (pairs.row >= 0)
    if not camera.T_rig_camera[:3, 3].any() or not paired.any():
        return -float(rig_row.from_left_rad(np.array(row.left_rad))) / rig_row.step_rad
    column = pairs.column[paired].astype(np.float64)
    on_rig = rig_row.from_left_rad(_azimuths_in_rig_rad(pairs, camera, paired))
    own_rad = camera.yaw_rad + camera.column_azimuths_rad(column)
    on_own = row.from_left_rad(own_rad)
    return float(np.median(on_own - on_rig)) / rig_row.step_rad


def _register(
    lidar_points: FloatArray, depth_points: FloatArray, settings: ChainSettings
) -> tuple[Registration | None, str]:
    """The transform A, or None and why there is none."""
    try:
        return register(lidar_points, depth_points, settings.registration), ""
    except RegistrationFailed as error:
        return None, error.problem


def _match_by_own_peak(
    pairs: Sequence[FramePair],
    panorama: PastedPanorama | None,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    picked: tuple[float, float] | None,
) -> tuple[_Searched, list[_RegisteredPair]]:
    """The paper's method: samples paired at the frame's own (u, v) and related only by A."""
    scan = pairs[0].scan
    # One scan for all images: its instant is the middle one's.
    middle = sorted(pairs, key=lambda pair: pair.gap_ns)[len(pairs) // 2]
    if panorama is None:
        row, depth_m = sample_row(pairs[0].camera, settings.sampling), pairs[0].depth_m
    else:
        row, depth_m = panorama.sampling, panorama.paste([pair.depth_m for pair in pairs])
    curve = sample_curve(scan, settings.sampling, width=row.columns.size)
    prior_u = offset_of_yaw(alignment.mount.yaw_rad, curve, row)
    rows_m = row_samples_m(depth_m, row)
    search = search_offset(middle.aligned_scan, curve, rows_m, prior_u, settings)
    searched = _Searched(curve=curve, row=row, search=search)
    offset = searched.offset(settings, picked)
    if offset is None:
        raise AlignmentFailed("the frame's field has no peak.")
    motion = estimate_motion(pairs[0].window, settings.time)
    # The offset is that of the scan which was searched; the values are the paired one's.
    u = curve.on_curve(offset[0] - _turned_to_aligned_rad(middle, motion) / curve.step_rad)
    whole, lidar, depth = match_by_sample(scan, depth_m, curve.beams, row.columns, u, offset[1])
    registration, refusal = _register(lidar, depth, settings)
    if registration is not None:
        whole = compare_samples(
            whole, lidar, depth, registration.A, registration.A_inverse, registration.residual_m
        )
    pasted = None
    if panorama is not None:
        pasted = PastedPairs(
            panorama=panorama,
            images=tuple(pairs),
            depth_m=depth_m,
            previous=_paste_previous(panorama, pairs),
            correspondence=whole,
            camera=panorama.camera_of(whole.column),
        )
    return searched, [
        _RegisteredPair(
            pair=pair,
            correspondence=whole if pasted is None else pasted.part_of(pair.camera_index),
            registration=registration,
            refusal=refusal,
            motion=motion,
            moved=np.zeros(3),
            pasted=pasted,
        )
        for pair in pairs
    ]
