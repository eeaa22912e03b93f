"""A mount that a person gives is kept, whatever is seen; what is seen is said."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.alignment import given_mount
from fusion_core.alignment.given_mount import given_mount_sd, hold_given_mount, mount_jacobian
from fusion_core.alignment.in_plane_mount import InPlaneMount, fit_in_plane
from fusion_core.alignment.mount_settings import MountSettings
from fusion_core.calibration.pose_error import apply_pose_error
from fusion_core.model.conventions import R_BODY_OPTICAL
from fusion_core.model.errors import AlignmentFailed
from fusion_core.model.geometry import (
    invert_transform,
    make_transform,
    rotation_from_yaw_pitch_roll,
)
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.model.rig import Mount
from tests.alignment.test_mount import drive, random_mount

SETTINGS = MountSettings()
SD = np.array([0.005, 0.01, 0.01, 0.01, 0.005])


def hold(frames, mount: Mount, sd: np.ndarray = SD, *, within_doubt: bool = False):
    alone = Mount.from_vector(np.append(mount.vector()[:5], 0.0))
    return hold_given_mount(
        frames,
        SETTINGS,
        given=alone,
        sd=sd,
        within_doubt=within_doubt,
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_right_mount_is_kept_and_the_clock_found(furnished_room, seed: int) -> None:
    truth = random_mount(seed)
    found = hold(drive(furnished_room, truth, seed), truth)
    np.testing.assert_array_equal(found.mount.vector()[:5], truth.vector()[:5])
    assert found.is_given
    assert found.is_confident
    assert not found.is_from_recorded
    assert found.agreement > 0.9
    assert found.contradictions == ()
    assert found.mount.sd[:5] == pytest.approx(SD)
    assert found.mount.sd[5] is not None
    assert abs(found.mount.clock_offset_ms - truth.clock_offset_ms) < 12.0


@pytest.mark.parametrize(
    ("off", "said"),
    [
        ((np.deg2rad(3.0), 0.0, 0.0, 0.0), "a yaw -"),
        ((0.0, 0.0, 0.08, 0.0), "m forward"),
        ((0.0, 0.0, 0.0, -0.08), "m left"),
    ],
)
def test_a_wrong_mount_is_kept_and_what_contradicts_it_is_said(furnished_room, off, said) -> None:
    truth = random_mount(2)
    wrong = Mount.from_vector(truth.vector() + np.append(off, (0.0, 0.0)))
    found = hold(drive(furnished_room, truth, 2), wrong)
    np.testing.assert_array_equal(found.mount.vector()[:5], wrong.vector()[:5])
    assert any(said in one for one in found.contradictions), found.contradictions


def test_a_fit_that_has_run_off_to_a_worse_optimum_contradicts_nothing(
    furnished_room, monkeypatch
) -> None:
    truth = random_mount(2)
    frames = drive(furnished_room, truth, 2)
    run_off = np.array([np.deg2rad(23.0), 0.0, 0.0, -0.8, 0.0, 0.0])

    def fit_elsewhere(*given) -> InPlaneMount:
        found = fit_in_plane(*given)
        return replace(found, values=found.values + run_off, sd=np.full(6, 0.01))

    monkeypatch.setattr(given_mount, "fit_in_plane", fit_elsewhere)
    assert hold(frames, truth).contradictions == ()


def test_a_mount_far_off_is_said_to_explain_nothing(furnished_room) -> None:
    truth = random_mount(2)
    wrong = Mount.from_vector(truth.vector() + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    found = hold(drive(furnished_room, truth, 2), wrong)
    (only,) = found.contradictions
    assert "points agree, no more than by chance" in only
    assert not found.is_confirmed
    assert found.is_confident


@pytest.mark.parametrize("seed", range(4))
def test_within_its_doubt_a_mount_is_moved_towards_the_truth(furnished_room, seed: int) -> None:
    truth = random_mount(seed)
    off = np.array([np.deg2rad(0.4), 0.0, 0.03, -0.03, 0.0, 0.0])
    doubt = np.array([np.deg2rad(0.5), 1e-3, 0.04, 0.04, 1e-4])
    wrong = Mount.from_vector(truth.vector() + off)
    found = hold(drive(furnished_room, truth, seed), wrong, doubt, within_doubt=True)
    error = found.mount.vector() - truth.vector()
    assert abs(error[0]) < 0.5 * off[0]
    assert np.linalg.norm(error[2:4]) < 0.5 * np.linalg.norm(off[2:4])
    # What is known is kept.
    np.testing.assert_array_equal(found.mount.vector()[[1, 4]], wrong.vector()[[1, 4]])
    assert (np.array(found.mount.sd[:4]) <= doubt[:4]).all()
    assert "deg in yaw" in found.moved_from_given


def test_a_sharp_covariance_keeps_the_mount(furnished_room) -> None:
    truth = random_mount(2)
    wrong = Mount.from_vector(truth.vector() + np.array([0.02, 0.0, 0.02, 0.0, 0.0, 0.0]))
    found = hold(drive(furnished_room, truth, 2), wrong, np.full(5, 1e-6), within_doubt=True)
    np.testing.assert_allclose(found.mount.vector()[:5], wrong.vector()[:5], atol=1e-5)
    assert found.contradictions


@pytest.mark.parametrize("seed", range(4))
def test_a_height_that_is_not_observable_is_that_of_scans_and_images(furnished_room, seed) -> None:
    truth = random_mount(seed)
    doubt = np.array([np.deg2rad(0.1), 1.0, 0.005, 0.005, 1e-4])
    wrong = Mount.from_vector(truth.vector() + np.array([0.0, 0.25, 0.0, 0.0, 0.0, 0.0]))
    found = hold(drive(furnished_room, truth, seed), wrong, doubt, within_doubt=True)
    assert abs(found.mount.delta_z_m - truth.delta_z_m) < 0.06


def test_a_refused_mount_is_not_moved(furnished_room) -> None:
    truth = random_mount(2)
    wrong = Mount.from_vector(truth.vector() + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    found = hold(drive(furnished_room, truth, 2), wrong, within_doubt=True)
    np.testing.assert_array_equal(found.mount.vector()[:5], wrong.vector()[:5])
    assert found.moved_from_given == ""


def test_standing_still_shows_no_clock(furnished_room) -> None:
    truth = random_mount(1)
    found = hold(drive(furnished_room, truth, 1, rate=0.0), truth)
    assert found.mount.sd[5] is None
    assert found.mount.clock_offset_ms == 0.0
    assert found.contradictions == ()


def test_without_images_nothing_is_aligned() -> None:
    with pytest.raises(AlignmentFailed, match="no depth image"):
        hold([], random_mount(0))


def pose_of(yaw: float, pitch: float, roll: float, place: list[float]) -> np.ndarray:
    """T_camera_lidar of a camera with this attitude and place in the LiDAR's frame."""
    body = rotation_from_yaw_pitch_roll(yaw, pitch, roll)
    return invert_transform(make_transform(body @ R_BODY_OPTICAL, np.array(place)))


