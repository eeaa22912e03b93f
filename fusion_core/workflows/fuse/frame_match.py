"""Pass 2, first half: the offset, the pairs and the transform A of one image or one panorama."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from fusion_core.alignment.search import Peak
from fusion_core.alignment.time import estimate_turn_rate_rad_s
from fusion_core.denoising.correspondence import (
    Correspondence,
    RowModel,
    compare_samples,
    map_through_A,
    match_along_curve,
    match_by_sample,
    match_in_row,
    planar_points,
)
from fusion_core.model.conventions import BoolArray, Float32Array, FloatArray, IntArray
from fusion_core.model.errors import AlignmentFailed, RegistrationFailed
from fusion_core.model.geometry import transform_points
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.robust import robust_sigma
from fusion_core.model.sensors import LaserScan
from fusion_core.registration.ransac import Registration, register
from fusion_core.workflows.fuse.align import (
    RecordingAlignment,
    T_lidar_camera_at,
    observe_mount,
    turned_rad,
)
from fusion_core.workflows.fuse.offset_search import OffsetSearch, search_offset
from fusion_core.workflows.fuse.pairing import FramePair, PairedImage, UprightDepth, share_scan
from fusion_core.workflows.fuse.settings import ChainSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PastedPairs:
    """The pairs of a pasted panorama.

    ``depth_m``: (H, W) its wide image, in which the pairs' columns count; ``previous``: that of the
    images before, None where one is missing. ``camera``: (B,) whose pixel a pair has.
    """

    panorama: PastedPanorama
    depth_m: Float32Array
    previous: UprightDepth | None
    correspondence: Correspondence
    camera: IntArray

    def part_of(self, camera: int) -> Correspondence:
        """A camera's own pairs, with the columns of its image."""
        own = self.camera == camera
        pairs = self.correspondence.subset(own)
        return replace(pairs, column=pairs.column - self.panorama.columns_of[camera][0])


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameMatch:
    """A depth image matched with its scan: the results of all stages before classification.

    ``curve`` and ``row`` sample the fields of ``search``. Where several cameras look side by side,
    these are of the panorama of the images of nearly the same instant, and all of them share them.
    ``registration`` is None where it failed, for the reason in ``refusal``.
    ``u_of_rig``: added to a peak's u, it gives the u of the recording's field; not 0 where an image
    of several cameras is searched by itself.
    ``turned_rad``: the turn from scan to image that the pairs were corrected by.
    ``turn_rate_rad_s``: of the LiDAR, NaN where it cannot be estimated from its scans.
    ``images``: how many were searched together.
    ``pasted``: the panorama whose samples were paired and registered, of which ``correspondence``
    is this image's part; None where the image was paired by itself.
    """

    pair: FramePair
    turned_rad: float
    turn_rate_rad_s: float
    curve: CurveSampling
    row: RowSampling
    search: OffsetSearch
    u_of_rig: float
    row_model: RowModel
    registration: Registration | None
    refusal: str
    correspondence: Correspondence
    images: int = 1
    pasted: PastedPairs | None = None

    @property
    def scan(self) -> LaserScan:
        """The scan that the image is paired with."""
        return self.pair.scan

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.pair.image.stamp_ns

    @property
    def depth_m(self) -> Float32Array:
        """(H', W') upright view of the image."""
        return self.pair.depth_m

    @property
    def sigma_m(self) -> float:
        """Robust standard deviation of the residuals about zero, NaN without pairs."""
        residual_m = self.correspondence.residual_m
        residual_m = residual_m[np.isfinite(residual_m)]
        return robust_sigma(residual_m) if residual_m.size else float("nan")


