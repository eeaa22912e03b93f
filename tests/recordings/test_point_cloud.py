"""PointCloud2 of any layout, against struct.unpack point by point."""

import math
import struct
import tracemalloc
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError
from fusion_core.model.sensors import PointCloud
from fusion_core.recordings.decode import decode_message

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=7, nanosec=5), frame_id="/velodyne")
LETTERS = {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 8: "d"}
NUMBERS = st.one_of(
    st.integers(-100, 100), st.floats(-1e4, 1e4), st.sampled_from([math.nan, math.inf, 1e300])
)


def field(name: str, offset: int, datatype: int = 7, count: int = 1) -> SimpleNamespace:
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


XYZ = [field("x", 0), field("y", 4), field("z", 8)]


def cloud(values: list[float], **changes: Any) -> SimpleNamespace:
    data = struct.pack(f"<{len(values)}f", *values)
    defaults: dict[str, Any] = {
        "header": HEADER,
        "height": 1,
        "width": len(values) // 3,
        "fields": XYZ,
        "is_bigendian": False,
        "point_step": 12,
        "row_step": len(data),
        "data": np.frombuffer(data, np.uint8),
        "is_dense": True,
    }
    return SimpleNamespace(**(defaults | changes))


def read(raw: Any) -> Any:
    return decode_message(raw, "sensor_msgs/msg/PointCloud2", topic="/points", received_ns=9)


def test_plain_cloud() -> None:
    value = read(cloud([1, 2, 3, 4, 5, 6]))
    assert isinstance(value, PointCloud)
    assert value.xyz_m.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert value.xyz_m.dtype == np.float32
    assert value.intensity is None
    assert (value.stamp_ns, value.received_ns, value.frame_id) == (7_000_000_005, 9, "velodyne")


def test_points_without_a_position_keep_their_place() -> None:
    """Whatever is_dense says; some drivers write 0 0 0 for a missing point."""
    nan, inf = math.nan, math.inf
    value = read(cloud([1, 2, 3, nan, 5, 6, 7, inf, 9, 0, 0, 0, 0, 0, 1]))
    assert np.isfinite(value.xyz_m).all(axis=1).tolist() == [True, False, False, False, True]
    assert np.isnan(value.xyz_m[1:4]).all()


@st.composite
def layouts(draw: st.DrawFn) -> tuple[SimpleNamespace, list[list[float]]]:
    """A cloud of any field types, order, gaps, byte order and padding, and what it holds."""
    order = draw(st.sampled_from("<>"))
    names = draw(st.permutations(["x", "y", "z", "intensity", "ring"]))
    offset, fields = 0, []
    for name in names:
        offset += draw(st.integers(0, 3))
        datatype = draw(st.sampled_from(list(LETTERS)))
        fields.append(field(name, offset, datatype, draw(st.integers(0, 1))))
        offset += struct.calcsize("<" + LETTERS[datatype])
    point_step = offset + draw(st.integers(0, 3))
    height, width = draw(st.integers(1, 3)), draw(st.integers(1, 4))
    row_step = width * point_step + draw(st.integers(0, 5))
    # Every number of bytes is some value, and NaN and infinities come up as well.
    data = draw(st.binary(min_size=row_step * height, max_size=row_step * height))
    packed = bytearray(data)
    for f in fields:
        if f.datatype in (7, 8):
            for row in range(height):
                for column in range(width):
                    at = row * row_step + column * point_step + f.offset
                    number = draw(NUMBERS)
                    if f.datatype == 7 and abs(number) == 1e300:
                        number = math.inf
                    struct.pack_into(order + LETTERS[f.datatype], packed, at, number)
    points = []
    for row in range(height):
        for column in range(width):
            at = row * row_step + column * point_step
            unpacked = {
                f.name: struct.unpack_from(order + LETTERS[f.datatype], packed, at + f.offset)[0]
                for f in fields
            }
            points.append([float(unpacked[n]) for n in ("x", "y", "z", "intensity")])
    # The last row may lack its padding.
    end = len(packed) - draw(st.integers(0, row_step - width * point_step))
    raw = cloud(
        [],
        height=height,
        width=width,
        fields=fields,
        is_bigendian=order == ">",
        point_step=point_step,
        row_step=row_step,
        data=np.frombuffer(bytes(packed[:end]), np.uint8),
    )
    return raw, points


@given(layouts())
def test_any_layout(layout: tuple[SimpleNamespace, list[list[float]]]) -> None:
    raw, points = layout
    value = read(raw)
    for found, strength, expected in zip(value.xyz_m, value.intensity, points, strict=True):
        with np.errstate(over="ignore"):
            *xyz, intensity = np.array(expected).astype(np.float32)
        if np.isfinite(xyz).all() and any(xyz):
            assert found.tolist() == [float(v) for v in xyz]
        else:
            assert np.isnan(found).all()
        assert strength == intensity if np.isfinite(intensity) else np.isnan(strength)


