"""What a camera looks at over each distance, by projecting points, and what its beams free."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.mapping.height_bands import BeamHeights, ImageEdges, seen_bands
from fusion_core.mapping.rays import trace_ray
from fusion_core.mapping.virtual_scan import (
    VirtualScanSettings,
    make_camera_scan,
    merge_camera_cloud,
)
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import CameraIntrinsics, LaserScan

INTRINSICS = CameraIntrinsics(
    width=64, height=48, fx=57.0, fy=57.0, cx=31.5, cy=23.5, distortion=(0.0,) * 5
)
SETTINGS = VirtualScanSettings()
ANYWHERE = ((0.0, 0.0), (-np.inf, 0.0)), ((0.55, 0.0), (np.inf, 0.0))


def mounted(pitch_deg: float, roll_deg: float = 0.0, yaw_deg: float = 0.0) -> np.ndarray:
    """(3, 4) a camera 0.4 m above the floor, 0.1 m ahead, 0.2 m to the left."""
    body = rotation_from_yaw_pitch_roll(*np.radians([yaw_deg, pitch_deg, roll_deg]))
    return np.column_stack([body @ R_BODY_OPTICAL, [0.1, 0.2, 0.4]])


@given(
    st.floats(-30.0, 30.0),
    st.floats(-10.0, 10.0),
    st.floats(-40.0, 40.0),
    st.floats(-0.3, 0.3),
    st.floats(0.8, 6.0),
    st.floats(0.0, 1.5),
)
def test_a_point_is_in_the_band_where_its_row_is_in_the_image(
    pitch, roll, yaw, aside, distance, height
):
    T = mounted(pitch, roll, yaw)
    azimuth = np.radians(yaw) + aside
    lower, upper = seen_bands(
        [ImageEdges.of(INTRINSICS, T)],
        np.array([azimuth]),
        lowest=(-np.inf, 0.0),
        highest_m=np.inf,
    )
    low, high = (
        choose(bound[0, :, 0] + bound[0, :, 1] * distance)
        for choose, bound in ((max, lower), (min, upper))
    )
    point = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    _, y, z = T[:, :3].T @ (point - T[:, 3])
    row = INTRINSICS.cy + INTRINSICS.fy * y / z
    if z < 0.1 or min(abs(row + 0.5), abs(row - 47.5)) < 1e-6:
        return
    assert (low <= height <= high) == (-0.5 < row < 47.5)


def test_each_direction_is_seen_by_the_camera_that_looks_there():
    edges = [
        ImageEdges.of(INTRINSICS, mounted(pitch, yaw_deg=yaw))
        for pitch, yaw in ((20, 50), (-20, -50))
    ]
    azimuths = np.radians([60.0, 10.0, -10.0, -60.0])
    both = seen_bands(edges, azimuths, lowest=(0.03, 0.01), highest_m=0.55)
    for own, chosen in zip(edges, (slice(0, 2), slice(2, 4)), strict=True):
        alone = seen_bands([own], azimuths, lowest=(0.03, 0.01), highest_m=0.55)
        for found, expected in zip(both, alone, strict=True):
            np.testing.assert_array_equal(found[chosen], expected[chosen])
    np.testing.assert_array_equal(both[0][:, 0], [[0.03, 0.01]] * 4)
    np.testing.assert_array_equal(both[1][:, 0], [[0.55, 0.0]] * 4)


def by_rule(scans, settings):
    """Each cell's log odds, one scan, one beam and one cell after the other."""
    hit, miss = math.log(0.7 / 0.3), math.log(0.4 / 0.6)
    lowest, highest = math.log(0.1192 / 0.8808), math.log(0.971 / 0.029)
    side = settings.resolution_m
    log_odds: dict[tuple[int, int], float] = {}
    seen: dict[tuple[int, int], list[float]] = {}
    buffer = np.empty((1000, 2), dtype=np.int64)
    for (x, y, yaw), angles, ranges, heights in scans:
        touched = set()
        ends = []
        for ranges_behind, surfaces in zip(
            heights.behind_m, heights.behind_surfaces_m, strict=True
        ):
            for angle, reached, surface in zip(angles, ranges_behind, surfaces, strict=True):
                if math.isnan(reached):
                    continue
                cell = (
                    math.floor((y + reached * math.sin(angle + yaw)) / side),
                    math.floor((x + reached * math.cos(angle + yaw)) / side),
                )
                seen.setdefault(cell, []).extend(surface.tolist())
                if cell not in touched:
                    touched.add(cell)
                    log_odds[cell] = min(log_odds.get(cell, 0.0) + hit, highest)
        for beam, (angle, reached) in enumerate(zip(angles, ranges, strict=True)):
            end = (
                (x + reached * math.cos(angle + yaw)) / side,
                (y + reached * math.sin(angle + yaw)) / side,
            )
            ends.append(end)
            cell = math.floor(end[1]), math.floor(end[0])
            seen.setdefault(cell, []).extend(heights.surfaces_m[beam].tolist())
            if cell not in touched:
                touched.add(cell)
                log_odds[cell] = min(log_odds.get(cell, 0.0) + hit, highest)
        for beam, end in enumerate(ends):
            count = trace_ray(x / side, y / side, *end, buffer)
            for row, column in buffer[: count - 1].tolist():
                away = side * math.hypot(column + 0.5 - x / side, row + 0.5 - y / side)
                low = max(a + b * away for a, b in heights.lower[beam])
                high = min(a + b * away for a, b in heights.upper[beam])
                own = seen.get((row, column))
                looks_there = own is None or not (max(own) < low or min(own) > high)
                if looks_there and (row, column) not in touched:
                    touched.add((row, column))
                    log_odds[row, column] = max(log_odds.get((row, column), 0.0) + miss, lowest)
    return log_odds


