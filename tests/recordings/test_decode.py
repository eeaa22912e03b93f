"""Every way in which a message says "missing", and every way in which it can contradict itself."""

import tracemalloc
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.decode import decode_message, stamp_of_value_ns
from fusion_core.recordings.units import depth_m_from_millimetres, millimetres_from_depth_m

HEADER = SimpleNamespace(
    stamp=SimpleNamespace(sec=1_700_000_000, nanosec=123_456_789), frame_id="/laser"
)


def header(sec: float = 1, nanosec: int = 0, frame_id: str = "laser") -> SimpleNamespace:
    return SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec), frame_id=frame_id)


def read(raw: Any, kind: str) -> Any:
    return decode_message(raw, kind, topic="/topic", received_ns=5)


def scan_message(ranges: list[float], **changes: Any) -> SimpleNamespace:
    values: dict[str, Any] = {
        "header": HEADER,
        "angle_min": -1.0,
        "angle_increment": 0.5,
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": float(np.float32(0.1)),
        "range_max": float(np.float32(5.6)),
        "ranges": np.array(ranges, dtype=np.float32),
        "intensities": np.zeros(0, dtype=np.float32),
    }
    return SimpleNamespace(**(values | changes))


def read_scan(ranges: list[float], **changes: Any) -> Any:
    return read(scan_message(ranges, **changes), "sensor_msgs/msg/LaserScan")


def test_values_of_a_beam_without_return() -> None:
    inf, nan = np.inf, np.nan
    # 0.1 and 5.6 as float32: the limit itself is a value at the near end, a sentinel at the far.
    scan = read_scan([0.0, inf, -inf, nan, -1.0, 0.099, 0.1, 5.599, 5.6, 5.601, 81.9])
    valid = np.isfinite(scan.ranges_m)
    assert valid.tolist() == [False] * 6 + [True, True] + [False] * 3
    assert scan.ranges_m.dtype == np.float64


def test_clocks_and_frame_of_a_scan() -> None:
    scan = read_scan([1.0, 2.0])
    assert scan.stamp_ns == 1_700_000_000_123_456_789
    assert scan.received_ns == 5
    assert scan.frame_id == "laser"
    assert scan.intensities is None


def test_unlimited_range_max() -> None:
    scan = read_scan([1.0, np.inf], range_max=np.inf)
    assert np.isfinite(scan.ranges_m).tolist() == [True, False]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"range_max": 0.0}, "range_max 0.0"),
        ({"range_max": np.nan}, "range_max nan"),
        ({"range_min": 6.0}, "range_min 6.0"),
        ({"angle_increment": 0.0}, "angle_increment 0.0"),
        ({"angle_min": np.nan}, "angle_min nan"),
        ({"header": header(frame_id="x" * 4097)}, "4097 characters"),
        ({"header": header(sec=-1, nanosec=5)}, "-1 s 5 ns"),
        ({"header": header(sec=2**31)}, "2147483648 s"),
        ({"header": header(sec=2**63 - 1)}, "9223372036854775807 s"),
        ({"header": header(sec=float("inf"))}, "promises"),
    ],
)
def test_scans_that_contradict_themselves(change: dict[str, Any], named: str) -> None:
    with pytest.raises(RecordingError, match=named) as caught:
        read_scan([1.0], **change)
    assert "/topic" in str(caught.value)
    assert caught.value.advice
    assert "\n" not in str(caught.value)


def test_signalling_nan() -> None:
    """Damaged bytes hold it, and a processor reports it where it is converted."""
    values = np.full(3, 0x7F800001, np.uint32).view(np.float32)
    raw = scan_message([], intensities=values)
    raw.ranges = values
    scan = read(raw, "sensor_msgs/msg/LaserScan")
    assert np.isnan(scan.ranges_m).all()
    assert np.isnan(scan.intensities).all()


@pytest.mark.parametrize(
    ("sec", "nanosec", "expected"),
    [(0, 0, 0), (2**31 - 1, 999_999_999, 2147483647999999999), (1, 2_000_000_000, 3_000_000_000)],
)
def test_stamps(sec: int, nanosec: int, expected: int) -> None:
    assert read_scan([1.0], header=header(sec, nanosec)).stamp_ns == expected


