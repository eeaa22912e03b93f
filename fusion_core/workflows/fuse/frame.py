"""Pass 2: one scan against one depth image, from correspondence to repair."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fusion_core.alignment.curves import (
    CurveSampling,
    RowSampling,
    curve_samples_m,
    offset_of_yaw,
    row_samples_m,
    sample_curve,
    sample_row,
    yaw_of_offset_rad,
)
from fusion_core.alignment.mount_cost import mount_observation
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
from fusion_core.denoising.noise import Classification, FrameWindow, classify
from fusion_core.denoising.repair import Repair, repair
from fusion_core.model.conventions import NS_PER_S, BoolArray, Float32Array, FloatArray
from fusion_core.model.errors import AlignmentFailed, RegistrationFailed
from fusion_core.model.geometry import transform_points
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.robust import robust_sigma
from fusion_core.model.sensors import LaserScan
from fusion_core.registration.ransac import Registration, register
from fusion_core.workflows.fuse.align import RecordingAlignment, T_lidar_camera_at, turned_rad
from fusion_core.workflows.fuse.offset_search import OffsetSearch, search_offset
from fusion_core.workflows.fuse.pairing import FramePair, PairedImage, UprightDepth
from fusion_core.workflows.fuse.session import Session
from fusion_core.workflows.fuse.settings import ChainSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameMatch:
    """A depth image matched with its scan: the results of all stages before classification.

    ``curve`` and ``row`` sample the fields of ``search``. ``registration`` is None where it failed,
    for the reason in ``refusal``.
    ``u_of_rig``: added to a peak's u, which counts on the camera's own row, it gives the u of the
    recording's field; not 0 where several cameras make a panorama.
    ``turned_rad``: the turn from scan to image that the pairs were corrected by.
    ``turn_rate_rad_s``: of the LiDAR, NaN where it cannot be estimated from its scans.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class FusedFrame:
    """A matched depth image with its classified and repaired measurements."""

    match: FrameMatch
    classes: Classification
    repair: Repair

    @property
    def epsilon_m(self) -> float:
        """Median threshold over the pairs, NaN without pairs."""
        valid = self.classes.epsilon_m[np.isfinite(self.match.correspondence.residual_m)]
        return float(np.median(valid)) if valid.size else float("nan")

    @property
    def pixel_changed(self) -> BoolArray:
        """(B,): pairs whose pixel was changed by the repair."""
        repaired_m = self.repair.depth_m
        changed: BoolArray = (self.match.correspondence.row >= 0) & np.isfinite(repaired_m)
        changed &= repaired_m != self.match.correspondence.depth_m
        return changed


def fuse_frames(
    session: Session, alignment: RecordingAlignment, clock_offset_ms: float = 0.0
) -> Iterator[LaserScan | PairedImage | FusedFrame]:
    """Pass 2: scans as they arrive, fused frames, and the images that could not be fused."""
    previous: dict[int, UprightDepth] = {}
    for entry in session.pairs(clock_offset_ms):
        pair = None
        if not isinstance(entry, LaserScan):
            pair = session.frame_pair(entry, previous.get(entry.camera))
        if pair is None:
            yield entry
            continue
        try:
            yield fuse_frame(pair, alignment, session.settings)
        except AlignmentFailed:
            yield entry
        previous[pair.camera_index] = pair.upright


def fuse_frame(
    pair: FramePair, alignment: RecordingAlignment, settings: ChainSettings
) -> FusedFrame:
    """Match, classify and repair one pair.

    Raises AlignmentFailed where the frame is paired by its own (u, v) and has none.
    """
    match = match_frame(pair, alignment, settings)
    return classify_and_repair(match, alignment, settings)


