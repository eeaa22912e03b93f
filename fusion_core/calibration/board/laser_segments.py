"""Straight segments in a sweep of a 2D LiDAR, with how well each is known."""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.robust import robust_sigma
from fusion_core.settings import StageSettings, setting

# Points of a segment beyond this many standard deviations are no part of it.
_OUTLIER_SIGMA = 3.5


class SegmentSettings(StageSettings):
    """What counts as a straight segment."""

    gap_m: float = setting(
        0.12,
        "Ranges of neighbouring beams that differ by more are apart",
        unit="m",
        ge=1e-3,
        le=10.0,
    )
    relative_gap: float = setting(0.05, "And by more than this part of the range", ge=0.0, le=1.0)
    lost_beams: int = setting(3, "Beams without a value that a segment may span", ge=0, le=100)
    bend_m: float = setting(
        0.05, "A segment is split where it leaves its chord by more", unit="m", ge=1e-3, le=10.0
    )
    points_min: int = setting(10, "Least points of a segment", unit="points", ge=4, le=10_000)


@dataclass(frozen=True, slots=True, kw_only=True)
class Segment:
    """A line through ``count`` points: ``ends_m`` (2, 2) lie on it one standard deviation of the
    points from their middle on both sides, ``normal`` (2,) is across it.

    There the errors of the two ends across the line are independent, ``sd_m`` each.
    """

    ends_m: FloatArray
    normal: FloatArray
    sd_m: float
    length_m: float
    count: int

    def __post_init__(self) -> None:
        read_only(self.ends_m)
        read_only(self.normal)


def find_segments(
    ranges_m: FloatArray, angles_rad: FloatArray, settings: SegmentSettings | None = None
) -> list[Segment]:
    """The straight segments of a sweep; ``ranges_m`` (N,) with NaN where there is no return."""
    settings = settings or SegmentSettings()
    beams = np.flatnonzero(np.isfinite(ranges_m))
    if beams.size < settings.points_min:
        return []
    ranges = ranges_m[beams]
    jump_m = np.maximum(settings.gap_m, settings.relative_gap * np.minimum(ranges[:-1], ranges[1:]))
    apart = np.abs(np.diff(ranges)) > jump_m
    apart |= np.diff(beams) > settings.lost_beams + 1
    points = np.stack(
        [ranges * np.cos(angles_rad[beams]), ranges * np.sin(angles_rad[beams])], axis=1
    )
    parts = np.split(np.arange(beams.size), np.flatnonzero(apart) + 1)
    segments = []
    for part in parts:
        for straight in _split(points, part, settings):
            segment = _fit(points[straight], settings)
            if segment is not None:
                segments.append(segment)
    return segments


def _split(points_m: FloatArray, part: IntArray, settings: SegmentSettings) -> list[IntArray]:
    """Iterative end-point fit: split at the point farthest from the chord, while it is far."""
    done, waiting = [], [part]
    while waiting:
        part = waiting.pop()
        if part.size < settings.points_min:
            continue
        here = points_m[part]
        # Single noisy points at the ends would turn the chord.
        start, end = np.median(here[:3], axis=0), np.median(here[-3:], axis=0)
        chord = end - start
        across = np.array([-chord[1], chord[0]]) / max(float(np.linalg.norm(chord)), 1e-9)
        off = (here - start) @ across
        # The median of five keeps a bend and drops a spike.
        smooth = np.median(
            np.lib.stride_tricks.sliding_window_view(np.pad(off, 2, mode="edge"), 5), axis=1
        )
        far = int(np.argmax(np.abs(smooth)))
        if abs(smooth[far]) <= settings.bend_m:
            done.append(part)
            continue
        far = min(max(far, 1), part.size - 1)
        waiting += [part[:far], part[far:]]
    return done


def _fit(points_m: FloatArray, settings: SegmentSettings) -> Segment | None:
    """Total least squares, twice without the points that are far off."""
    # The outermost beams may see two surfaces at once.
    kept = points_m[1:-1]
    for _ in range(3):
        if kept.shape[0] < settings.points_min - 2:
            return None
        middle = kept.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov(kept.T))
        normal, along = vectors[:, 0], vectors[:, 1]
        off = (kept - middle) @ normal
        near = np.abs(off) <= _OUTLIER_SIGMA * max(robust_sigma(off), 1e-4)
        if near.all():
            break
        kept = kept[near]
    count = kept.shape[0]
    spread_m = float(np.sqrt(max(values[1], 0.0)))
    noise_m = float(np.sqrt((off**2).sum() / max(count - 2, 1)))
    if spread_m < 3.0 * noise_m:
        return None
    along_m = (kept - middle) @ along
    return Segment(
        ends_m=np.stack([middle - spread_m * along, middle + spread_m * along]),
        normal=normal.copy(),
        # The variance of a fitted line at x from its middle is s²/N (1 + x²/spread²).
        sd_m=max(noise_m, 1e-4) * float(np.sqrt(2.0 / count)),
        length_m=float(np.ptp(along_m)),
        count=count,
    )
