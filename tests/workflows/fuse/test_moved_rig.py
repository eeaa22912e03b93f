"""A camera moved against the LiDAR: its rig, and the alignment without a pass over a recording."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.given_extrinsics import CameraPose, GivenExtrinsics
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.scenes import SceneSettings, find_scene, write_scene
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain, FrameChoice
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.moved_rig import align_moved, camera_pose_of, move_rig
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("moved") / "room.mcap"
    own = find_scene("bedroom").settings.model_dump()
    settings = SceneSettings(**own | {"duration_s": 2.0, "image_scale": 0.5})
    write_scene("bedroom", path, settings=settings)
    with open_recording(path) as opened:
        yield opened


@pytest.fixture(scope="module")
def session(recording):
    return open_session(recording, FuseOptions(), PRESETS["default"])


@pytest.fixture(scope="module")
def alignment(session):
    return align_recording(session)


POSES = st.builds(
    lambda yaw, pitch, roll, place: make_transform(
        Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
        np.array(place),
    ),
    st.floats(-3.1, 3.1),
    st.floats(-1.0, 1.0),
    st.floats(-3.1, 3.1),
    st.tuples(*[st.floats(-2.0, 2.0)] * 3),
)


@given(T_lidar_camera=POSES)
def test_the_first_camera_is_where_it_is_put_and_the_others_keep_their_places(
    session, T_lidar_camera
) -> None:
    # A second camera, turned and a hand to the right of the first.
    rig = session.rig
    beside = make_transform(Rotation.from_euler("y", 0.7).as_matrix(), np.array([0.1, 0.0, 0.02]))
    second = replace(rig.cameras[0], T_rig_camera=rig.cameras[0].T_rig_camera @ beside)
    for cameras in (rig.cameras, (*rig.cameras, second)):
        several = replace(
            rig, cameras=cameras, views=rig.views * len(cameras), full_views=rig.full_views
        )
        moved, mount = move_rig(several, T_lidar_camera)
        np.testing.assert_allclose(camera_pose_of(moved, mount), T_lidar_camera, atol=1e-9)
        assert moved.given is not None
        np.testing.assert_allclose(
            moved.given.poses[0].T_camera_lidar, invert_transform(T_lidar_camera), atol=1e-9
        )
    apart = invert_transform(camera_pose_of(moved, mount)) @ camera_pose_of(moved, mount, 1)
    np.testing.assert_allclose(apart, beside, atol=1e-9)


@pytest.mark.parametrize("roll_deg", [0.0, 4.0])
def test_it_is_the_alignment_of_a_pass_with_these_extrinsics(
    recording, session, alignment, roll_deg
) -> None:
    base = camera_pose_of(session.rig, alignment.mount)
    change = make_transform(
        Rotation.from_euler("yxz", [1.0, 0.5, roll_deg], degrees=True).as_matrix(),
        np.array([0.01, -0.02, 0.03]),
    )
    T_lidar_camera = base @ change
    moved_session, moved = align_moved(alignment, session, T_lidar_camera)
    topic = session.rig.cameras[0].topic
    pose = CameraPose(T_camera_lidar=invert_transform(T_lidar_camera))
    given = GivenExtrinsics(source="test", cameras={topic: pose})
    own_session = open_session(recording, FuseOptions(), PRESETS["default"], given)
    own = align_recording(own_session)
    np.testing.assert_allclose(moved.mount.vector()[:5], own.mount.vector()[:5], atol=1e-9)
    assert moved.along_curve
    assert own.along_curve
    np.testing.assert_allclose(
        moved_session.rig.cameras[0].T_rig_camera,
        own_session.rig.cameras[0].T_rig_camera,
        atol=1e-9,
    )
    # One frame's pairs are the same, but for the clock offset that each alignment believes.
    choice = FrameChoice(number=10)
    pairs = [
        CachedChain(s, FrameReader(s), a).match(choice, s.settings).correspondence
        for s, a in ((moved_session, moved), (own_session, own))
    ]
    np.testing.assert_array_equal(pairs[0].beam, pairs[1].beam)
    np.testing.assert_allclose(pairs[0].depth_as_range_m, pairs[1].depth_as_range_m, atol=1e-6)


def test_a_moved_chain_reads_no_image_again(session, alignment, monkeypatch) -> None:
    chain = CachedChain(session, FrameReader(session), alignment)
    choice = FrameChoice(number=5)
    before = chain.match(choice, session.settings)
    T_lidar_camera = camera_pose_of(session.rig, alignment.mount)
    T_lidar_camera = T_lidar_camera @ make_transform(np.eye(3), np.array([0.0, 0.0, 0.2]))
    moved = chain.moved(T_lidar_camera)
    monkeypatch.setattr(chain.frames, "pair", None)
    after = moved.match(choice, session.settings)
    assert after.pair.image is before.pair.image
    # The camera is 20 cm farther ahead: what it sees is farther from the LiDAR.
    both = np.intersect1d(before.correspondence.beam, after.correspondence.beam)
    ranges = [
        match.correspondence.depth_as_range_m[np.isin(match.correspondence.beam, both)]
        for match in (before, after)
    ]
    assert np.nanmedian(ranges[1] - ranges[0]) == pytest.approx(0.2, abs=0.06)
