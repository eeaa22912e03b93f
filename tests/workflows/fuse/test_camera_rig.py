"""The rig that a recording describes, against the transforms that were written into it."""

from dataclasses import replace

import numpy as np
import pytest

from fusion_core.alignment.curves import SamplingSettings
from fusion_core.model.errors import MissingStream
from fusion_core.model.geometry import invert_transform, make_transform, transform_points
from fusion_core.recordings.topics import choose_streams
from fusion_core.workflows.fuse.camera_rig import build_camera_rig

NAMES = ("a", "b", "c")


def rig_of(log, *, virtual=False):
    with log.open() as recording:
        return build_camera_rig(
            recording, choose_streams(recording), SamplingSettings(), virtual=virtual
        )


def stored_pose(rig, index):
    """T_rig_stored: optical axes of the stored image, whichever way the view was turned."""
    T = rig.cameras[index].T_rig_camera.copy()
    T[:3, :3] = T[:3, :3] @ rig.views[index].R_stored_view.T
    return T


@pytest.fixture
def one_camera(log):
    log.scan(0.0)
    log.image(0.0)
    log.info()
    return log


def test_without_tf_the_camera_is_level_and_no_mount_is_known(one_camera, pose_of):
    rig = rig_of(one_camera)
    assert rig.recorded_mount is None
    assert rig.lidar_frame == "laser"
    assert rig.notes == ()
    np.testing.assert_allclose(rig.cameras[0].T_rig_camera, pose_of(optical=True), atol=1e-15)
    assert rig.cameras[0].intrinsics == rig.stored_intrinsics[0] == one_camera.lens


@pytest.mark.parametrize("slash", ["", "/"])
def test_the_recorded_mount_has_the_numbers_of_the_transforms(one_camera, pose_of, slash):
    T_base_lidar = pose_of(0.1, 0.0, 0.31)
    T_base_camera = pose_of(0.15, 0.03, 0.92, yaw=0.12, pitch=0.2, roll=0.05, optical=True)
    one_camera.transform(f"{slash}base_link", f"{slash}laser", T_base_lidar)
    one_camera.transform(f"{slash}base_link", f"{slash}camera_optical", T_base_camera)
    rig = rig_of(one_camera)
    mount = rig.recorded_mount
    assert mount.yaw_rad == pytest.approx(0.12)
    assert (mount.forward_m, mount.left_m, mount.delta_z_m) == pytest.approx((0.05, 0.03, 0.61))
    # Pitch and roll stay with the camera, so that the mount's own are small corrections.
    assert mount.pitch_rad == 0.0
    np.testing.assert_allclose(
        mount.T_lidar_rig @ stored_pose(rig, 0),
        invert_transform(T_base_lidar) @ T_base_camera,
        atol=1e-12,
    )


@pytest.mark.parametrize("lidar", [{"yaw": 2.0}, {"yaw": -1.0, "x": 0.3}, {"roll": np.pi}])
def test_the_mount_is_seen_from_the_lidar_however_it_stands(one_camera, pose_of, lidar):
    T_base_lidar, T_base_camera = pose_of(**lidar), pose_of(z=0.5, yaw=0.3, optical=True)
    one_camera.transform("base_link", "laser", T_base_lidar)
    one_camera.transform("base_link", "camera_optical", T_base_camera)
    rig = rig_of(one_camera)
    np.testing.assert_allclose(
        rig.recorded_mount.T_lidar_rig @ stored_pose(rig, 0),
        invert_transform(T_base_lidar) @ T_base_camera,
        atol=1e-12,
    )
    # Up is the LiDAR's up: one that hangs upside down turns the picture with it.
    assert rig.cameras[0].T_rig_camera[2, 1] == pytest.approx(-1.0)


def test_without_the_lidar_the_root_gives_the_tilt_and_no_mount(one_camera, pose_of):
    T = pose_of(0.2, 0.1, 0.9, yaw=0.4, pitch=0.3, optical=True)
    one_camera.transform("base_link", "camera_optical", T)
    rig = rig_of(one_camera)
    assert rig.recorded_mount is None
    # The camera looks along the rig's x, and stands at its origin.
    np.testing.assert_allclose(
        rig.cameras[0].T_rig_camera, pose_of(pitch=0.3, optical=True), atol=1e-12
    )


