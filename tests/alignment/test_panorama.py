"""A rig of cameras in a room of boxes: the panorama against closed-form ranges."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.alignment.curves import CurveSampling, SamplingSettings, offset_of_yaw
from fusion_core.alignment.panorama import Panorama, PastedPanorama, are_side_by_side
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.rig import Camera
from fusion_core.model.sensors import CameraIntrinsics

LENS = CameraIntrinsics(width=120, height=60, fx=100.0, fy=100.0, cx=59.5, cy=29.5)
SETTINGS = SamplingSettings(step_deg=1.0)
RIG_IN_ROOM = np.array([2.6, 2.1, 1.2])
HALF_STEP = 0.5 * np.deg2rad(1.0)

# Yaw, pitch in degrees, and position in the rig: side by side with baselines of up to 12 cm.
POSES = {
    "three": [(50, 0, (0.0, 0.1, 0.0)), (0, 0, (0.04, 0, 0.02)), (-50, 0, (-0.03, -0.1, 0.0))],
    "four": [
        (0, 0, (0.05, 0.0, 0.0)),
        (84, -4, (0.0, 0.12, 0.03)),
        (-42, 3, (0.02, -0.06, 0.0)),
        (42, 5, (0.02, 0.06, -0.05)),
    ],
}


def camera_at(yaw_deg: float, pitch_deg: float, position: tuple[float, float, float]) -> Camera:
    turn = rotation_from_yaw_pitch_roll(*np.deg2rad([yaw_deg, pitch_deg]), 0.0)
    return Camera(
        topic=f"depth {yaw_deg}",
        intrinsics=LENS,
        T_rig_camera=make_transform(turn @ R_BODY_OPTICAL, np.array(position, dtype=np.float64)),
    )


def seen(room, camera: Camera) -> np.ndarray:
    T_room_rig = make_transform(np.eye(3), RIG_IN_ROOM)
    return room.depth_m(T_room_rig @ camera.T_rig_camera, LENS).astype(np.float32)


def walls_m(azimuths: np.ndarray) -> np.ndarray:
    """Horizontal range from the rig's origin to the walls of the 6 m by 5 m room."""
    x, y = RIG_IN_ROOM[:2]
    with np.errstate(divide="ignore"):
        to_x = np.where(np.cos(azimuths) > 0, 6.0 - x, -x) / np.cos(azimuths)
        to_y = np.where(np.sin(azimuths) > 0, 5.0 - y, -y) / np.sin(azimuths)
    return np.minimum(to_x, to_y)


def expected_bounds(values: Callable[[np.ndarray], np.ndarray], azimuths: np.ndarray):
    """Lowest and highest of a closed form within each sample's interval of azimuth."""
    around = azimuths + np.linspace(-HALF_STEP, HALF_STEP, 21)[:, np.newaxis]
    return values(around).min(axis=0), values(around).max(axis=0)


@pytest.mark.parametrize("name", POSES)
def test_walls_lie_at_their_azimuth_and_range_from_the_rig(name: str, box_room) -> None:
    cameras = [camera_at(*pose) for pose in POSES[name]]
    room = box_room()
    panorama = Panorama(cameras, SETTINGS)
    samples_m = panorama.samples_m([seen(room, camera) for camera in cameras])
    sampling = panorama.sampling
    azimuths = sampling.left_rad - sampling.step_rad * np.arange(sampling.columns.size)
    assert samples_m.shape == (LENS.height, azimuths.size)
    low, high = expected_bounds(walls_m, azimuths)
    # Rows near the horizon see walls only, whatever the small pitch of a camera.
    middle = samples_m[27:33]
    assert np.isfinite(middle).mean() > 0.97
    near, far = middle >= low - 0.001, middle <= high + 0.001
    assert (near & far)[np.isfinite(middle)].all()


def turned_rig(cameras: list[Camera], turn_rad: float) -> list[Camera]:
    """The same rig on a frame from which it looks farther to the left."""
    turn = make_transform(rotation_from_yaw_pitch_roll(turn_rad, 0.0, 0.0), np.zeros(3))
    return [replace(camera, T_rig_camera=turn @ camera.T_rig_camera) for camera in cameras]


# The rear cameras of a rig stand on either side of 180 degrees.
ANY_TURN_DEG = st.floats(-180.0, 180.0) | st.floats(130.0, 230.0)
# Of a full circle, one sample a degree.
CIRCLE = CurveSampling(
    beams=np.arange(480), left_rad=3.1, step_rad=float(np.deg2rad(1.0)), turn_samples=360.0
)