@pytest.mark.parametrize("seed", range(6))
def test_a_grid_by_beams_with_heights_is_that_of_the_rule(seed):
    rng = np.random.default_rng(seed)
    settings = GridSettings(resolution_m=0.125)
    builder, scans = GridBuilder(settings), []
    for _ in range(12):
        pose, angles = rng.uniform(-1.0, 1.0, 3), np.linspace(-1.0, 1.0, 9)
        ranges = rng.uniform(0.3, 2.0, 9)
        behind = ranges + rng.uniform(0.2, 1.0, (2, 9))
        behind[rng.random((2, 9)) < 0.5] = np.nan
        behind_surfaces = np.sort(rng.uniform(0.0, 0.6, (2, 9, 2)), axis=2)
        surfaces = np.sort(rng.uniform(0.0, 0.6, (9, 2)), axis=1)
        lower = np.stack([rng.uniform(-0.2, 0.3, (9, 2)), rng.uniform(-0.1, 0.1, (9, 2))], axis=2)
        upper = np.stack([rng.uniform(0.2, 0.7, (9, 2)), rng.uniform(-0.1, 0.1, (9, 2))], axis=2)
        heights = BeamHeights(
            surfaces_m=surfaces,
            lower=lower,
            upper=upper,
            behind_m=behind,
            behind_surfaces_m=behind_surfaces,
        )
        builder.add_scan(pose, angles, ranges, 4.0, heights)
        scans.append((pose, angles, ranges, heights))
    grid, expected = builder.build(), by_rule(scans, settings)
    first_row, first_column = (round(value / 0.125) for value in grid.origin_m[::-1])
    found = {
        (first_row + int(r), first_column + int(c)): grid.log_odds[r, c]
        for r, c in zip(*np.nonzero(grid.known), strict=True)
    }
    assert found.keys() == expected.keys()
    np.testing.assert_allclose([found[k] for k in found], [expected[k] for k in found], atol=1e-9)