def mount_values(T_camera_lidar: np.ndarray) -> np.ndarray:
    T = invert_transform(T_camera_lidar)
    yaw, pitch = np.arctan2(T[1, 2], T[0, 2]), -np.arcsin(T[2, 2])
    return np.array([yaw, T[2, 3], T[0, 3], T[1, 3], pitch])


@given(
    st.floats(-3.0, 3.0),
    st.floats(-1.2, 1.2),
    st.floats(-3.0, 3.0),
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3),
)
def test_the_jacobian_is_that_of_differences(yaw, pitch, roll, place) -> None:
    T = pose_of(yaw, pitch, roll, place)
    step = 1e-6
    numeric = np.stack(
        [
            (mount_values(apply_pose_error(T, e)) - mount_values(apply_pose_error(T, -e)))
            / (2 * step)
            for e in step * np.eye(6)
        ],
        axis=1,
    )
    numeric[0] = np.where(np.abs(numeric[0]) > 1e5, 0.0, numeric[0])
    np.testing.assert_allclose(mount_jacobian(T), numeric, atol=1e-5)


def test_deviations_come_from_the_covariance_where_there_is_one() -> None:
    T = pose_of(0.3, 0.1, 0.0, [0.0, 0.0, 0.0])
    assert given_mount_sd([CameraPose(T_camera_lidar=T)], SETTINGS) == pytest.approx(
        [np.deg2rad(0.3), 0.01, 0.01, 0.01, np.deg2rad(0.3)]
    )
    covariance = np.diag([1e-6] * 3 + [4e-6] * 3)
    known = CameraPose(T_camera_lidar=T, covariance=covariance.copy())
    sd = given_mount_sd([known], SETTINGS)
    assert sd[1:4] == pytest.approx(2e-3)
    assert sd[4] == pytest.approx(1e-3)
    covariance[4, :] = covariance[:, 4] = np.nan
    partly = CameraPose(T_camera_lidar=T, covariance=covariance)
    # The camera's y is its height: that alone is unknown.
    wide = given_mount_sd([partly, known], SETTINGS)
    assert wide[1] > 0.9
    assert wide[0] == pytest.approx(sd[0])


def test_a_pose_must_be_rigid() -> None:
    with pytest.raises(ValueError, match="rigid"):
        CameraPose(T_camera_lidar=np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(ValueError, match="finite"):
        CameraPose(T_camera_lidar=np.full((4, 4), np.nan))
    with pytest.raises(ValueError, match="6, 6"):
        CameraPose(T_camera_lidar=np.eye(4), covariance=np.eye(3))
    turned = make_transform(Rotation.from_rotvec([0.1, 0.2, 3.0]).as_matrix(), np.ones(3))
    given_extrinsics = GivenExtrinsics(
        source="hand", cameras={None: CameraPose(T_camera_lidar=turned)}
    )
    assert given_extrinsics.of_topics(["/a"])["/a"].T_camera_lidar is turned
