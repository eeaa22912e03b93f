"""The LiDAR's points in an image: against the formula, point by point."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.rig import Camera, Mount
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.workflows.fuse.curve_in_image import SeenScan, curve_agreement, curve_in_image

WIDTH, HEIGHT = 64, 48
INTRINSICS = CameraIntrinsics(width=WIDTH, height=HEIGHT, fx=60.0, fy=55.0, cx=31.2, cy=24.1)
CAMERA = Camera(
    topic="/depth",
    intrinsics=INTRINSICS,
    T_rig_camera=make_transform(R_BODY_OPTICAL, np.zeros(3)),
)
SETTINGS = MountSettings()


def points_by_formula(seen: SeenScan, mount: Mount) -> dict[int, tuple[float, float, float]]:
    """(u, v, z) of each point that is in the image: eq. by eq."""
    found = {}
    drive_x, drive_y, turned = seen.moved
    yaw = turned + mount.yaw_rad
    at = rotation_from_yaw_pitch_roll(turned, 0.0, 0.0) @ np.array(
        [mount.forward_m, mount.left_m, mount.delta_z_m]
    ) + [drive_x, drive_y, 0.0]
    for number, point in enumerate(seen.points_m):
        x, y, up = point - at
        ahead = np.cos(yaw) * x + np.sin(yaw) * y
        left = -np.sin(yaw) * x + np.cos(yaw) * y
        if ahead <= 0.05:
            continue
        u, v = 31.2 - 60.0 * left / ahead, 24.1 - 55.0 * up / ahead
        if -0.5 <= u < WIDTH - 0.5 and -0.5 <= v < HEIGHT - 0.5:
            found[number] = (u, v, ahead)
    return found


@given(
    yaw=st.floats(-0.6, 0.6),
    moved=st.tuples(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.2, 0.2)),
    place=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    seed=st.integers(0, 2**16),
)
def test_pixels_and_differences_are_those_of_the_formula(yaw, moved, place, seed) -> None:
    rng = np.random.default_rng(seed)
    azimuth = rng.uniform(-1.2, 1.2, 60)
    range_m = rng.uniform(0.2, 5.0, 60)
    depth_m = rng.uniform(0.5, 5.0, (HEIGHT, WIDTH)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.2] = np.nan
    points_m = np.stack([range_m * np.cos(azimuth), range_m * np.sin(azimuth), 0 * range_m], axis=1)
    seen = SeenScan(camera=0, points_m=points_m, depth_m=depth_m, moved=np.array(moved))
    mount = Mount(yaw_rad=yaw, forward_m=place[0], left_m=place[1], delta_z_m=place[2])
    curve = curve_in_image(seen, CAMERA, mount, SETTINGS)
    expected = points_by_formula(seen, mount)
    assert len(curve.range_m) == len(expected)
    agreeing = 0
    for place_in, (number, (u, v, z)) in enumerate(expected.items()):
        np.testing.assert_allclose(curve.pixels[place_in], (u, v), atol=1e-9)
        assert curve.range_m[place_in] == pytest.approx(range_m[number])
        depth = float(depth_m[round(v), round(u)])
        np.testing.assert_allclose(curve.difference_m[place_in], depth - z, atol=1e-6)
        agrees = abs(depth - z) <= 0.03 + 0.02 * range_m[number]
        assert curve.agrees[place_in] == agrees
        agreeing += agrees
    summary = curve_agreement([curve, curve])
    assert (summary.frames, summary.in_image) == (2, 2 * len(expected))
    assert summary.agreeing == 2 * agreeing
    known = [abs(d) for d in curve.difference_m if np.isfinite(d)]
    assert summary.on_depth == 2 * len(known)
    if known:
        assert summary.median_m == pytest.approx(np.median(known))
        assert summary.fraction == pytest.approx(agreeing / len(known))


def test_nothing_seen_is_no_number() -> None:
    empty = curve_agreement([])
    assert (empty.frames, empty.on_depth) == (0, 0)
    assert np.isnan(empty.fraction)
    assert np.isnan(empty.median_m)
