"""A recording in which a 2D LiDAR and a camera see a board: views of it, each with a sweep.

Where the board and the robot stand still, the corners of several images are averaged and so are
the sweeps taken meanwhile. Where they never do, the corners are interpolated to the time of a sweep
between two images.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from fusion_core.calibration.board.board import Board, find_board, find_boards
from fusion_core.calibration.board.board_pose import fit_plane_pose
from fusion_core.calibration.board.laser_board import BoardView
from fusion_core.model.conventions import NS_PER_S, ByteArray, FloatArray
from fusion_core.model.errors import CalibrationFailed, MissingStream, RecordingError
from fusion_core.model.progress import Progress, silent
from fusion_core.model.recording import Recording
from fusion_core.model.robust import MAD_TO_SIGMA
from fusion_core.model.sensors import CameraInfo, CameraIntrinsics, ColorImage, LaserScan
from fusion_core.settings import StageSettings, setting
from fusion_core.workflows.sensor_geometry import ScanGeometry, most_common_geometry

# Images in which the size of the board is tried both ways.
_SAMPLED = 12
_STILL_PLACES_MIN = 6
# Ranges beyond so many standard deviations from their beam's median are left out.
_OUTLIER_SIGMA = 3.0
# Images of a standing board farther from its median place than this multiple of the median image.
_SETTING_OFF = 2.5
# Below the resolution of any LiDAR.
_LIMIT_MIN_M = 1e-3


class BoardViewSettings(StageSettings):
    """When the board counts as standing still, and what is done where it never does."""

    still_px: float = setting(
        1.0,
        "Root mean square of the corners' motion while the board stands",
        unit="px",
        ge=0.01,
        le=100.0,
    )
    still_images: int = setting(
        3,
        "Images that a standing board must be seen in: in fewer it may only be slow",
        unit="images",
        ge=2,
        le=1000,
    )
    gap_s: float = setting(
        1.0,
        "Images farther apart in time do not show one standing board",
        unit="s",
        ge=1e-3,
        le=60.0,
    )
    interpolation_gap_s: float = setting(
        0.3, "Images between which corners are interpolated", unit="s", ge=1e-3, le=10.0
    )
    views_max: int = setting(200, "Most views, evenly over the recording", ge=5, le=5000)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedBoard:
    """``board``: with the size that the images show. ``notes``: how the views were made."""

    board: Board
    views: list[BoardView]
    intrinsics: CameraIntrinsics
    camera_frame: str
    lidar_frame: str
    notes: list[str]


@dataclass(frozen=True, slots=True)
class _Seen:
    stamps_ns: list[int]
    corners_px: list[FloatArray]


def read_board_views(
    recording: Recording,
    board: Board,
    settings: BoardViewSettings,
    *,
    intrinsics: CameraIntrinsics | None = None,
    progress: Progress = silent,
) -> RecordedBoard:
    """Views of ``board``. Without ``intrinsics`` the recording's CameraInfo is taken.

    Raises MissingStream where there is no LiDAR, no image or no CameraInfo, and CalibrationFailed
    where no image shows the board or the intrinsics are for another size.
    """
    lidar = _topic_with_most(recording, "lidar", "2D LiDAR")
    color = _topic_with_most(recording, "color", "camera image")
    first = _first_image(recording, color)
    if intrinsics is None:
        intrinsics = _recorded_intrinsics(recording, color)
    shape = first.rgb.shape[:2]
    if (intrinsics.height, intrinsics.width) != shape:
        raise CalibrationFailed(
            f"the images of {color} have {shape[1]} x {shape[0]} pixels, the intrinsics are for"
            f" {intrinsics.width} x {intrinsics.height}.",
            file=recording.path,
            advice="Give the intrinsics of these images.",
        )
    board = _sized(recording, color, board)
    seen = _find_corners(recording, color, board, progress)
    geometry = most_common_geometry(recording, lidar)
    if geometry is None:
        raise MissingStream("has no scan that can be read.", file=recording.path)
    scans = _read_scans(recording, lidar, geometry)
    still = list(_still_views(seen, scans, board, intrinsics, settings))
    places = len(still)
    notes = []
    if places >= _STILL_PLACES_MIN:
        views = still
        notes.append(
            f"the board stands still at {places} places: corners and sweeps are averaged there"
        )
    else:
        views = list(_moving_views(seen, scans, board, intrinsics, settings))
        notes.append(
            f"the board stands still at {places} places only: its corners are interpolated to"
            f" the times of {len(views)} sweeps"
        )
    if len(views) > settings.views_max:
        chosen = np.linspace(0, len(views) - 1, settings.views_max).round().astype(int)
        views = [views[index] for index in chosen]
    return RecordedBoard(
        board=board,
        views=views,
        intrinsics=intrinsics,
        camera_frame=first.frame_id or "camera",
        lidar_frame=scans[0].frame_id or "lidar",
        notes=notes,
    )


def _topic_with_most(recording: Recording, role: str, what: str) -> str:
    named = [topic for topic in recording.topics if topic.role == role and topic.count]
    if not named:
        raise MissingStream(
            f"has no {what}.", file=recording.path, advice="Record a LiDAR and a camera together."
        )
    return max(named, key=lambda topic: topic.count).name


def _first_image(recording: Recording, topic: str) -> ColorImage:
    for message in recording.messages([topic]):
        if isinstance(message.value, ColorImage):
            return message.value
    raise MissingStream(f"has no readable image on {topic}.", file=recording.path)


def _recorded_intrinsics(recording: Recording, color: str) -> CameraIntrinsics:
    """Those of the CameraInfo whose name is nearest to the images'."""
    names = [
        topic.name for topic in recording.topics if topic.role == "camera_info" and topic.count
    ]
    parts = color.split("/")
    for name in sorted(names, key=lambda name: -_shared(name.split("/"), parts)):
        value = next((message.value for message in recording.messages([name])), None)
        if isinstance(value, CameraInfo) and value.intrinsics is not None:
            return value.intrinsics
    raise MissingStream(
        f"states no intrinsics for {color}.",
        file=recording.path,
        advice="Give --intrinsics FILE, as scanloom calibrate intrinsics writes it.",
    )


