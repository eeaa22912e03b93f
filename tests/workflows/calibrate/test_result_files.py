"""A result's files give back one transform, whoever reads them."""

import json
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML
from scipy.spatial.transform import Rotation

from fusion_core.exporting.extrinsics_files import li_angles
from fusion_core.model.errors import ExportError, SettingsError
from fusion_core.model.extrinsics import POSE_PARAMETERS, ExtrinsicsEstimate
from fusion_core.model.geometry import invert_transform, make_transform
from fusion_core.model.names import printable
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.calibration_files.estimate import read_estimate
from fusion_core.recordings.calibration_files.extrinsics import read_extrinsics
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.calibrate.result_files import result_paths, write_result

CAMERA = CameraIntrinsics(
    width=1280, height=960, fx=900.5, fy=901.25, cx=640.5, cy=480.0, distortion=(0.1, 0.2, 0.0, 0.0)
)
finite = st.floats(-9.0, 9.0)
positive = st.floats(1e-9, 1e9)
names = st.text(min_size=1, max_size=12)


@st.composite
def transforms(draw: Any) -> np.ndarray:
    rotation = Rotation.from_rotvec(draw(st.lists(st.floats(-3.2, 3.2), min_size=3, max_size=3)))
    # The axes of a body against a camera's are a quarter turn apart, where angles are singular.
    turned = draw(st.sampled_from([0.0, np.pi / 2.0, -np.pi / 2.0, np.pi]))
    axis = draw(st.sampled_from("xyz"))
    if draw(st.booleans()):
        rotation = Rotation.identity()
    rotation = Rotation.from_euler(axis, turned) * rotation
    return make_transform(
        rotation.as_matrix(), np.array(draw(st.lists(finite, min_size=3, max_size=3)))
    )


@st.composite
def estimates(draw: Any) -> ExtrinsicsEstimate:
    known = np.array(draw(st.lists(st.booleans(), min_size=6, max_size=6)))
    factor = np.array(draw(st.lists(finite, min_size=36, max_size=36))).reshape(6, 6)
    covariance = np.where(np.outer(known, known), factor @ factor.T, np.nan)
    return ExtrinsicsEstimate(
        T_camera_lidar=draw(transforms()),
        covariance=covariance,
        method=draw(st.text(max_size=20)),
        verdict=draw(st.text(max_size=60)),
        improved=draw(st.booleans()),
        T_guess=draw(st.none() | transforms()),
        reprojection_rms_px=draw(st.none() | positive),
        reprojection_rms_used_px=draw(st.none() | positive),
        basin=draw(st.none() | st.floats(0.0, 1.0)),
        unobservable=tuple(
            name for name, seen in zip(POSE_PARAMETERS, known, strict=True) if not seen
        ),
        notes=tuple(draw(st.lists(st.text(max_size=20), max_size=3))),
    )


def estimate_at(T_camera_lidar: np.ndarray) -> ExtrinsicsEstimate:
    return ExtrinsicsEstimate(
        T_camera_lidar=T_camera_lidar,
        covariance=np.eye(6) * 1e-6,
        method="test",
        verdict="as given",
        improved=True,
    )


@pytest.mark.parametrize("suffix", [".json", ".toml"])
@given(estimate=estimates())
def test_an_estimate_comes_back(
    tmp_path_factory: Any, suffix: str, estimate: ExtrinsicsEstimate
) -> None:
    output = tmp_path_factory.mktemp("result") / f"result{suffix}"
    write_result(output, estimate, inputs=[], intrinsics=CAMERA, more={"pairs": [[1.5, 2], [3, 4]]})
    found = read_estimate(output)
    for name in ("method", "verdict", "improved", "unobservable", "notes", "basin"):
        assert getattr(found, name) == getattr(estimate, name)
    assert found.reprojection_rms_px == estimate.reprojection_rms_px
    assert found.reprojection_rms_used_px == estimate.reprojection_rms_used_px
    np.testing.assert_array_equal(found.covariance, estimate.covariance)
    np.testing.assert_allclose(found.T_camera_lidar, estimate.T_camera_lidar, atol=1e-14)
    assert (found.T_guess is None) == (estimate.T_guess is None)
    if found.T_guess is not None:
        np.testing.assert_array_equal(found.T_guess, estimate.T_guess)
    np.testing.assert_array_equal(read_extrinsics(output)[None], found.T_camera_lidar)
    assert read_intrinsics(output, (1280, 960)) == CAMERA


@given(T=transforms(), camera=names, lidar=names)
def test_yaml_urdf_and_tf_say_the_same(
    tmp_path_factory: Any, T: np.ndarray, camera: str, lidar: str
) -> None:
    output = tmp_path_factory.mktemp("result") / "result.json"
    frames = {"camera_frame": camera, "lidar_frame": lidar}
    _, yaml, urdf, mcap = write_result(output, estimate_at(T), inputs=[], **frames)
    camera, lidar = printable(camera), printable(lidar)
    read = YAML(typ="safe").load(yaml)
    assert (read["header"]["frame_id"], read["child_frame_id"]) == (camera, lidar)
    moved = read["transform"]
    rotation = Rotation.from_quat([moved["rotation"][name] for name in "xyzw"]).as_matrix()
    np.testing.assert_allclose(rotation, T[:3, :3], atol=1e-12)
    assert [moved["translation"][name] for name in "xyz"] == T[:3, 3].tolist()

    joint = ET.parse(urdf).getroot()
    origin = joint.find("origin")
    assert origin is not None
    roll, pitch, yaw = map(float, origin.attrib["rpy"].split())
    rotation = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    np.testing.assert_allclose(rotation, T[:3, :3], atol=1e-12)
    assert [float(word) for word in origin.attrib["xyz"].split()] == T[:3, 3].tolist()
    for end, name in (("parent", camera), ("child", lidar)):
        element = joint.find(end)
        assert element is not None
        assert element.attrib["link"] == name

    with open_recording(mcap) as recording:
        (message,) = recording.messages(["/tf_static"])
        (transform,) = message.value.transforms
    assert (transform.parent, transform.child) == (camera, lidar)
    np.testing.assert_allclose(transform.T_parent_child, T, atol=1e-12)


