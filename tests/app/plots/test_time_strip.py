"""The strip of frames along time: what it shows, and that places and frames are inverse."""

import numpy as np
import pytest

from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import ByteArray, FloatArray, IntArray
from scanloom.plots.frame_times import FrameTimes
from scanloom.plots.palette import class_color
from scanloom.plots.theme import DARK, LIGHT, Theme
from scanloom.plots.time_strip import TimeStrip, time_strip
from scanloom.state.frame_survey import FrameCounts, FrameStatus

SIZE = {"width_px": 800, "height_px": 64}
PERIOD_NS = 66_666_667


def regular(frames: int) -> IntArray:
    return np.arange(frames, dtype=np.int64) * PERIOD_NS + 1_700_000_000_000_000_000


def counted(
    frames: int, row: tuple[int, int, int, int], status: FrameStatus = FrameStatus.COUNTED
) -> FrameCounts:
    """All frames with the same pairs."""
    counts = np.tile(np.array(row, np.float32), (frames, 1))
    if status not in (FrameStatus.COUNTED, FrameStatus.UNTRUSTED):
        counts[:] = np.nan
    return FrameCounts(counts=counts, status=np.full(frames, status), done=frames, total=frames)


def with_frame(counts: FrameCounts, index: int, status: FrameStatus) -> FrameCounts:
    values, states = counts.counts.copy(), counts.status.copy()
    values[index], states[index] = np.nan, status
    return FrameCounts(counts=values, status=states, done=counts.done, total=counts.total)


def column_of(strip: TimeStrip, index: int) -> ByteArray:
    """(h, 3): the pixels of a frame's middle column, from above."""
    place = strip.place_of(index)
    assert place is not None
    return strip.box.view(strip.rgb)[:, round(place[0]) - strip.box.left]


def heights_px(strip: TimeStrip, index: int) -> dict[NoiseClass, int]:
    column = column_of(strip, index)
    return {kind: int((column == class_color(kind)).all(axis=1).sum()) for kind in NoiseClass}


# Places


@pytest.mark.parametrize("seed", range(8))
def test_frame_and_place_are_inverse_whatever_the_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = int(rng.integers(1, 3000))
    steps = rng.exponential(0.1, frames) * rng.choice([0.0, 1.0, 1.0, 50.0], frames)
    times_ns = (np.cumsum(steps) * 1e9).astype(np.int64)
    width_px, height_px = int(rng.integers(120, 1600)), int(rng.integers(52, 140))
    strip = time_strip(FrameTimes.of(times_ns), None, width_px=width_px, height_px=height_px)
    for index in rng.integers(0, frames, 200).tolist():
        place = strip.place_of(index)
        assert place is not None
        assert strip.frame_at(*place) == index


@pytest.mark.parametrize("frames", [1, 2, 120, 5000])
def test_every_point_of_the_strip_is_a_frame_near_it(frames: int) -> None:
    strip = time_strip(FrameTimes.of(regular(frames)), None, **SIZE)
    cell_px = strip.box.width / frames
    for x_px in np.linspace(strip.box.left - 0.49, strip.box.right - 0.51, 300):
        index = strip.frame_at(float(x_px), strip.box.top)
        assert index is not None
        place = strip.place_of(index)
        assert place is not None
        assert abs(place[0] - x_px) <= 0.5 * cell_px + 1e-6


def test_outside_of_the_strip_there_is_no_frame() -> None:
    strip = time_strip(FrameTimes.of(regular(120)), None, **SIZE)
    box = strip.box
    middle_y = box.top + 10
    for x_px, y_px in (
        (box.left - 0.6, middle_y),
        (box.right, middle_y),
        (box.left + 5, box.top - 0.6),
        (box.left + 5, box.bottom),
    ):
        assert strip.frame_at(x_px, y_px) is None
    assert strip.place_of(-1) is None
    assert strip.place_of(120) is None


def test_frames_of_one_time_have_places_of_their_own() -> None:
    times_ns = np.repeat(regular(30), 4)
    strip = time_strip(FrameTimes.of(times_ns), None, **SIZE)
    places = [strip.place_of(index) for index in range(120)]
    x_px = [place[0] for place in places if place is not None]
    assert np.all(np.diff(x_px) > 0.0)
    assert [strip.frame_at(*place) for place in places if place] == list(range(120))


def test_a_click_into_a_gap_goes_to_the_nearest_frame() -> None:
    times_ns = regular(20)
    times_ns[10:] += 5_000_000_000
    times = FrameTimes.of(times_ns)
    strip = time_strip(times, None, **SIZE)
    before, after = strip.place_of(9), strip.place_of(10)
    assert before is not None
    assert after is not None
    y_px = before[1]
    for fraction, nearest in ((0.3, 9), (0.7, 10)):
        x_px = before[0] + fraction * (after[0] - before[0])
        assert strip.frame_at(x_px, y_px) == nearest
        assert times.is_gap(strip.time_at(x_px))
    assert not times.is_gap(strip.time_at(before[0]))


# What is drawn