def test_limits_of_beams_and_name_lengths() -> None:
    name = "x" * 4096
    scan = read_scan([1.0] * 40_000, header=header(frame_id=name), angle_increment=1.5e-4)
    assert (scan.ranges_m.size, scan.frame_id) == (40_000, name)
    with pytest.raises(RecordingError, match="/topic: the scan claims 40001 beams"):
        read_scan([1.0] * 40_001, angle_increment=1.5e-4)


def test_scans_of_changing_length() -> None:
    assert [read_scan([1.0] * n).ranges_m.size for n in (3, 1, 5)] == [3, 1, 5]
    with pytest.raises(RecordingError, match="/topic: the scan has no ranges"):
        read_scan([])


def image(encoding: str, data: bytes, **changes: Any) -> SimpleNamespace:
    values: dict[str, Any] = {
        "header": HEADER,
        "height": 2,
        "width": 2,
        "encoding": encoding,
        "is_bigendian": 0,
        "step": len(data) // 2,
        "data": np.frombuffer(data, dtype=np.uint8),
    }
    return SimpleNamespace(**(values | changes))


def read_image(encoding: str, data: bytes, **changes: Any) -> Any:
    return read(image(encoding, data, **changes), "sensor_msgs/msg/Image")


@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_millimetres(encoding: str, order: str) -> None:
    data = np.array([[0, 1], [1500, 65535]], dtype=f"{order}u2").tobytes()
    value = read_image(encoding, data, is_bigendian=int(order == ">"))
    expected = np.array([[np.nan, 0.001], [1.5, np.nan]], dtype=np.float32)
    np.testing.assert_array_equal(value.depth_m, expected)
    assert value.encoding == "16UC1"


@pytest.mark.parametrize("order", ["<", ">"])
def test_metres(order: str) -> None:
    data = np.array([[0, 1.25], [np.inf, np.nan]], dtype=f"{order}f4").tobytes()
    value = read_image("32FC1", data, is_bigendian=int(order == ">"))
    expected = np.array([[np.nan, 1.25], [np.nan, np.nan]], dtype=np.float32)
    np.testing.assert_array_equal(value.depth_m, expected)
    assert value.depth_m.dtype == np.float32


def test_negative_metres_are_missing() -> None:
    data = np.array([[-1.0, -np.inf], [-0.0, 2.0]], dtype="<f4").tobytes()
    assert np.isfinite(read_image("32FC1", data).depth_m).tolist() == [[False] * 2, [False, True]]


def test_padding_is_dropped_and_may_lack_in_the_last_row() -> None:
    row_0, row_1 = np.array([1000, 2000], "<u2").tobytes(), np.array([3000, 4000], "<u2").tobytes()
    expected = np.array([[1, 2], [3, 4]], dtype=np.float32)
    for data in (row_0 + b"\xff\xff" + row_1 + b"\xff\xff", row_0 + b"\xff\xff" + row_1):
        np.testing.assert_array_equal(read_image("16UC1", data, step=6).depth_m, expected)


@pytest.mark.parametrize(
    ("encoding", "pixel"),
    [
        ("rgb8", [1, 2, 3]),
        ("bgr8", [3, 2, 1]),
        ("rgba8", [1, 2, 3, 255]),
        ("bgra8", [3, 2, 1, 255]),
    ],
)
def test_colours(encoding: str, pixel: list[int]) -> None:
    assert read_image(encoding, bytes(pixel * 4)).rgb.tolist() == [[[1, 2, 3]] * 2] * 2


def test_grey_becomes_three_equal_channels() -> None:
    assert read_image("mono8", bytes([1, 2, 3, 4])).rgb[1, 0].tolist() == [3, 3, 3]


def test_pixels_do_not_hold_the_buffer_they_came_from() -> None:
    data = np.arange(12, dtype=np.uint8)
    raw = image("rgb8", b"", step=6)
    raw.data = data
    value = read(raw, "sensor_msgs/msg/Image")
    assert not np.shares_memory(value.rgb, data)


