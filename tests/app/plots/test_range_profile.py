"""The range profile: both sensors at their azimuths, gaps as gaps, and beams that can be picked."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.classes import NoiseClass
from fusion_core.model.sensors import LaserScan
from fusion_core.workflows.fuse.frame import FusedFrame
from fusion_core.workflows.fuse.frame_match import FrameMatch
from scanloom.page.layout import page_sizes
from scanloom.plots.palette import Color, class_color, color_of
from scanloom.plots.range_profile import RangeProfile, range_profile, scan_profile
from scanloom.plots.theme import DARK

NAN = float("nan")


def match(
    lidar_m: np.ndarray, camera_m: np.ndarray, left_deg: float = 30.0, step_deg: float = 1.0
) -> FrameMatch:
    """Beams of a scan that turns to the left: the last is the leftmost."""
    count = len(lidar_m)
    azimuth_rad = np.deg2rad(left_deg - step_deg * np.arange(count)[::-1])
    pairs = SimpleNamespace(
        beam=100 + np.arange(count),
        azimuth_rad=azimuth_rad,
        lidar_range_m=np.asarray(lidar_m, dtype=np.float64),
        depth_as_range_m=np.asarray(camera_m, dtype=np.float64),
    )
    return cast(FrameMatch, SimpleNamespace(correspondence=pairs))


def fused(matched: FrameMatch, classes: np.ndarray, repaired_m: np.ndarray) -> FusedFrame:
    parts: dict[str, Any] = {
        "match": matched,
        "classes": SimpleNamespace(lidar_class=classes),
        "repair": SimpleNamespace(lidar_range_m=repaired_m),
    }
    frame = object.__new__(FusedFrame)
    for name, part in parts.items():
        object.__setattr__(frame, name, part)
    return frame


def scan(ranges_m: np.ndarray, increment_deg: float = 1.0) -> LaserScan:
    return LaserScan(
        stamp_ns=0,
        received_ns=None,
        frame_id="laser",
        angle_min_rad=np.deg2rad(-0.5 * increment_deg * (len(ranges_m) - 1)),
        angle_increment_rad=np.deg2rad(increment_deg),
        range_min_m=0.1,
        range_max_m=30.0,
        ranges_m=np.asarray(ranges_m, dtype=np.float64),
    )


def drawn(frame: FusedFrame | FrameMatch, **kwargs: Any) -> RangeProfile:
    return range_profile(frame, width_px=800, height_px=190, **kwargs)


def is_like(rgb: np.ndarray, color: Color) -> np.ndarray:
    """(...) bool: pixels of nearly a colour; thin lines are smoothed."""
    return (np.abs(rgb.astype(np.int64) - color) < 40).all(axis=-1)


def columns_of(picture: RangeProfile, color: Color) -> np.ndarray:
    """Columns of the axes in which a colour is seen."""
    return np.flatnonzero(is_like(picture.axes.box.view(picture.rgb), color).any(axis=0))


def test_left_is_left_and_far_is_up() -> None:
    # Near on the left, far on the right.
    near_left = np.where(np.arange(61) > 30, 1.5, 3.5)
    picture = drawn(match(near_left, np.full(61, NAN)))
    inside = picture.axes.box.view(picture.rgb)
    rows, columns = np.nonzero(is_like(inside, color_of("lidar")))
    middle = inside.shape[1] / 2
    assert rows[columns < middle - 10].min() > rows[columns > middle + 10].max()
    left, right = (picture.place_of(beam) for beam in (160, 100))
    assert left is not None
    assert right is not None
    assert left[0] < right[0]
    assert left[1] > right[1]


@pytest.mark.parametrize("is_large", [False, True])
@pytest.mark.parametrize(
    "window_px", [(1600, 900), (1280, 720), (1180, 720), (800, 600), (390, 844)]
)
def test_each_screen_has_room_for_the_longest_legend(
    window_px: tuple[int, int], is_large: bool
) -> None:
    width_px, height_px = page_sizes(*window_px, is_large=is_large).profile_px
    ranges_m = np.full(61, 2.5)
    classes = np.full(61, NoiseClass.HOLE)
    frame = fused(match(ranges_m, ranges_m), classes, ranges_m)
    picture = range_profile(frame, width_px=width_px, height_px=height_px)
    assert picture.axes.box.height >= 25


def test_where_both_agree_both_colours_are_seen() -> None:
    picture = drawn(match(np.full(61, 2.5), np.full(61, 2.5)))
    for name in ("lidar", "depth"):
        color = color_of("lidar" if name == "lidar" else "depth")
        assert len(columns_of(picture, color)) > 0.9 * picture.axes.box.width - 20


def test_a_gap_stays_a_gap_and_a_jump_is_no_line() -> None:
    lidar_m = np.full(61, 2.5)
    lidar_m[20:40] = NAN
    picture = drawn(match(lidar_m, np.full(61, NAN)))
    columns = columns_of(picture, color_of("lidar"))
    places = [picture.axes.to_pixel(30.0 - 60 + beam, 0.0)[0] for beam in (39, 20)]
    in_gap = [place - picture.axes.box.left for place in places]
    assert not ((columns > in_gap[0] + 3) & (columns < in_gap[1] - 3)).any()
    edge = drawn(match(np.where(np.arange(61) > 30, 1.5, 3.5), np.full(61, NAN)))
    y = round(edge.axes.to_pixel(0.0, 2.5)[1])
    assert not is_like(edge.rgb[y], color_of("lidar")).any()


def test_classes_have_their_marks_in_the_lane_and_repairs_theirs_at_their_range() -> None:
    lidar_m = np.full(61, 2.5)
    lidar_m[10] = NAN
    classes = np.zeros(61, dtype=np.int64)
    classes[[10, 30, 50]] = [NoiseClass.HOLE, NoiseClass.BURR, NoiseClass.CONFLICT]
    repaired_m = lidar_m.copy()
    repaired_m[10] = 1.5
    matched = match(lidar_m, np.full(61, 2.5))
    picture, plain = drawn(fused(matched, classes, repaired_m)), drawn(matched)
    for place in (10, 30, 50):
        color = class_color(NoiseClass(classes[place]))
        x = picture.axes.to_pixel(float(picture.azimuth_deg[60 - place]), 0.0)[0]
        # Exactly: where orange lies on blue, smoothed pixels are of any colour between.
        marked, unmarked = (
            np.flatnonzero((p.rgb[p.axes.box.top :] == color).all(axis=2).any(axis=0))
            for p in (picture, plain)
        )
        assert np.abs(marked - x).max() <= 6
        assert marked.size
        assert not unmarked.size
    place_px = picture.place_of(110)
    assert place_px is not None
    around = picture.rgb[round(place_px[1]), round(place_px[0]) - 5 : round(place_px[0]) + 6]
    assert (around == 255).all(axis=1).any()
    assert is_like(around, color_of("lidar")).any()


@given(
    count=st.integers(1, 400),
    step_deg=st.floats(0.05, 0.8),
    left_deg=st.floats(-170.0, 300.0),
    data=st.data(),
)
def test_place_and_beam_undo_each_other(
    count: int, step_deg: float, left_deg: float, data: st.DataObject
) -> None:
    lidar_m = np.random.default_rng(count).uniform(0.5, 9.0, count)
    lidar_m[::7] = NAN
    picture = drawn(match(lidar_m, np.full(count, NAN), left_deg, step_deg))
    beam = 100 + data.draw(st.integers(0, count - 1))
    place = picture.place_of(beam)
    assert place is not None
    assert picture.beam_at(*place) == beam
    assert picture.place_of(99) is None
    assert picture.place_of(100 + count) is None
    box = picture.axes.box
    assert picture.beam_at(box.left - 1, box.top + 5) is None
    assert picture.beam_at(box.left + 5, box.bottom) is None


def test_a_scan_alone_shows_all_its_beams() -> None:
    ranges_m = np.where(np.arange(360) % 5 == 0, NAN, 4.0)
    picture = scan_profile(scan(ranges_m), width_px=800, height_px=190, beam=7, theme=DARK)
    assert picture.beam.size == 360
    assert picture.rgb[1, 1].tolist() == list(DARK.background)
    place = picture.place_of(7)
    assert place is not None
    # The selected beam's line.
    assert picture.rgb[picture.axes.box.top + 3, round(place[0])].tolist() == list(DARK.ink)
    assert not columns_of(picture, color_of("depth")).size


@pytest.mark.parametrize(
    "lidar_m", [np.empty(0), np.array([NAN]), np.array([2.0]), np.full(30, NAN)]
)
def test_profiles_of_little_are_drawn(lidar_m: np.ndarray) -> None:
    picture = drawn(match(lidar_m, lidar_m.copy()))
    assert picture.rgb.shape == (190, 800, 3)
    if not lidar_m.size:
        box = picture.axes.box
        assert picture.beam_at(box.left + 3, box.top + 3) is None


def test_a_single_far_return_leaves_the_scale() -> None:
    lidar_m = np.full(61, 2.5)
    lidar_m[30] = 29.0
    picture = drawn(match(lidar_m, np.full(61, NAN)))
    assert picture.axes.y_limits[1] == 4.0
    place = picture.place_of(130)
    assert place is not None
    assert place[1] == picture.axes.box.top


def test_too_small_a_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="px"):
        range_profile(match(np.ones(5), np.ones(5)), width_px=40, height_px=190)