@pytest.mark.parametrize(("datatype", "bits"), [(7, 0x7F800001), (8, 0x7FF0000000000001)])
def test_signalling_nan(datatype: int, bits: int) -> None:
    """Damaged bytes hold it, and a processor reports it where it is converted."""
    size = struct.calcsize(LETTERS[datatype])
    fields = [field(n, size * k, datatype) for k, n in enumerate(["x", "y", "z", "intensity"])]
    data = np.frombuffer(bits.to_bytes(size, "little") * 8, np.uint8)
    value = read(cloud([], width=2, fields=fields, point_step=4 * size, data=data))
    assert np.isnan(value.xyz_m).all()
    assert np.isnan(value.intensity).all()


def test_an_empty_cloud() -> None:
    for fields in (XYZ, []):
        value = read(cloud([], fields=fields, point_step=0))
        assert value.xyz_m.shape == (0, 3)


def test_row_step_of_a_single_row_is_not_needed() -> None:
    assert read(cloud([1, 2, 3, 4, 5, 6], row_step=0)).xyz_m.shape == (2, 3)


def test_values_do_not_hold_the_messages_buffer() -> None:
    raw = cloud([1, 2, 3], fields=[*XYZ, field("intensity", 8)])
    value = read(raw)
    assert not np.shares_memory(value.xyz_m, raw.data)
    assert not np.shares_memory(value.intensity, raw.data)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"width": 3}, "24 bytes, 3 x 1 points need 36"),
        ({"height": 2}, "need 48"),
        ({"height": 2, "width": 1, "row_step": 4}, "row_step 4"),
        ({"height": 2, "width": 1, "row_step": 2**32 - 1}, "24 bytes"),
        ({"point_step": 2**32 - 1}, "24 bytes"),
        ({"point_step": 11, "row_step": 22}, "beyond a point of 11 bytes"),
        ({"width": 2**32 - 1, "height": 2**32 - 1}, "more than"),
        ({"width": 2**32 - 1, "point_step": 0}, "more than"),
        ({"width": 1000, "point_step": 0, "row_step": 0}, "beyond a point of 0"),
        ({"fields": XYZ[:2]}, "no field z"),
        ({"fields": [*XYZ[:2], field("z", 2**32 - 1)]}, "byte 4294967295"),
        ({"fields": [*XYZ[:2], field("z", 8, datatype=9)]}, "datatype 9"),
        ({"fields": [*XYZ[:2], field("z", 8, count=2**32 - 1)]}, "4294967295 a point"),
        ({"fields": [*XYZ, field("intensity", 8, count=3)]}, "intensity"),
    ],
)
def test_clouds_that_contradict_themselves(changes: dict[str, Any], named: str) -> None:
    raw = cloud([1, 2, 3, 4, 5, 6], **changes)
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match=named) as caught:
            read(raw)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    assert caught.value.advice
    assert "\n" not in str(caught.value)


def test_fields_that_are_not_used_may_be_anything() -> None:
    odd = [field("rgb", 2**32 - 1, 99, 2**32 - 1), field("x", 8)]
    assert read(cloud([1, 2, 3], fields=[*XYZ, *odd])).xyz_m.tolist() == [[1, 2, 3]]


TIMES = [("time", "<f4", 7, 0.025), ("t", "<u4", 6, 25_000_000), ("offset_time", "<u4", 6, 25e6)]
STAMP_NS = 7_000_000_005
TIMES += [
    ("timestamp", "<f8", 8, STAMP_NS * 1e-9 + 0.025),
    ("timestamp", "<f8", 8, 1.7e18),
    ("time", "<f8", 8, math.nan),
    ("time", "<f4", 7, 1e30),
]


@pytest.mark.parametrize(("name", "kind", "datatype", "value"), TIMES)
def test_a_point_knows_its_instant(name: str, kind: str, datatype: int, value: float) -> None:
    """As Velodyne, Ouster, Livox and Hesai write it; what is no instant of the scan is NaN."""
    layout = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, kind), ("ring", "<u2")])
    points = np.zeros(2, layout)
    points["x"], points[name], points["ring"] = 1.0, value, [3, 15]
    fields = [*XYZ, field(name, 12, datatype), field("ring", layout.itemsize - 2, 4)]
    raw = cloud([], width=2, fields=fields, point_step=layout.itemsize, row_step=0)
    raw.data = points.view(np.uint8)
    read_back = read(raw)
    expected = 0.025 if 0 < value < 1e9 or value == 25e6 else math.nan
    if value == 1.7e18:
        expected = math.nan
    np.testing.assert_allclose(read_back.offsets_s, [expected] * 2, atol=1e-6)
    assert read_back.rings.tolist() == [3, 15]


def test_a_cloud_without_instants_and_rings_has_none() -> None:
    value = read(cloud([1, 2, 3]))
    assert value.offsets_s is None
    assert value.rings is None