@pytest.mark.parametrize("own_is_root", [True, False])
def test_an_optical_frame_is_no_level_base(one_camera, pose_of, own_is_root):
    frames = ("camera_optical", "color_optical")
    parent, child = frames if own_is_root else frames[::-1]
    one_camera.transform(parent, child, pose_of(x=0.05, yaw=0.02))
    rig = rig_of(one_camera)
    np.testing.assert_allclose(rig.cameras[0].T_rig_camera, pose_of(optical=True), atol=1e-12)
    assert rig.recorded_mount is None


def several(log, poses, *, joined_to=None):
    log.scan(0.0)
    for name, T in poses.items():
        log.image(0.0, name=name)
        log.info(name)
        if joined_to is not None:
            log.transform(joined_to, f"{name}_optical", T)


@pytest.fixture
def side_by_side(pose_of):
    yaws = np.deg2rad([45.0, 0.0, -45.0])
    return {
        name: pose_of(0.2, 0.1 - 0.1 * index, 1.0, yaw=yaw, optical=True)
        for index, (name, yaw) in enumerate(zip(NAMES, yaws, strict=True))
    }


def test_cameras_of_one_root_keep_their_poses_among_themselves(log, side_by_side):
    several(log, side_by_side, joined_to="camera_rig")
    rig = rig_of(log)
    assert rig.recorded_mount is None
    assert [camera.topic for camera in rig.cameras] == [f"/{n}/depth/image_raw" for n in NAMES]
    first = invert_transform(rig.cameras[0].T_rig_camera)
    for index, name in enumerate(NAMES):
        np.testing.assert_allclose(
            first @ rig.cameras[index].T_rig_camera,
            invert_transform(side_by_side["a"]) @ side_by_side[name],
            atol=1e-12,
        )
    centre = np.mean([camera.T_rig_camera[:3, 3] for camera in rig.cameras], axis=0)
    np.testing.assert_allclose(centre, 0.0, atol=1e-12)
    assert [camera.yaw_rad for camera in rig.cameras] == pytest.approx(np.deg2rad([45, 0, -45]))


def test_cameras_joined_to_the_lidar_have_a_mount_at_their_middle(log, pose_of, side_by_side):
    several(log, side_by_side, joined_to="base_link")
    T_base_lidar = pose_of(0.05, 0.0, 0.3, yaw=0.1)
    log.transform("base_link", "laser", T_base_lidar)
    rig = rig_of(log)
    assert (rig.recorded_mount.yaw_rad, rig.recorded_mount.delta_z_m) == pytest.approx((0.0, 0.7))
    for index, name in enumerate(NAMES):
        np.testing.assert_allclose(
            rig.recorded_mount.T_lidar_rig @ rig.cameras[index].T_rig_camera,
            invert_transform(T_base_lidar) @ side_by_side[name],
            atol=1e-12,
        )


def test_cameras_that_nothing_joins_are_left_out_by_name(log, side_by_side):
    several(log, side_by_side)
    rig = rig_of(log)
    assert [camera.topic for camera in rig.cameras] == ["/a/depth/image_raw"]
    (note,) = rig.notes
    assert "/a/depth/image_raw alone" in note
    assert "/b/depth/image_raw, /c/depth/image_raw" in note