@pytest.mark.parametrize("name", POSES)
@given(turn_deg=ANY_TURN_DEG)
def test_a_joined_panorama_has_no_tear(name: str, turn_deg: float) -> None:
    """Against the rig that looks ahead."""
    cameras = [camera_at(*pose) for pose in POSES[name]]
    turn_rad = float(np.deg2rad(turn_deg))
    plain, turned = Panorama(cameras, SETTINGS), Panorama(turned_rig(cameras, turn_rad), SETTINGS)
    assert [own.topic for own in turned.from_left] == [own.topic for own in plain.from_left]
    count = plain.sampling.columns.size
    assert turned.sampling.columns.size == count
    u = offset_of_yaw(0.4, CIRCLE, plain.sampling)
    turned_u = offset_of_yaw(0.4 - turn_rad, CIRCLE, turned.sampling)
    assert (turned_u - u + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6)
    depths_m = [
        np.linspace(1.0 + index, 1.2 + index, LENS.width * LENS.height)
        .reshape(LENS.height, LENS.width)
        .astype(np.float32)
        for index in range(len(cameras))
    ]
    one, other = plain.samples_m(depths_m), turned.samples_m(depths_m)
    # A pixel on the border of two samples may fall to either.
    assert (np.isfinite(one) == np.isfinite(other)).mean() > 0.99
    both = np.isfinite(one) & np.isfinite(other)
    assert (np.abs(one - other)[both] < 1e-9).mean() > 0.98


@pytest.mark.parametrize("by", ["angle", "index"])
@given(turn_deg=ANY_TURN_DEG)
def test_a_pasted_panorama_has_no_tear(by: str, turn_deg: float) -> None:
    cameras = [camera_at(*pose) for pose in POSES["four"]]
    turn_rad = float(np.deg2rad(turn_deg))
    sampling = SamplingSettings(by=by)
    plain = PastedPanorama(cameras, sampling)
    turned = PastedPanorama(turned_rig(cameras, turn_rad), sampling)
    assert turned.columns_of == plain.columns_of
    differ = turned.sampling.columns != plain.sampling.columns
    # Halfway between two pixels rounding decides.
    assert differ.mean() < 0.02
    u = offset_of_yaw(0.4, CIRCLE, plain.sampling)
    turned_u = offset_of_yaw(0.4 - turn_rad, CIRCLE, turned.sampling)
    assert (turned_u - u + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-6)


def test_the_field_of_view_is_that_of_all_cameras() -> None:
    sampling = Panorama([camera_at(*pose) for pose in POSES["three"]], SETTINGS).sampling
    half_fov = np.arctan(59.5 / 100.0)
    right = sampling.left_rad - sampling.step_rad * (sampling.columns.size - 1)
    # The outer cameras stand 0.1 m to the side; at 2 m that is at most 3 degrees.
    assert sampling.left_rad == pytest.approx(np.deg2rad(50) + half_fov, abs=np.deg2rad(3.5))
    assert right == pytest.approx(-np.deg2rad(50) - half_fov, abs=np.deg2rad(3.5))


def test_rows_are_elevations_of_the_first_camera(box_room) -> None:
    """The floor's range at row v is height / tan(elevation), seen from the rig's origin."""
    cameras = [camera_at(0, 0, (0.0, 0.0, 0.0)), camera_at(45, 0, (0.0, 0.1, 0.0))]
    room = box_room(size_m=(40.0, 40.0, 2.6))
    T_room_rig = make_transform(np.eye(3), np.array([20.0, 20.0, 1.2]))
    depths_m = [
        room.depth_m(T_room_rig @ camera.T_rig_camera, LENS).astype(np.float32)
        for camera in cameras
    ]
    samples_m = Panorama(cameras, SETTINGS).samples_m(depths_m)
    for v in (45, 50, 55):
        slopes = [(v - 0.5 - LENS.cy) / LENS.fy, (v + 0.5 - LENS.cy) / LENS.fy]
        values = samples_m[v][np.isfinite(samples_m[v])]
        assert values.size > 40
        assert (values >= 1.2 / slopes[1] - 1e-3).all()
        assert (values <= 1.2 / slopes[0] + 1e-3).all()


def test_the_nearest_surface_wins() -> None:
    cameras = [camera_at(0, 0, (0.0, 0.0, 0.0)), camera_at(0, 0, (0.0, 0.0, 0.0))]
    near = np.full((60, 120), 1.5, dtype=np.float32)
    far = np.full((60, 120), 3.0, dtype=np.float32)
    near[:, :60] = np.nan
    panorama = Panorama(cameras, SETTINGS)
    one, other = panorama.samples_m([near, far]), panorama.samples_m([far, near])
    np.testing.assert_array_equal(one, other)
    azimuths = panorama.sampling.left_rad - panorama.sampling.step_rad * np.arange(one.shape[1])
    across = one[29] * np.cos(azimuths)
    assert across[azimuths > 0.02] == pytest.approx(3.0, rel=0.01)
    assert across[azimuths < -0.02] == pytest.approx(1.5, rel=0.01)