@pytest.mark.parametrize(
    ("encoding", "data", "changes", "named"),
    [
        ("16UC1", bytes(8), {"height": 3, "step": 4}, "8 bytes"),
        ("16UC1", bytes(8), {"step": 3}, "step 3"),
        ("32FC1", bytes(8), {}, "step 4"),
        ("16UC1", b"", {"height": 0, "step": 4}, "2 x 0"),
        ("16UC1", bytes(8), {"height": 2**25, "step": 2**32 - 1}, "8 bytes"),
        ("16UC1", bytes(8), {"height": 2**32 - 1, "step": 2**32 - 1}, "2 x 4294967295"),
        ("bayer_rggb8", bytes(4), {}, "bayer_rggb8"),
        ("x" * 5000, bytes(4), {}, "xxx...'"),
        ("mono8", bytes(8), {"height": 2**14, "width": 2**13, "step": 2**13}, "more than"),
        ("mono8", bytes(8), {"header": header(sec=-4)}, "-4 s"),
    ],
)
def test_images_that_contradict_themselves(
    encoding: str, data: bytes, changes: dict[str, Any], named: str
) -> None:
    with pytest.raises(RecordingError, match=named) as caught:
        read_image(encoding, data, **changes)
    assert "/topic" in str(caught.value)
    assert caught.value.advice


def test_a_huge_step_takes_no_memory() -> None:
    """The step of a single row means nothing."""
    tracemalloc.start()
    try:
        row = read_image("16UC1", bytes([232, 3] * 4), height=1, width=4, step=2**32 - 1)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    assert row.depth_m.tolist() == [[1.0] * 4]


def info(k: list[float], spelled: str, **changes: Any) -> SimpleNamespace:
    matrices = {"K": np.array(k), "D": np.array([0.1, 0.2])}
    if spelled == "ROS 2":
        matrices = {name.lower(): value for name, value in matrices.items()}
    values = {"header": HEADER, "width": 320, "height": 240, "distortion_model": ""}
    return SimpleNamespace(**(values | matrices | changes))


@pytest.mark.parametrize("spelled", ["ROS 1", "ROS 2"])
def test_camera_info(spelled: str) -> None:
    raw = info([288.0, 0.0, 159.5, 0.0, 287.0, 119.5, 0.0, 0.0, 1.0], spelled)
    camera = read(raw, "sensor_msgs/msg/CameraInfo").intrinsics
    assert (camera.width, camera.height) == (320, 240)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (288.0, 287.0, 159.5, 119.5)
    assert camera.distortion == (0.1, 0.2)
    assert camera.distortion_model == "plumb_bob"


@pytest.mark.parametrize("spelled", ["ROS 1", "ROS 2"])
def test_uncalibrated_camera(spelled: str) -> None:
    assert read(info([0.0] * 9, spelled), "sensor_msgs/msg/CameraInfo").intrinsics is None


@pytest.mark.parametrize(
    ("place", "value"), [(0, np.nan), (2, np.inf), (4, 0.0), (4, -1.0), (5, np.nan)]
)
@pytest.mark.parametrize("coefficients", [0, 14])
def test_intrinsics_that_cannot_be_used(place: int, value: float, coefficients: int) -> None:
    k = [100.0, 0.0, 1.0, 0.0, 100.0, 1.0, 0.0, 0.0, 1.0]
    k[place] = value
    raw = info(k, "ROS 2", d=np.full(coefficients, 0.123456789))
    with pytest.raises(RecordingError, match=f"/topic: intrinsics .*{value:g}") as caught:
        read(raw, "sensor_msgs/msg/CameraInfo")
    assert "\n" not in str(caught.value)
    assert caught.value.advice


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"d": np.zeros(100_000)}, "100000 distortion coefficients"),
        ({"d": np.array([0.1, np.nan])}, "nan"),
        ({"distortion_model": "x" * 5000}, "5000 characters"),
        ({"header": header(sec=-1)}, "-1 s"),
    ],
)
def test_camera_infos_that_contradict_themselves(change: dict[str, Any], named: str) -> None:
    k = [100.0, 0.0, 1.0, 0.0, 100.0, 1.0, 0.0, 0.0, 1.0]
    with pytest.raises(RecordingError, match=named) as caught:
        read(info(k, "ROS 2", **change), "sensor_msgs/msg/CameraInfo")
    assert len(str(caught.value)) < 300


def test_a_camera_info_with_fewer_numbers_than_its_type_has() -> None:
    with pytest.raises(RecordingError, match="promises"):
        read(info([100.0, 0.0], "ROS 2"), "sensor_msgs/msg/CameraInfo")


def joints(names: list[str], position: list[float], velocity: list[float]) -> Any:
    raw = SimpleNamespace(
        header=HEADER,
        name=names,
        position=np.array(position),
        velocity=np.array(velocity),
        effort=np.zeros(0),
    )
    return read(raw, "sensor_msgs/msg/JointState")