def test_a_seat_above_the_picture_stays_and_a_ghost_in_it_goes():
    def one_beam(range_m: float, low: float, high: float, top_m: float) -> tuple:
        heights = BeamHeights(
            surfaces_m=np.array([[low, high]]),
            lower=np.array([ANYWHERE[0]]),
            upper=np.array([[(0.55, 0.0), (top_m, 0.0)]]),
            behind_m=np.zeros((0, 1)),
            behind_surfaces_m=np.zeros((0, 1, 2)),
        )
        return np.zeros(3), np.zeros(1), np.array([range_m]), 5.0, heights

    for thing, stays in (((0.44, 0.5), True), ((0.2, 0.5), False)):
        builder = GridBuilder(GridSettings(resolution_m=0.1))
        builder.add_scan(*one_beam(1.05, *thing, np.inf))
        for _ in range(5):
            builder.add_scan(*one_beam(2.05, 0.1, 0.5, 0.4))
        row = np.flatnonzero(builder.build().log_odds[0] > 0.0)
        assert (10 in row) == stays
        assert 20 in row


def test_virtual_scans_know_the_heights_of_what_ends_their_beams():
    def post(x: float, low: float, high: float) -> np.ndarray:
        z = np.linspace(low, high, 8)
        y = np.linspace(-0.1, 0.1, 9)
        return np.array([(x, b, a) for a in z for b in y])

    edges = [ImageEdges.of(INTRINSICS, mounted(10.0))]
    cloud = np.concatenate([post(2.0, 0.42, 0.5), post(3.0, 0.05, 0.5)])
    scan = make_camera_scan(
        cloud, SETTINGS, stamp_ns=0, received_ns=0, frame_id="laser", cameras=edges
    )
    ahead = np.argmin(np.abs(scan.angles_rad))
    assert scan.heights is not None
    assert scan.ranges_m[ahead] == pytest.approx(2.0, abs=0.01)
    np.testing.assert_allclose(scan.heights.surfaces_m[ahead], [0.42, 0.5], atol=0.011)
    assert np.isnan(scan.heights.surfaces_m[0]).all()
    # Behind it, seen below and over it, the other post, and nothing more.
    np.testing.assert_allclose(scan.heights.behind_m[:, ahead], [3.0, np.nan], atol=0.01)
    np.testing.assert_allclose(scan.heights.behind_surfaces_m[0, ahead], [0.05, 0.5], atol=0.011)
    # The LiDAR passes below at 0.3 m and meets what stands behind.
    lidar = LaserScan(
        stamp_ns=0,
        received_ns=0,
        frame_id="laser",
        angle_min_rad=-0.5,
        angle_increment_rad=0.02,
        range_min_m=0.1,
        range_max_m=10.0,
        ranges_m=np.full(51, 3.0),
    )
    merged = merge_camera_cloud(lidar, cloud, SETTINGS, 0.3, edges)
    assert merged.heights is not None
    assert merged.ranges_m[25] == pytest.approx(2.0, abs=0.01)
    np.testing.assert_allclose(merged.heights.surfaces_m[25], [0.42, 0.5], atol=0.011)
    # Where the LiDAR's return stays, it was at its own height too.
    far = merge_camera_cloud(lidar, post(3.0, 0.05, 0.2), SETTINGS, 0.3, edges)
    assert far.heights is not None
    np.testing.assert_allclose(far.heights.surfaces_m[25], [0.05, 0.3], atol=0.011)
    # Without the camera's edges no heights are known.
    assert merge_camera_cloud(lidar, cloud, SETTINGS, 0.3).heights is None


def test_a_scan_whose_numbers_are_counted_from_elsewhere_has_no_heights():
    cloud = np.array([(2.0, y, z) for y in np.linspace(-0.2, 0.2, 21) for z in (0.1, 0.2, 0.3)])
    scan = make_camera_scan(
        cloud,
        SETTINGS,
        stamp_ns=0,
        received_ns=0,
        frame_id="laser",
        cameras=[ImageEdges.of(INTRINSICS, mounted(10.0))],
    )
    assert scan.with_seam_at(0).heights is scan.heights
    turned = scan.with_seam_at(100)
    assert turned.heights is None
    np.testing.assert_array_equal(turned.ranges_m[:100], scan.ranges_m[100:200])