def _shared(one: list[str], other: list[str]) -> int:
    equal = [a == b for a, b in zip(one, other, strict=False)]
    return equal.index(False) if False in equal else len(equal)


def _grey_images(recording: Recording, topic: str) -> Iterator[tuple[int, ByteArray]]:
    shape = None
    for message in recording.messages([topic]):
        if isinstance(message.value, ColorImage):
            grey = cv2.cvtColor(message.value.rgb, cv2.COLOR_RGB2GRAY)
            shape = shape or grey.shape
            if grey.shape == shape:
                yield message.stamp_ns, np.asarray(grey, np.uint8)


def _sized(recording: Recording, color: str, board: Board) -> Board:
    """The board with the reading of its size, inner corners or squares, that some images show."""
    count = next(topic.count for topic in recording.topics if topic.name == color)
    sampled = []
    for index in np.unique(np.linspace(0, count - 1, _SAMPLED).round().astype(int)):
        try:
            value = recording.read(color, int(index)).value
        except RecordingError:
            continue
        if isinstance(value, ColorImage):
            sampled.append(np.asarray(cv2.cvtColor(value.rgb, cv2.COLOR_RGB2GRAY), np.uint8))
    return find_boards(sampled, board).board


def _find_corners(recording: Recording, color: str, board: Board, progress: Progress) -> _Seen:
    total = next(topic.count for topic in recording.topics if topic.name == color)
    seen = _Seen([], [])
    for done, (stamp_ns, grey) in enumerate(_grey_images(recording, color)):
        progress(done, total, "finding the board")
        recent = seen.stamps_ns and stamp_ns - seen.stamps_ns[-1] < NS_PER_S
        corners = find_board(grey, board, is_expected=bool(recent))
        if corners is None or (seen.stamps_ns and stamp_ns <= seen.stamps_ns[-1]):
            continue
        if seen.corners_px:
            # A board of odd sides looks the same after half a turn: it does not turn in between.
            before = seen.corners_px[-1]
            if np.abs(corners[::-1] - before).sum() < np.abs(corners - before).sum():
                corners = corners[::-1].copy()
        seen.stamps_ns.append(stamp_ns)
        seen.corners_px.append(corners)
    progress(total, total, "finding the board")
    if not seen.stamps_ns:
        raise CalibrationFailed(
            f"no image of {color} shows a board of {board.describe()}.", file=recording.path
        )
    return seen


def _read_scans(recording: Recording, lidar: str, geometry: ScanGeometry) -> list[LaserScan]:
    scans = [
        message.value
        for message in recording.messages([lidar])
        if isinstance(message.value, LaserScan) and geometry.matches(message.value)
    ]
    return sorted(scans, key=lambda scan: scan.stamp_ns)