def match_frame(
    pair: FramePair,
    alignment: RecordingAlignment,
    settings: ChainSettings,
    *,
    picked: tuple[float, float] | None = None,
) -> FrameMatch:
    """Search, pair and register one frame.

    ``picked``: an offset (u, v) of the camera's own row, chosen by hand; the pairs are then those
    of row v.

    Raises AlignmentFailed where the frame is paired by its own (u, v) and has none, and for a
    picked row that the image does not have.
    """
    scan, depth_m, model = pair.scan, pair.depth_m, pair.camera
    height = depth_m.shape[0]
    if picked is not None and not -0.5 <= picked[1] < height - 0.5:
        raise AlignmentFailed(
            f"row v = {picked[1]:g} is not in the image.",
            advice=f"Pick one from 0 to {height - 1}.",
        )
    curve, row = sample_curve(scan, settings.sampling), sample_row(model, settings.sampling)
    rate = estimate_turn_rate_rad_s(pair.window, settings.time)
    kept = mount_observation(model, scan, depth_m, scan.stamp_ns + pair.gap_ns, rate)

    turned = 0.0
    prior_u = offset_of_yaw(alignment.mount.yaw_rad, curve, row.left_rad)
    pairs = None
    if picked is None and alignment.along_curve and settings.pairing == "mount":
        turned = turned_rad(kept, alignment.mount, settings)
        T_lidar_camera = T_lidar_camera_at(model, alignment.mount, turned)
        pairs = match_along_curve(scan, depth_m, kept.depth_m, model, T_lidar_camera)
        # The search does not correct the turn between the stamps: it is removed from the offset
        # that is expected.
        prior_u = _offset_of_pairs(pairs, curve, row, model, prior_u - turned / curve.step_rad)
        prior_u += turned / curve.step_rad
    found = search_offset(scan, depth_m, curve, row, prior_u, settings)
    peak = found.peaks.get(settings.search.metric)
    if pairs is not None:
        registration, refusal = _register(pairs, settings)
    elif settings.pairing == "frame":
        chosen = picked if picked is not None else _offset_of_peak(peak)
        pairs, registration, refusal = _match_by_own_peak(
            scan, depth_m, curve, row, chosen, settings
        )
    else:
        mount = Mount(yaw_rad=alignment.mount.yaw_rad)
        chosen = picked if picked is not None else _offset_of_peak(peak)
        if chosen is not None:
            mount = Mount(yaw_rad=yaw_of_offset_rad(chosen[0], curve, row.left_rad))
        v = round(chosen[1] if chosen is not None else alignment.peak.v)
        pairs = match_in_row(
            scan, depth_m, kept.depth_m, model, T_lidar_camera_at(model, mount, 0.0), v
        )
        registration, refusal = _register(pairs, settings)
        if registration is not None:
            pairs = map_through_A(pairs, registration.A, registration.A_inverse)
    return FrameMatch(
        pair=pair,
        turned_rad=turned,
        turn_rate_rad_s=rate,
        curve=curve,
        row=row,
        search=found,
        u_of_rig=_offset_to_rig(pairs, row, model, alignment.row),
        row_model=pairs.model,
        registration=registration,
        refusal=refusal,
        correspondence=pairs,
    )


def classify_and_repair(
    match: FrameMatch, alignment: RecordingAlignment, settings: ChainSettings
) -> FusedFrame:
    """Classify and repair a frame that is matched already."""
    pair, rate = match.pair, match.turn_rate_rad_s
    window, scan, previous = pair.window, pair.scan, pair.previous
    registration = match.registration
    seen = FrameWindow(
        pairs=match.correspondence,
        scan=scan,
        depth_m=pair.depth_m,
        scan_before=window.before,
        scan_after=window.after,
        shift_before=_beams_turned(window.before, scan, rate),
        shift_after=_beams_turned(window.after, scan, rate),
        depth_before_m=None if previous is None else previous.depth_m,
        columns_before=_columns_turned(previous, match.stamp_ns, rate, pair.camera),
    )
    classes = classify(
        seen,
        settings.noise,
        alignment.scale,
        registration.mean_error_m if registration is not None else float("nan"),
    )
    return FusedFrame(
        match=match,
        classes=classes,
        repair=repair(seen, classes, alignment.scale, settings.repair),
    )