def split_into_frames(
    group: Sequence[PairedImage], settings: ChainSettings
) -> list[Sequence[PairedImage]]:
    """What of a group is searched as one: all of it where its images make a panorama, else each
    image by itself. Samples of a pasted panorama are compared with a single scan."""
    if len(group) > 1 and settings.pairing == "frame":
        shared = share_scan(group, settings.time.max_gap_ms)
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
) -> list[FrameMatch]:
    """Search, pair and register one image, or the images of a panorama: one of each camera, of
    nearly the same instant, which are searched as one.

    ``picked``: an offset (u, v), chosen by hand, of the row that is searched; the pairs are then
    those of row v.

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
        return _match_by_own_peak(pairs, panorama, alignment, settings, picked)
    mounted = [_pair_by_mount(pair, alignment, settings, picked=picked) for pair in pairs]
    scan = min(pairs, key=lambda pair: abs(pair.gap_ns)).scan
    curve = sample_curve(scan, settings.sampling)
    if panorama is None:
        row = sample_row(pairs[0].camera, settings.sampling)
        rows_m = row_samples_m(pairs[0].depth_m, row)
    else:
        row, rows_m = panorama.sampling, panorama.samples_m([pair.depth_m for pair in pairs])
    prior_u = _expected_offset(mounted, curve, row, alignment, is_panorama=panorama is not None)
    search = search_offset(scan, curve, rows_m, prior_u, settings)
    peak = search.peaks.get(settings.search.metric)
    chosen = picked if picked is not None else _offset_of_peak(peak)
    matches = []
    for paired in mounted:
        pair, pairs_of = paired.pair, paired.along_curve
        if pairs_of is not None:
            registration, refusal = _register(pairs_of, settings)
        else:
            mount = Mount(yaw_rad=alignment.mount.yaw_rad)
            if chosen is not None:
                mount = Mount(yaw_rad=yaw_of_offset_rad(chosen[0], curve, row.left_rad))
            v = round(chosen[1] if chosen is not None else alignment.peak.v)
            T_lidar_camera = T_lidar_camera_at(pair.camera, mount, 0.0)
            smooth_m = paired.observation.depth_m
            pairs_of = match_in_row(
                pair.scan, pair.depth_m, smooth_m, pair.camera, T_lidar_camera, v
            )
            registration, refusal = _register(pairs_of, settings)
            if registration is not None:
                pairs_of = map_through_A(pairs_of, registration.A, registration.A_inverse)
        to_rig = 0.0
        if panorama is None:
            to_rig = _offset_to_rig(pairs_of, row, pair.camera, alignment.row)
        matches.append(
            FrameMatch(
                pair=pair,
                turned_rad=paired.turned_rad,
                turn_rate_rad_s=paired.observation.turn_rate_rad_s,
                curve=curve,
                row=row,
                search=search,
                u_of_rig=to_rig,
                row_model=pairs_of.model,
                registration=registration,
                refusal=refusal,
                correspondence=pairs_of,
                images=len(pairs),
            )
        )
    return matches


@dataclass(frozen=True, slots=True, kw_only=True)
class _MountedPair:
    """An image as the mount has it. ``along_curve``: its pairs along the projected curve, None
    where they are taken in a row."""

    pair: FramePair
    observation: MountObservation
    turned_rad: float
    along_curve: Correspondence | None


def _pair_by_mount(
    pair: FramePair,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    *,
    picked: tuple[float, float] | None,
) -> _MountedPair:
    observation = observe_mount(pair, settings)
    turned = 0.0
    along = None
    if picked is None and alignment.along_curve:
        turned = turned_rad(observation, alignment.mount, settings)
        T_lidar_camera = T_lidar_camera_at(pair.camera, alignment.mount, turned)
        along = match_along_curve(
            pair.scan, pair.depth_m, observation.depth_m, pair.camera, T_lidar_camera
        )
    return _MountedPair(pair=pair, observation=observation, turned_rad=turned, along_curve=along)


def curves_at(
    match: FrameMatch, offset: tuple[float, float], *, masked: bool = True
) -> tuple[FloatArray, FloatArray]:
    """(W,) samples of the LiDAR's curve and of the depth row that are compared at an offset (u, v)
    of the row that was searched. ``masked``: holes are NaN, else 0."""
    rows_m, curve_m = match.search.rows_m, match.search.curve_m
    depth_m = rows_m[int(np.clip(round(offset[1]), 0, rows_m.shape[0] - 1))].copy()
    index = round(offset[0]) + np.arange(depth_m.size)
    inside = (index >= 0) & (index < curve_m.size)
    lidar_m = np.full(depth_m.size, np.nan)
    lidar_m[inside] = curve_m[index[inside]]
    if not masked:
        depth_m = np.nan_to_num(depth_m, nan=0.0)
        lidar_m[inside] = np.nan_to_num(lidar_m[inside], nan=0.0)
    return lidar_m, depth_m


def _offset_of_peak(peak: Peak | None) -> tuple[float, float] | None:
    return None if peak is None else (peak.u, peak.v)


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
        turned = paired.turned_rad / curve.step_rad
        compared = np.isfinite(pairs.residual_m)
        on_curve = curve.sample_of_azimuth(pairs.azimuth_rad[compared])
        if is_panorama:
            from_left_rad = row.left_rad - _azimuths_in_rig_rad(pairs, camera, compared)
        else:
            column = pairs.column[compared].astype(np.float64)
            from_left_rad = row.left_rad - camera.yaw_rad - camera.column_azimuths_rad(column)
        offsets.append(on_curve - from_left_rad / row.step_rad + turned)
    known = np.concatenate(offsets)
    if known.size:
        return float(np.median(known))
    return offset_of_yaw(alignment.mount.yaw_rad, curve, row.left_rad)


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
        return (row.left_rad - rig_row.left_rad) / rig_row.step_rad
    column = pairs.column[paired].astype(np.float64)
    on_rig = rig_row.left_rad - _azimuths_in_rig_rad(pairs, camera, paired)
    own_rad = camera.yaw_rad + camera.column_azimuths_rad(column)
    on_own = row.left_rad - own_rad
    return float(np.median(on_own - on_rig)) / rig_row.step_rad


def _register(pairs: Correspondence, settings: ChainSettings) -> tuple[Registration | None, str]:
    lidar = planar_points(pairs, pairs.lidar_range_m)
    depth = planar_points(pairs, pairs.depth_as_range_m)
    try:
        return register(lidar, depth, settings.registration), ""
    except RegistrationFailed as error:
        return None, error.problem


def _match_by_own_peak(
    pairs: Sequence[FramePair],
    panorama: PastedPanorama | None,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    picked: tuple[float, float] | None,
) -> list[FrameMatch]:
    """The paper's method: samples paired at the frame's own (u, v) and related only by A."""
    scan = pairs[0].scan
    curve = sample_curve(scan, settings.sampling)
    if panorama is None:
        row, depth_m = sample_row(pairs[0].camera, settings.sampling), pairs[0].depth_m
    else:
        row, depth_m = panorama.sampling, panorama.paste([pair.depth_m for pair in pairs])
    prior_u = offset_of_yaw(alignment.mount.yaw_rad, curve, row.left_rad)
    search = search_offset(scan, curve, row_samples_m(depth_m, row), prior_u, settings)
    offset = (
        picked if picked is not None else _offset_of_peak(search.peaks.get(settings.search.metric))
    )
    if offset is None:
        raise AlignmentFailed("the frame's field has no peak.")
    whole, lidar, depth = match_by_sample(scan, depth_m, curve.beams, row.columns, *offset)
    registration, refusal = None, ""
    try:
        registration = register(lidar, depth, settings.registration)
        whole = compare_samples(
            whole, lidar, depth, registration.A, registration.A_inverse, registration.residual_m
        )
    except RegistrationFailed as error:
        refusal = error.problem
    pasted = None
    if panorama is not None:
        pasted = PastedPairs(
            panorama=panorama,
            depth_m=depth_m,
            previous=_paste_previous(panorama, pairs),
            correspondence=whole,
            camera=panorama.camera_of(whole.column),
        )
    rate = estimate_turn_rate_rad_s(pairs[0].window, settings.time)
    matches = []
    for pair in pairs:
        own = whole if pasted is None else pasted.part_of(pair.camera_index)
        to_rig = 0.0
        if pasted is None:
            to_rig = _offset_to_rig(own, row, pair.camera, alignment.row)
        matches.append(
            FrameMatch(
                pair=pair,
                turned_rad=0.0,
                turn_rate_rad_s=rate,
                curve=curve,
                row=row,
                search=search,
                u_of_rig=to_rig,
                row_model=own.model,
                registration=registration,
                refusal=refusal,
                correspondence=own,
                images=len(pairs),
                pasted=pasted,
            )
        )
    return matches