def _middle_ns(scan: LaserScan) -> int:
    """The time of the middle beam."""
    return scan.stamp_ns + round(0.5 * scan.ranges_m.size * scan.time_increment_s * NS_PER_S)


def _still_views(
    seen: _Seen,
    scans: list[LaserScan],
    board: Board,
    intrinsics: CameraIntrinsics,
    settings: BoardViewSettings,
) -> Iterator[BoardView]:
    """One view for each time that the board stands, from its first to its last image."""
    times_ns = np.array([_middle_ns(scan) for scan in scans])
    stamps_ns = np.array(seen.stamps_ns)
    start = 0
    while start < len(stamps_ns):
        end = start + 1
        while end < len(stamps_ns) and _is_still(seen, start, end, settings):
            end += 1
        first, last = _at_rest(np.array(seen.corners_px[start:end]))
        if last - first + 1 >= settings.still_images:
            first, last = start + first, start + last
            during = (times_ns >= stamps_ns[first]) & (times_ns <= stamps_ns[last])
            if during.any():
                ranges = np.stack([scans[index].ranges_m for index in np.flatnonzero(during)])
                corners = np.mean(seen.corners_px[first : last + 1], axis=0)
                yield from _view(corners, _mean(ranges), scans[0], board, intrinsics)
        start = end


def _at_rest(corners_px: FloatArray) -> tuple[int, int]:
    """First and last of (I, N, 2) images that show the board at rest: at both ends it may be
    setting off, which shows as more than the trembling of the others."""
    off_px = np.sqrt(((corners_px - np.median(corners_px, axis=0)) ** 2).sum(axis=2).mean(axis=1))
    resting = np.flatnonzero(off_px <= _SETTING_OFF * np.median(off_px))
    return int(resting[0]), int(resting[-1])


def _is_still(seen: _Seen, first: int, index: int, settings: BoardViewSettings) -> bool:
    """Whether the board has not moved from image ``first`` to ``index``."""
    if seen.stamps_ns[index] - seen.stamps_ns[index - 1] > settings.gap_s * NS_PER_S:
        return False
    moved_px = seen.corners_px[index] - np.mean(seen.corners_px[first:index], axis=0)
    return float(np.sqrt((moved_px**2).sum(axis=1).mean())) <= settings.still_px


def _mean(ranges_m: FloatArray) -> FloatArray:
    """(N,) of (S, N) without outliers, where at least half of the sweeps have a value."""
    valid = np.isfinite(ranges_m).sum(axis=0) >= max(0.5 * ranges_m.shape[0], 1)
    mean = np.full(ranges_m.shape[1], np.nan)
    if not valid.any():
        return mean
    median = np.nanmedian(ranges_m[:, valid], axis=0)
    off = np.abs(ranges_m[:, valid] - median)
    # Noise grows with the range: one scale for each part of it.
    limit = _OUTLIER_SIGMA * MAD_TO_SIGMA * np.nanmedian(off / median) * median
    near = off <= np.maximum(limit, _LIMIT_MIN_M)
    # Two sweeps that disagree have no value between them.
    count = near.sum(axis=0)
    total = np.where(near, ranges_m[:, valid], 0.0).sum(axis=0)
    mean[valid] = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean


def _moving_views(
    seen: _Seen,
    scans: list[LaserScan],
    board: Board,
    intrinsics: CameraIntrinsics,
    settings: BoardViewSettings,
) -> Iterator[BoardView]:
    """One view for each sweep between two images of the board."""
    stamps_ns = np.array(seen.stamps_ns)
    for scan in scans:
        time_ns = _middle_ns(scan)
        after = int(np.searchsorted(stamps_ns, time_ns))
        if not 0 < after < len(stamps_ns):
            continue
        gap_ns = stamps_ns[after] - stamps_ns[after - 1]
        if gap_ns > settings.interpolation_gap_s * NS_PER_S:
            continue
        part = float(time_ns - stamps_ns[after - 1]) / float(gap_ns)
        corners = (1.0 - part) * seen.corners_px[after - 1] + part * seen.corners_px[after]
        yield from _view(corners, scan.ranges_m, scan, board, intrinsics)


def _view(
    corners_px: FloatArray,
    ranges_m: FloatArray,
    scan: LaserScan,
    board: Board,
    intrinsics: CameraIntrinsics,
) -> Iterator[BoardView]:
    pose = fit_plane_pose(board.points_m(), corners_px, intrinsics)
    if pose is not None:
        yield BoardView(pose=pose, ranges_m=ranges_m, angles_rad=scan.angles_rad)