def test_joints() -> None:
    value = joints(["left", "right"], [1.0, np.nan], [0.5, np.inf])
    assert value.names == ("left", "right")
    np.testing.assert_array_equal(value.positions, [1.0, np.nan])
    np.testing.assert_array_equal(value.velocities, [0.5, np.nan])
    assert (value.stamp_ns, value.received_ns) == (1_700_000_000_123_456_789, 5)


def test_joints_without_values() -> None:
    value = joints(["left"], [], [2.0])
    assert value.positions is None
    assert value.velocities.tolist() == [2.0]
    assert joints([], [], []).names == ()


@pytest.mark.parametrize(
    ("names", "position", "velocity", "named"),
    [
        (["left"], [1.0, 2.0], [], "1 joints have 2 positions"),
        (["left", "right"], [1.0, 2.0], [1.0], "2 joints have 1 velocities"),
        ([], [1.0], [], "0 joints have 1 positions"),
        (["x" * 4097], [1.0], [], "4097 characters"),
    ],
)
def test_joints_that_contradict_themselves(
    names: list[str], position: list[float], velocity: list[float], named: str
) -> None:
    with pytest.raises(RecordingError, match=named):
        joints(names, position, velocity)


def stamped(xyz: list[float], q: list[float]) -> SimpleNamespace:
    position = SimpleNamespace(**dict(zip("xyz", xyz, strict=True)))
    orientation = SimpleNamespace(**dict(zip("xyzw", q, strict=True)))
    return SimpleNamespace(
        header=HEADER, pose=SimpleNamespace(position=position, orientation=orientation)
    )


quaternions = st.lists(st.floats(-10, 10), min_size=4, max_size=4).filter(
    lambda q: float(np.linalg.norm(q)) > 1e-3
)


@given(quaternions)
def test_rotation_equals_scipy(q: list[float]) -> None:
    value = read(stamped([1.0, 2.0, 3.0], q), "geometry_msgs/msg/PoseStamped")
    expected = Rotation.from_quat(q).as_matrix()
    np.testing.assert_allclose(value.T_parent_child[:3, :3], expected, atol=1e-12)
    assert value.T_parent_child[:3, 3].tolist() == [1.0, 2.0, 3.0]
    assert value.T_parent_child[3].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert (value.parent, value.child) == ("laser", "")


@pytest.mark.parametrize(
    ("xyz", "q"),
    [
        ([0.0, np.nan, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ([0.0, np.inf, -np.inf], [0.0, 0.0, 0.0, 1.0]),
        ([0.0, 0.0, -1e300], [0.0, 0.0, 0.0, 1.0]),
        ([2e8, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]),
        ([0.0, 0.0, 0.0], [0.0, np.nan, 0.0, 1.0]),
        ([0.0, 0.0, 0.0], [0.0, np.inf, 0.0, 1.0]),
    ],
)
def test_invalid_poses(xyz: list[float], q: list[float]) -> None:
    with pytest.raises(RecordingError, match=r"/topic: (position|quaternion)"):
        read(stamped(xyz, q), "geometry_msgs/msg/PoseStamped")


def test_empty_batch_has_no_stamp() -> None:
    assert stamp_of_value_ns(read(SimpleNamespace(transforms=[]), "tf2_msgs/msg/TFMessage")) is None


def test_fields_of_another_type_are_an_error() -> None:
    with pytest.raises(RecordingError, match="LaserScan"):
        read(SimpleNamespace(header=HEADER), "sensor_msgs/msg/LaserScan")


@given(st.lists(st.integers(0, 65535), min_size=1, max_size=30))
def test_millimetres_round_trip(values: list[int]) -> None:
    depth_mm = np.array([values], dtype=np.uint16)
    back = millimetres_from_depth_m(depth_m_from_millimetres(depth_mm))
    expected = np.where(depth_mm == 65535, 0, depth_mm)
    np.testing.assert_array_equal(back, expected)


def test_metres_that_do_not_fit_are_missing() -> None:
    depth_m = np.array([[np.nan, 65.534, 65.535, 70.0, -1.0, np.inf, 0.0004]], dtype=np.float32)
    assert millimetres_from_depth_m(depth_m).tolist() == [[0, 65534, 0, 0, 0, 0, 0]]