def test_where_no_camera_sees_anything_is_missing() -> None:
    cameras = [camera_at(40, 0, (0.0, 0.0, 0.0)), camera_at(-40, 0, (0.0, 0.0, 0.0))]
    depth = np.full((60, 120), 2.0, dtype=np.float32)
    panorama = Panorama(cameras, SETTINGS)
    samples_m = panorama.samples_m([depth, np.full_like(depth, np.nan)])
    azimuths = panorama.sampling.left_rad - panorama.sampling.step_rad * np.arange(
        samples_m.shape[1]
    )
    half_fov = np.arctan(60.0 / 100.0)
    inside = azimuths > np.deg2rad(40) - half_fov + HALF_STEP
    assert np.isfinite(samples_m[29, inside]).all()
    assert np.isnan(samples_m[:, azimuths < np.deg2rad(40) - half_fov - HALF_STEP]).all()


def test_each_camera_needs_its_image() -> None:
    cameras = [camera_at(*pose) for pose in POSES["three"]]
    with pytest.raises(ValueError, match="zip"):
        Panorama(cameras, SETTINGS).samples_m([np.ones((60, 120), dtype=np.float32)])


def portrait_at(yaw_deg: float) -> Camera:
    """One of the paper's cameras: 240 columns of 47.7 degrees, upright."""
    lens = CameraIntrinsics(width=240, height=320, fx=271.4, fy=286.4, cx=119.5, cy=159.5)
    turn = rotation_from_yaw_pitch_roll(np.deg2rad(yaw_deg), 0.0, 0.0)
    T_rig_camera = make_transform(turn @ R_BODY_OPTICAL, np.zeros(3))
    return Camera(topic=f"depth {yaw_deg}", intrinsics=lens, T_rig_camera=T_rig_camera)


BY_INDEX = SamplingSettings(by="index")


@pytest.mark.parametrize("turned_deg", [0.0, 160.0, -130.0])
def test_the_pasted_panorama_of_the_papers_rig(turned_deg: float) -> None:
    """180 of 960 columns, whatever the order of the cameras and where the rig's zero lies."""
    headings = [0.0, -90.0, 45.0, -45.0]
    cameras = [portrait_at(turned_deg + heading) for heading in headings]
    pasted = PastedPanorama(cameras, BY_INDEX)
    assert [camera.topic for camera in pasted.from_left] == [
        f"depth {turned_deg + heading}" for heading in (45.0, 0.0, -45.0, -90.0)
    ]
    expected = [round(w * 959 / 179) for w in range(180)]
    np.testing.assert_array_equal(pasted.sampling.columns, expected)
    # Each image's middle lies at its camera's heading, within a sample.
    for heading, columns in zip(headings, pasted.columns_of, strict=True):
        middle = np.abs(pasted.sampling.columns - (columns[0] + 119.5)).argmin()
        azimuth_deg = np.rad2deg(pasted.sampling.left_rad - pasted.sampling.step_rad * middle)
        difference = (azimuth_deg - (turned_deg + heading) + 180.0) % 360.0 - 180.0
        assert abs(difference) <= 1.0


def test_each_pasted_pixel_is_one_of_its_cameras() -> None:
    cameras = [portrait_at(heading) for heading in (0.0, -45.0, 45.0)]
    pasted = PastedPanorama(cameras, BY_INDEX)
    depths_m = [np.full((320, 240), camera + 1.0, dtype=np.float32) for camera in range(3)]
    for depth_m in depths_m:
        depth_m += 0.001 * np.arange(240, dtype=np.float32)
    wide_m = pasted.paste(depths_m)
    assert wide_m.shape == (320, 720)
    columns = pasted.sampling.columns
    for column, camera in zip(columns, pasted.camera_of(columns), strict=True):
        own = column - pasted.columns_of[camera][0]
        assert wide_m[7, column] == depths_m[camera][7, own]
    np.testing.assert_array_equal(pasted.samples_m(depths_m), wide_m[:, columns])


def test_by_angle_the_camera_that_looks_there_gives_the_sample() -> None:
    """In the middle of a round room every sample has the same range."""
    cameras = [portrait_at(heading) for heading in (45.0, 0.0, -45.0)]
    lens = cameras[0].intrinsics
    along = np.hypot(1.0, (np.arange(240) - lens.cx) / lens.fx)
    depth_m = np.broadcast_to((3.0 / along).astype(np.float32), (320, 240))
    pasted = PastedPanorama(cameras, SamplingSettings(by="angle"))
    samples_m = pasted.samples_m([depth_m] * 3)
    assert samples_m.shape == (320, 135)
    assert samples_m == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize(
    ("headings", "expected"),
    [
        ([0.0], False),
        ([0.0, 45.0], True),
        ([-170.0, 145.0], True),
        ([0.0, 60.0], True),
        ([0.0, 0.0], False),
        ([0.0, 180.0], False),
        ([0.0, 45.0, 180.0], False),
    ],
)
def test_cameras_are_side_by_side_where_their_images_about_touch(headings, expected) -> None:
    assert are_side_by_side([portrait_at(heading) for heading in headings]) is expected


def test_images_of_different_heights_are_not_side_by_side() -> None:
    low = Camera(topic="low", intrinsics=LENS, T_rig_camera=portrait_at(45.0).T_rig_camera)
    assert not are_side_by_side([portrait_at(0.0), low])