def curves_at(
    match: FrameMatch, offset: tuple[float, float], *, masked: bool = True
) -> tuple[FloatArray, FloatArray]:
    """(W,) samples of the LiDAR's curve and of the depth row that are compared at an offset (u, v)
    of the frame's own row. ``masked``: holes are NaN, else 0."""
    v = int(np.clip(round(offset[1]), 0, match.depth_m.shape[0] - 1))
    depth_m = row_samples_m(match.depth_m[v : v + 1], match.row)[0]
    index = round(offset[0]) + np.arange(depth_m.size)
    inside = (index >= 0) & (index < match.curve.beams.size)
    lidar_m = np.full(depth_m.size, np.nan)
    lidar_m[inside] = curve_samples_m(match.scan, match.curve)[index[inside]]
    if not masked:
        depth_m = np.nan_to_num(depth_m, nan=0.0)
        lidar_m[inside] = np.nan_to_num(lidar_m[inside], nan=0.0)
    return lidar_m, depth_m


def _offset_of_peak(peak: Peak | None) -> tuple[float, float] | None:
    return None if peak is None else (peak.u, peak.v)


def _offset_of_pairs(
    pairs: Correspondence,
    curve: CurveSampling,
    row: RowSampling,
    camera: Camera,
    otherwise: float,
) -> float:
    """The offset u of this frame by the mount: the median over the pairs, which includes the effect
    of the lever arm at their ranges. ``otherwise`` where there is no pair."""
    paired = np.isfinite(pairs.residual_m)
    if not paired.any():
        return otherwise
    on_curve = curve.sample_of_azimuth(pairs.azimuth_rad[paired])
    in_rig_rad = camera.column_azimuths_rad(pairs.column[paired].astype(np.float64))
    in_row = (row.left_rad - camera.yaw_rad - in_rig_rad) / row.step_rad
    return float(np.median(on_curve - in_row))


def _offset_to_rig(
    pairs: Correspondence, row: RowSampling, camera: Camera, rig_row: RowSampling
) -> float:
    """The recording's u minus a camera's own: the median over the pairs of how much further left
    their pixels lie on the camera's row than on the rig's, whose origin is elsewhere."""
    paired = np.isfinite(pairs.residual_m) & (pairs.row >= 0)
    if not camera.T_rig_camera[:3, 3].any() or not paired.any():
        return (row.left_rad - rig_row.left_rad) / rig_row.step_rad
    column = pairs.column[paired]
    rays = camera.rays(pairs.row[paired], column)
    in_rig = transform_points(camera.T_rig_camera, pairs.depth_m[paired, np.newaxis] * rays)
    on_rig = rig_row.left_rad - np.arctan2(in_rig[:, 1], in_rig[:, 0])
    own_rad = camera.yaw_rad + camera.column_azimuths_rad(column.astype(np.float64))
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
    scan: LaserScan,
    depth_m: Float32Array,
    curve: CurveSampling,
    row: RowSampling,
    offset: tuple[float, float] | None,
    settings: ChainSettings,
) -> tuple[Correspondence, Registration | None, str]:
    """The paper's method: samples paired at the frame's own (u, v) and related only by A."""
    if offset is None:
        raise AlignmentFailed("the frame's field has no peak.")
    pairs, lidar, depth = match_by_sample(scan, depth_m, curve.beams, row.columns, *offset)
    try:
        registration = register(lidar, depth, settings.registration)
    except RegistrationFailed as error:
        return pairs, None, error.problem
    pairs = compare_samples(
        pairs, lidar, depth, registration.A, registration.A_inverse, registration.residual_m
    )
    return pairs, registration, ""


def _columns_turned(
    previous: UprightDepth | None, stamp_ns: int, rate_rad_s: float, camera: Camera
) -> float:
    """Shift of a surface from this image to the one before, in columns to the right."""
    if previous is None or not np.isfinite(rate_rad_s):
        return 0.0
    turned = rate_rad_s * (stamp_ns - previous.stamp_ns) / NS_PER_S
    # A camera that turns left moves what it sees to the right.
    return -turned * camera.intrinsics.fx


def _beams_turned(other: LaserScan | None, scan: LaserScan, rate_rad_s: float) -> int:
    """Beams by which a surface moves from ``scan`` to its neighbour in time."""
    if other is None or not np.isfinite(rate_rad_s):
        return 0
    seconds = (other.stamp_ns - scan.stamp_ns) / NS_PER_S
    return round(-rate_rad_s * seconds / scan.angle_increment_rad)