@pytest.mark.parametrize("theme", [LIGHT, DARK])
def test_bars_are_the_shares_of_the_pairs(theme: Theme) -> None:
    strip = time_strip(
        FrameTimes.of(regular(40)), counted(40, (60, 20, 10, 10)), theme=theme, **SIZE
    )
    height = strip.box.height
    # The scale ends at 50 %.
    expected = {NoiseClass.HOLE: 0.4, NoiseClass.BURR: 0.2, NoiseClass.CONFLICT: 0.2}
    found = heights_px(strip, 7)
    for kind, share in expected.items():
        assert found[kind] == pytest.approx(share * height, abs=1.0)
    assert found[NoiseClass.GOOD] == 0


def test_a_single_bad_pair_is_seen() -> None:
    strip = time_strip(FrameTimes.of(regular(40)), counted(40, (999, 0, 0, 1)), **SIZE)
    assert heights_px(strip, 3)[NoiseClass.CONFLICT] == 1


def test_what_is_not_known_looks_like_nothing_else() -> None:
    kinds = (
        FrameStatus.COUNTED,
        FrameStatus.UNKNOWN,
        FrameStatus.UNMATCHED,
        FrameStatus.NO_SCAN,
    )
    times = FrameTimes.of(regular(20))
    for theme in (LIGHT, DARK):
        seen = []
        for kind in kinds:
            strip = time_strip(times, counted(20, (100, 0, 0, 0), kind), theme=theme, **SIZE)
            seen.append(strip.box.view(strip.rgb)[6:].reshape(-1, 3))
        for one in range(len(kinds)):
            for other in range(one):
                differs = (seen[one] != seen[other]).any(axis=1).mean()
                assert differs > 0.1, (kinds[one], kinds[other])


def test_one_frame_that_is_not_counted_yet_is_no_zero() -> None:
    times, counts = FrameTimes.of(regular(20)), counted(20, (100, 0, 0, 0))
    zero = column_of(time_strip(times, counts, **SIZE), 5)
    assert (zero == LIGHT.background).all()
    strip = time_strip(times, with_frame(counts, 5, FrameStatus.UNKNOWN), **SIZE)
    left = round(strip.place_of(5)[0]) - strip.box.left  # type: ignore[index]  # it exists
    assert (strip.box.view(strip.rgb)[:, left - 2 : left + 3] != LIGHT.background).any()
    assert (column_of(strip, 8) == LIGHT.background).all()


def test_missing_images_and_missing_scans_are_hatched() -> None:
    times_ns = regular(20)
    times_ns[10:] += 3_000_000_000
    counts = with_frame(counted(20, (100, 0, 0, 0)), 3, FrameStatus.NO_SCAN)
    strip = time_strip(FrameTimes.of(times_ns), counts, **SIZE)
    assert set(map(tuple, column_of(strip, 3).tolist())) <= set(LIGHT.hatch)
    before, after = strip.place_of(9), strip.place_of(10)
    assert before is not None
    assert after is not None
    middle = round(0.5 * (before[0] + after[0])) - strip.box.left
    column = strip.box.view(strip.rgb)[:, middle]
    assert set(map(tuple, column.tolist())) <= set(LIGHT.hatch)


def test_an_untrusted_frame_is_marked_above_its_bar() -> None:
    times = FrameTimes.of(regular(20))
    trusted = time_strip(times, counted(20, (50, 30, 10, 10)), **SIZE)
    strip = time_strip(times, counted(20, (50, 30, 10, 10), FrameStatus.UNTRUSTED), **SIZE)
    assert tuple(column_of(strip, 4)[0]) == LIGHT.ink
    assert tuple(column_of(trusted, 4)[0]) != LIGHT.ink
    assert heights_px(strip, 4)[NoiseClass.CONFLICT] == heights_px(trusted, 4)[NoiseClass.CONFLICT]


def test_many_frames_of_a_column_are_one_share() -> None:
    frames = 8000
    counts = counted(frames, (90, 0, 10, 0))
    values = counts.counts.copy()
    # Every other frame has none: on the average 5 %.
    values[::2] = (100, 0, 0, 0)
    strip = time_strip(
        FrameTimes.of(regular(frames)),
        FrameCounts(counts=values, status=counts.status, done=1, total=1),
        **SIZE,
    )
    assert heights_px(strip, 4000)[NoiseClass.BURR] == pytest.approx(
        0.05 / 0.1 * strip.box.height, abs=1.0
    )


@pytest.mark.parametrize("width_px", [100, 340, 800, 1900])
def test_it_is_drawn_at_any_width(width_px: int) -> None:
    strip = time_strip(
        FrameTimes.of(regular(50)), counted(50, (5, 1, 1, 1)), width_px=width_px, height_px=64
    )
    assert strip.rgb.shape == (64, width_px, 3)


def test_a_picture_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="px to draw in"):
        time_strip(FrameTimes.of(regular(3)), None, width_px=40, height_px=30)


def test_cells_lie_beside_each_other_in_order() -> None:
    times_ns = np.sort(np.random.default_rng(3).integers(0, 10**11, 500))
    times = FrameTimes.of(times_ns)
    left_s: FloatArray = times.left_s
    assert np.all(times.right_s > left_s)
    assert np.all(left_s[1:] - times.right_s[:-1] > -1e-9)
    assert np.all((left_s <= times.times_s + 1e-9) & (times.times_s <= times.right_s + 1e-9))