def test_the_recording_as_other_tools_read_it(tmp_path: Path) -> None:
    T = make_transform(
        Rotation.from_rotvec([1.0, -1.2, 0.4]).as_matrix(), np.array([1.0, 2.0, 3.0])
    )
    *_, mcap = write_result(tmp_path / "a.json", estimate_at(T), inputs=[])
    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([mcap], default_typestore=store) as reader:
        ((connection, stamp, data),) = reader.messages()
        (entry,) = reader.deserialize(data, connection.msgtype).transforms
    assert (connection.topic, connection.msgtype, stamp) == (
        "/tf_static",
        "tf2_msgs/msg/TFMessage",
        0,
    )
    assert (entry.header.frame_id, entry.child_frame_id) == ("camera", "lidar")
    q = entry.transform.rotation
    np.testing.assert_allclose(
        Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), T[:3, :3], atol=1e-12
    )
    with mcap.open("rb") as stream:
        ((_, channel, _),) = make_reader(stream).iter_messages()
    assert "durability: 1" in channel.metadata["offered_qos_profiles"]


def test_the_same_bytes_twice_and_no_place_or_time(tmp_path: Path) -> None:
    contents = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        paths = write_result(tmp_path / name / "result.json", estimate_at(np.eye(4)), inputs=[])
        assert sorted(paths) == sorted((tmp_path / name).iterdir())
        contents.append([path.read_bytes() for path in paths])
    assert contents[0] == contents[1]
    assert not any(str(tmp_path).encode() in content for content in contents[0])


@given(alpha=st.floats(-3.1, 3.1), beta=st.floats(-1.57, 1.57), gamma=st.floats(-3.1, 3.1))
def test_li_angles_are_those_of_the_inverse(alpha: float, beta: float, gamma: float) -> None:
    # Li 2022 turns by γ about x, then β about y, then α about z, from the camera to the LiDAR.
    rotation = Rotation.from_euler("xyz", [gamma, beta, alpha]).as_matrix()
    found = li_angles(invert_transform(make_transform(rotation, np.ones(3))))
    assert found["singular"] is False
    values = [found["gamma_rad"], found["beta_rad"], found["alpha_rad"]]
    np.testing.assert_allclose(values, [gamma, beta, alpha], atol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_li_angles_name_their_singularity(sign: float) -> None:
    rotation = Rotation.from_euler("y", sign * np.pi / 2.0).as_matrix()
    found = li_angles(make_transform(rotation.T, np.zeros(3)))
    assert found == {
        "alpha_rad": None,
        "beta_rad": pytest.approx(sign * np.pi / 2.0),
        "gamma_rad": None,
        "singular": True,
    }


def test_a_file_name_in_a_note_may_be_no_text(tmp_path: Path) -> None:
    estimate = replace(estimate_at(np.eye(4)), notes=("read \udcff.pcd",))
    for suffix in (".json", ".toml"):
        path, *_ = write_result(tmp_path / f"a{suffix}", estimate, inputs=[])
        assert read_estimate(path).notes == ("read \\xff.pcd",)


def test_an_input_is_not_overwritten(tmp_path: Path) -> None:
    guess = tmp_path / "result.yaml"
    guess.write_text("T_camera_lidar: []")
    with pytest.raises(ExportError, match="never changed"):
        write_result(tmp_path / "result.json", estimate_at(np.eye(4)), inputs=[guess])
    assert list(tmp_path.iterdir()) == [guess]
    with pytest.raises(ExportError, match=r"Use .json or .toml"):
        result_paths(tmp_path / "result.yaml")


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"covariance": None}, "covariance must be 6 x 6 numbers"),
        ({"unobservable": ["x_m"]}, "covariance must be NaN where unobservable"),
        ({"unobservable": ["w"]}, "names no parameter"),
        ({"improved": "yes"}, "improved must be true or false"),
        ({"notes": "one"}, "notes must be a list of texts"),
        ({"basin": "wide"}, "basin is missing or no finite number"),
        ({"T_guess": [[1]]}, "T_guess must be 4 x 4"),
        ({"method": None}, "method must be text"),
        ({"T_camera_lidar": [[2]]}, "T_camera_lidar must be 4 x 4"),
    ],
)
def test_a_wrong_result_is_one_line(tmp_path: Path, change: Any, problem: str) -> None:
    path = tmp_path / "result.json"
    write_result(path, estimate_at(np.eye(4)), inputs=[])
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(SettingsError, match=problem) as caught:
        read_estimate(path)
    assert "\n" not in str(caught.value)