@pytest.mark.parametrize("quarters", [0, 1, 2, 3])
def test_a_rolled_camera_is_seen_upright_pixel_by_pixel(one_camera, pose_of, quarters):
    """A point lands on the same stored pixel by way of the view as by the stored pose itself."""
    T_base_camera = pose_of(z=0.5, yaw=0.2, roll=quarters * np.pi / 2, optical=True)
    one_camera.transform("base_link", "laser", pose_of())
    one_camera.transform("base_link", "camera_optical", T_base_camera)
    rig = rig_of(one_camera)
    camera, view, lens = rig.cameras[0], rig.views[0], one_camera.lens
    assert camera.T_rig_camera[2, 1] == pytest.approx(-1.0)
    assert (camera.intrinsics.width, camera.intrinsics.height) == (
        (lens.width, lens.height) if quarters % 2 == 0 else (lens.height, lens.width)
    )
    rng = np.random.default_rng(3)
    ahead = pose_of(z=0.5, yaw=0.2)
    points = transform_points(
        ahead, np.column_stack([np.full(60, 2.0), rng.uniform(-0.6, 0.6, (60, 2))])
    )

    def pixels(T_lidar_camera, intrinsics):
        x, y, z = transform_points(invert_transform(T_lidar_camera), points).T
        column = intrinsics.cx + intrinsics.fx * x / z
        row = intrinsics.cy + intrinsics.fy * y / z
        return np.rint(row).astype(int), np.rint(column).astype(int)

    row, column = pixels(rig.recorded_mount.T_lidar_rig @ camera.T_rig_camera, camera.intrinsics)
    found = view.stored_pixels(row, column)
    np.testing.assert_array_equal(found, pixels(T_base_camera, lens))
    stored_m = rng.uniform(1.0, 3.0, (lens.height, lens.width)).astype(np.float32)
    np.testing.assert_array_equal(view.remap(stored_m)[row, column], stored_m[found])


@pytest.mark.parametrize(
    "lens", [None, "uncalibrated", "of another size"], ids=["missing", "empty", "size"]
)
def test_without_usable_intrinsics_a_field_of_view_is_assumed_and_noted(log, lens):
    log.scan(0.0)
    log.image(0.0)
    if lens == "uncalibrated":
        log.info(lens=None)
    elif lens == "of another size":
        log.info(lens=replace(log.lens, width=2 * log.lens.width, height=2 * log.lens.height))
    rig = rig_of(log)
    camera = rig.cameras[0]
    assert not camera.calibrated
    edges = camera.column_azimuths_rad(np.array([-0.5, log.lens.width - 0.5]))
    assert np.rad2deg(edges[0] - edges[1]) == pytest.approx(57.0)
    assert edges.sum() == pytest.approx(0.0)
    (note,) = rig.notes
    assert "/camera/depth/image_raw" in note
    assert "57 degrees" in note


def test_what_is_missing_is_named_with_advice(log, new_log):
    log.scan(0.0)
    with pytest.raises(MissingStream, match="no depth images") as failure:
        rig_of(log)
    assert failure.value.file == str(log.path)
    assert "--depth" in failure.value.advice
    blind = new_log()
    blind.image(0.0)
    with pytest.raises(MissingStream, match="no 2D LiDAR") as failure:
        rig_of(blind)
    assert "--virtual-lidar" in failure.value.advice


def test_a_virtual_lidar_is_wider_than_the_rows_and_of_one_camera(log, side_by_side):
    several(log, side_by_side, joined_to="camera_rig")
    rig = rig_of(log, virtual=True)
    assert len(rig.cameras) == len(rig.views) == len(rig.full_views) == 1
    assert rig.recorded_mount is None
    assert "/a/depth/image_raw" in rig.notes[-1]
    whole, cut = rig.full_views[0].intrinsics, rig.cameras[0].intrinsics
    assert whole == log.lens
    assert cut.width == pytest.approx(0.6 * whole.width, abs=1.0)
    stored_m = np.arange(whole.height * whole.width, dtype=np.float32).reshape(whole.height, -1)
    first = round(whole.cx - cut.cx)
    np.testing.assert_array_equal(
        rig.views[0].remap(stored_m), stored_m[:, first : first + cut.width]
    )


def test_distortion_is_taken_out_of_the_view(log):
    log.scan(0.0)
    log.image(0.0)
    log.info(lens=replace(log.lens, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0)))
    rig = rig_of(log)
    assert not any(rig.cameras[0].intrinsics.distortion)
    assert any(rig.stored_intrinsics[0].distortion)
    np.testing.assert_array_equal(
        rig.cameras[0].T_rig_camera,
        make_transform(rig.cameras[0].T_rig_camera[:3, :3], np.zeros(3)),
    )
