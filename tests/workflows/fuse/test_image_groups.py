"""Images of several cameras put together as they come, and the scan that they share."""

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.time import ScanWindow, TimeSettings
from fusion_core.model.conventions import NS_PER_MS
from fusion_core.workflows.fuse.pairing import (
    SCANS_KEPT,
    ImageGrouper,
    PairedImage,
    share_scan,
)

MAX_GAP_MS = 60.0


def entry(camera: int, at_ms: float, *, scan_ms: float | None = 0.0) -> PairedImage:
    """An image, paired with a scan where ``scan_ms`` is given."""
    stamp_ns = round(at_ms * NS_PER_MS)
    image: Any = SimpleNamespace(stamp_ns=stamp_ns)
    if scan_ms is None:
        return PairedImage(camera=camera, image=image, window=None, gap_ns=0)
    scan: Any = SimpleNamespace(stamp_ns=round(scan_ms * NS_PER_MS))
    window = ScanWindow(before=None, scan=scan, after=None)
    return PairedImage(camera=camera, image=image, window=window, gap_ns=stamp_ns - scan.stamp_ns)


def groups_of(entries, cameras: int):
    grouper = ImageGrouper(cameras, MAX_GAP_MS)
    groups = [group for own in entries for group in grouper.push(own)]
    return [*groups, *grouper.flush()]


def shown(groups):
    return [[(own.camera, own.image.stamp_ns / NS_PER_MS) for own in group] for group in groups]


def test_images_of_one_instant_make_a_group_in_the_order_of_the_cameras() -> None:
    entries = [entry(2, 14), entry(0, 0), entry(1, 7), entry(1, 107), entry(0, 100), entry(2, 114)]
    assert shown(groups_of(entries, 3)) == [
        [(0, 0), (1, 7), (2, 14)],
        [(0, 100), (1, 107), (2, 114)],
    ]


def test_a_missing_image_leaves_its_partners_alone_and_the_next_group_whole() -> None:
    entries = [entry(0, 0), entry(2, 14), entry(0, 100), entry(1, 107), entry(2, 114)]
    assert shown(groups_of(entries, 3)) == [
        [(0, 0)],
        [(2, 14)],
        [(0, 100), (1, 107), (2, 114)],
    ]


def test_images_too_far_apart_are_no_group() -> None:
    entries = [entry(0, 0), entry(1, 70), entry(0, 200), entry(1, 270)]
    assert [len(group) for group in groups_of(entries, 2)] == [1, 1, 1, 1]


def test_an_image_leaves_as_soon_as_its_partners_are_too_late() -> None:
    grouper = ImageGrouper(3, MAX_GAP_MS)
    assert list(grouper.push(entry(0, 0))) == []
    assert list(grouper.push(entry(1, 60))) == []
    assert shown(grouper.push(entry(2, 61))) == [[(0, 0)]]


def test_an_image_waits_no_longer_than_its_scan() -> None:
    grouper = ImageGrouper(2, MAX_GAP_MS)
    assert list(grouper.push(entry(0, 0))) == []
    released = [group for _ in range(SCANS_KEPT - 1) for group in grouper.pass_scan()]
    assert shown(released) == [[(0, 0)]]
    assert list(grouper.flush()) == []


@given(
    st.lists(st.tuples(st.integers(0, 2), st.integers(0, 500)), max_size=30, unique=True),
    st.integers(3, 4),
)
def test_every_image_comes_out_once_whatever_the_order(places, cameras) -> None:
    groups = groups_of([entry(camera, at_ms) for camera, at_ms in places], cameras)
    out = [place for group in shown(groups) for place in group]
    assert sorted(out) == sorted(places)
    for group in shown(groups):
        stamps = [at_ms for _, at_ms in group]
        if len(group) > 1:
            assert [camera for camera, _ in group] == list(range(cameras))
            assert max(stamps) - min(stamps) <= MAX_GAP_MS


def test_a_panorama_has_the_scan_nearest_to_its_middle() -> None:
    """Camera stamps 20 ms late: the images are of -15, 15 and 45 ms."""
    late_ms = 20.0
    group = [entry(0, 5, scan_ms=-60), entry(1, 35, scan_ms=0), entry(2, 65, scan_ms=100)]
    group = [
        PairedImage(
            camera=own.camera,
            image=own.image,
            window=own.window,
            gap_ns=own.gap_ns - round(late_ms * NS_PER_MS),
        )
        for own in group
    ]
    shared = share_scan(group, TimeSettings(max_gap_ms=MAX_GAP_MS))
    assert shared is not None
    assert {own.window.scan.stamp_ns for own in shared} == {0}
    assert [own.gap_ns / NS_PER_MS for own in shared] == [-15.0, 15.0, 45.0]


def test_an_image_without_a_scan_of_its_own_takes_the_panoramas() -> None:
    shared = share_scan(
        [entry(0, 50), entry(1, 64, scan_ms=None)], TimeSettings(max_gap_ms=MAX_GAP_MS)
    )
    assert shared is not None
    assert [own.gap_ns / NS_PER_MS for own in shared] == [50.0, 64.0]


@pytest.mark.parametrize("scan_ms", [None, 0.0])
def test_a_panorama_too_far_from_any_scan_has_none(scan_ms) -> None:
    group = [entry(0, 58, scan_ms=scan_ms), entry(1, 66, scan_ms=None)]
    assert share_scan(group, TimeSettings(max_gap_ms=MAX_GAP_MS)) is None
