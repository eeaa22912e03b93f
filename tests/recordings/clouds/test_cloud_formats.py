"""Clouds of every layout: as Open3D writes them, as other people wrote them, and byte by byte."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import RecordingError
from fusion_core.recordings.clouds.formats import read_cloud

rng = np.random.default_rng(7)
XYZ = rng.normal(scale=20.0, size=(200, 3)).astype(np.float32)
INTENSITY = rng.integers(0, 255, 200).astype(np.float32)
PCD_TYPES = {"f4": "F 4", "f8": "F 8", "u1": "U 1", "u2": "U 2", "i4": "I 4", "i8": "I 8"}
PLY_TYPES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "uint16", "i4": "int"}


def rows(dtype: str, **columns: Any) -> np.ndarray:
    """A structured array of the fields in ``dtype`` (name:type, in order); others are zero."""
    fields = [tuple(field.split(":")) for field in dtype.split()]
    table = np.zeros(len(XYZ), [(name, kind) for name, kind in fields])
    for name, values in columns.items():
        table[name] = values
    return table


def xyzi(dtype: str, name: str = "intensity") -> np.ndarray:
    columns = dict(zip("xyz", XYZ.T, strict=True))
    return rows(dtype, **columns, **{name: INTENSITY})


def pcd_header(table: np.ndarray, storage: str, **changed: str) -> bytes:
    names = table.dtype.names
    kinds = [PCD_TYPES[table.dtype[name].str[1:]].split() for name in names]
    entries = {
        "VERSION": "0.7",
        "FIELDS": " ".join(names),
        "SIZE": " ".join(size for _, size in kinds),
        "TYPE": " ".join(kind for kind, _ in kinds),
        "COUNT": " ".join("1" for _ in names),
        "WIDTH": str(len(table)),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(len(table)),
        "DATA": storage,
        **changed,
    }
    lines = [f"{key} {value}" for key, value in entries.items() if value]
    return "\n".join(["# .PCD v0.7 - Point Cloud Data file format", *lines, ""]).encode()


def as_text(table: np.ndarray) -> bytes:
    return "".join(" ".join(str(v) for v in row.tolist()) + "\n" for row in table).encode()


def literals(content: bytes) -> bytes:
    """An LZF stream that copies nothing."""
    pieces = [content[at : at + 32] for at in range(0, len(content), 32)]
    return b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)


def compressed(table: np.ndarray) -> bytes:
    content = b"".join(table[name].tobytes() for name in table.dtype.names)
    packed = literals(content)
    return struct.pack("<II", len(packed), len(content)) + packed


def ply_header(table: np.ndarray, storage: str, before: str = "") -> bytes:
    names = table.dtype.names
    properties = [f"property {PLY_TYPES[table.dtype[name].str[1:]]} {name}" for name in names]
    lines = ["ply", f"format {storage} 1.0", "comment by hand", before]
    lines += [f"element vertex {len(table)}", *properties, "end_header", ""]
    return "\n".join(line for line in lines if line or line is lines[-1]).encode()


def write(folder: Path, name: str, content: bytes) -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def assert_is_the_cloud(path: Path, count: int = 200, **tolerance: float) -> None:
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.xyz_m, XYZ[:count], **{"rtol": 1e-6, **tolerance})
    np.testing.assert_array_equal(cloud.intensity, INTENSITY[:count])


@pytest.mark.parametrize("suffix", ["ply", "pcd"])
@pytest.mark.parametrize("options", [{}, {"write_ascii": True}, {"compressed": True}], ids=str)
def test_as_open3d_writes_them(tmp_path: Path, suffix: str, options: dict[str, bool]) -> None:
    import open3d as o3d

    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(XYZ))
    cloud.point.intensity = o3d.core.Tensor(INTENSITY[:, None])
    cloud.point.colors = o3d.core.Tensor(rng.integers(0, 255, (200, 3)).astype(np.uint8))
    path = tmp_path / f"cloud.{suffix}"
    assert o3d.t.io.write_point_cloud(str(path), cloud, **options)
    assert_is_the_cloud(path, rtol=1e-4)


LAYOUTS = {
    "x:f4 y:f4 z:f4 intensity:f4": "intensity",
    "ring:u2 z:f8 intensity:u1 y:f8 x:f8 t:f8": "intensity",
    "i:u2 X:f4 Y:f4 Z:f4": "i",
    "x:f4 reflectance:f4 y:f4 z:f4": "reflectance",
    "x:f8 y:f8 z:f8 scalar_Intensity:f4": "scalar_Intensity",
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("storage", ["ascii", "binary", "binary_compressed"])
def test_pcd_by_bytes(tmp_path: Path, layout: str, storage: str) -> None:
    table = xyzi(layout.lower() if "X" in layout else layout, LAYOUTS[layout])
    if "X" in layout:
        table.dtype.names = tuple(field.split(":")[0] for field in layout.split())
    data = {"ascii": as_text, "binary": np.ndarray.tobytes, "binary_compressed": compressed}
    path = write(tmp_path, "any name", pcd_header(table, storage) + data[storage](table))
    assert_is_the_cloud(path)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("storage", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_by_bytes(tmp_path: Path, layout: str, storage: str) -> None:
    table = xyzi(layout.lower(), LAYOUTS[layout].lower())
    swapped = table.astype(table.dtype.newbyteorder(">"))
    data = {"ascii": as_text(table), "binary_big_endian": swapped.tobytes()}
    path = write(tmp_path, "n", ply_header(table, storage) + data.get(storage, table.tobytes()))
    assert_is_the_cloud(path)


def test_kitti_bin(tmp_path: Path) -> None:
    values = np.column_stack([XYZ, INTENSITY]).astype("<f4")
    assert_is_the_cloud(write(tmp_path, "0.bin", values.tobytes()))


def test_other_elements_before_the_vertices_of_a_ply(tmp_path: Path) -> None:
    table = xyzi("x:f4 y:f4 z:f4 intensity:f4")
    before = "element camera 2\nproperty float a\nproperty uchar b"
    head = ply_header(table, "binary_little_endian", before)
    assert_is_the_cloud(write(tmp_path, "a.ply", head + bytes(10) + table.tobytes()))
    head = ply_header(table, "ascii", before)
    assert_is_the_cloud(write(tmp_path, "b.ply", head + b"1 2\n3 4\n" + as_text(table)))


def test_fields_of_several_numbers_and_old_headers(tmp_path: Path) -> None:
    table = np.zeros(200, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("_", "u1", 4), ("i", "f4")])
    for name, column in zip("xyz", XYZ.T, strict=True):
        table[name] = column
    table["i"] = INTENSITY
    head = (
        b"COLUMNS x y z _ i\nSIZE 4 4 4 1 4\nTYPE F F F U F\nCOUNT 1 1 1 4 1\nPOINTS 200\n"
        b"DATA binary\n"
    )
    assert_is_the_cloud(
        write(tmp_path, "a.pcd", b"# made by hand\nVERSION .5\n" + head + bytes(table))
    )
    assert_is_the_cloud(write(tmp_path, "b.pcd", (head + bytes(table))))


def test_the_first_of_two_fields_of_one_name_counts(tmp_path: Path) -> None:
    table = xyzi("x:f4 y:f4 z:f4 intensity:f4")
    head = pcd_header(table, "binary", FIELDS="x y z X")
    cloud = read_cloud(write(tmp_path, "a.pcd", head + table.tobytes()))
    np.testing.assert_array_equal(cloud.xyz_m, XYZ)
    assert cloud.intensity is None


def test_missing_points_keep_their_place(tmp_path: Path) -> None:
    table = xyzi("x:f4 y:f4 z:f4 intensity:f4")
    table["x"][:2] = np.nan, np.inf
    for name in "xyz":
        table[name][2] = 0.0
    table["intensity"][3] = np.inf
    for storage, data in (("ascii", as_text(table)), ("binary", table.tobytes())):
        cloud = read_cloud(write(tmp_path, "a", pcd_header(table, storage) + data))
        assert np.isnan(cloud.xyz_m[:3]).all()
        assert np.isfinite(cloud.xyz_m[3:]).all()
        assert cloud.intensity is not None
        assert np.isnan(cloud.intensity[3])
        assert np.isfinite(np.delete(cloud.intensity, 3)).all()


def test_millimetres_are_refused(tmp_path: Path) -> None:
    table = xyzi("x:f4 y:f4 z:f4 intensity:f4")
    for name in "xyz":
        table[name] *= 1000.0
    path = write(tmp_path, "a.pcd", pcd_header(table, "binary") + table.tobytes())
    with pytest.raises(RecordingError, match=r"more than \d+ m from the origin. Lengths are in m"):
        read_cloud(path)


def test_a_cloud_without_intensity(tmp_path: Path) -> None:
    table = rows("x:f4 y:f4 z:f4 rgb:u1", **dict(zip("xyz", XYZ.T, strict=True)))
    cloud = read_cloud(write(tmp_path, "a", pcd_header(table, "binary") + table.tobytes()))
    assert cloud.intensity is None


@pytest.mark.parametrize("storage", ["ascii", "binary"])
def test_what_is_there_of_a_file_that_was_cut_short(tmp_path: Path, storage: str) -> None:
    table = xyzi("x:f4 y:f4 z:f4 intensity:f4")
    data = as_text(table) if storage == "ascii" else table.tobytes()
    whole = 150
    end = len(b"".join(data.splitlines(True)[:whole])) if storage == "ascii" else 16 * whole
    for name, head in (
        ("a.pcd", pcd_header(table, storage)),
        ("a.ply", ply_header(table, "ascii" if storage == "ascii" else "binary_little_endian")),
    ):
        path = write(tmp_path, name, head + data[: end + 7])
        with pytest.raises(RecordingError, match="cut short: 150 of 200 points"):
            read_cloud(path)
        warnings: list[str] = []
        cloud = read_cloud(path, warnings)
        assert warnings == [f"{name}: It is cut short: 150 of 200 points are there."]
        np.testing.assert_allclose(cloud.xyz_m, XYZ[:whole], rtol=1e-6)


def test_a_compressed_file_that_was_cut_short(tmp_path: Path) -> None:
    table = xyzi("x:f4 y:f4 z:f4 intensity:f4")
    content = pcd_header(table, "binary_compressed") + compressed(table)
    warnings: list[str] = []
    # The z of each point begins at 2/3 of the coordinates.
    path = write(tmp_path, "a.pcd", content[: -int(0.3 * 200 * 16 * 33 / 32)])
    cloud = read_cloud(path, warnings)
    whole = int(np.isfinite(cloud.xyz_m).all(axis=1).sum())
    assert 150 < whole < 200
    assert warnings == [f"a.pcd: It is cut short: {whole} of 200 points have x, y and z."]
    np.testing.assert_array_equal(cloud.xyz_m[:whole], XYZ[:whole])


def test_damaged_lines_cost_their_points_alone(tmp_path: Path) -> None:
    table = xyzi("x:f4 y:f4 z:f4 intensity:f4")
    lines = as_text(table).splitlines(True)
    lines[5], lines[9] = b"1 2 3\n", b"1 2 three 4 \n"
    warnings: list[str] = []
    cloud = read_cloud(
        write(tmp_path, "a.pcd", pcd_header(table, "ascii") + b"".join(lines)), warnings
    )
    assert warnings == ["a.pcd: 2 of its lines are damaged; their points are left out."]
    assert np.flatnonzero(np.isnan(cloud.xyz_m[:, 0])).tolist() == [5, 9]


PLAIN = xyzi("x:f4 y:f4 z:f4 intensity:f4")
HUGE = {"WIDTH": "4000000000", "POINTS": "4000000000"}


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("a.pcd", b"", "is empty"),
        ("a.bin", b"\x00" * 17, "17 bytes are no multiple of 16"),
        ("a.bin", bytes(range(256)), "first points are not where a LiDAR measures"),
        (
            "a.bin",
            np.column_stack([XYZ, INTENSITY]).tobytes() + b"\xff" * 9600,
            "600 of 800 points are not where a LiDAR measures",
        ),
        ("a.pcd", b"solid cube\n", "no known format"),
        ("a.pcd", b"# .PCD v0.7\n", "does not end with a line DATA"),
        ("a.pcd", pcd_header(PLAIN, "binary", **HUGE), "claims 4000000000 points"),
        ("a.pcd", pcd_header(PLAIN, "binary", POINTS="0", WIDTH="0"), "has no points"),
        ("a.pcd", pcd_header(PLAIN, "binary", POINTS="9" * 5000), "states POINTS '999"),
        ("a.pcd", pcd_header(PLAIN, "binary", POINTS="-3"), "states POINTS '-3'"),
        ("a.pcd", pcd_header(PLAIN, "binary", WIDTH="7"), "states 7 x 1 and 200 points"),
        ("a.pcd", pcd_header(PLAIN, "binary", FIELDS="x y intensity w"), "no field z; its fields"),
        ("a.pcd", pcd_header(PLAIN, "binary", SIZE="4 4 4"), "4 FIELDS, 3 SIZE"),
        ("a.pcd", pcd_header(PLAIN, "binary", SIZE="4 4 4 3"), "'intensity' is of type 'F'"),
        (
            "a.pcd",
            pcd_header(PLAIN, "binary", COUNT="1 1 1 99999999"),
            "4 fields of 400000008 bytes",
        ),
        ("a.pcd", pcd_header(PLAIN, "binary_zstd"), "its data are 'binary_zstd'"),
        ("a.pcd", pcd_header(PLAIN, "binary"), "no point with a finite position"),
        ("a.pcd", pcd_header(PLAIN, "ascii") + b"1" * 100_000, "a line has more than"),
        ("a.pcd", pcd_header(PLAIN, "binary_compressed"), "no point is there"),
        (
            "a.pcd",
            pcd_header(PLAIN, "binary_compressed") + struct.pack("<II", 20, 3200) + bytes(20),
            "20 compressed bytes cannot hold 3200",
        ),
        (
            "a.pcd",
            pcd_header(PLAIN, "binary_compressed") + struct.pack("<II", 99, 4_000_000_000),
            "claims 4000000000 bytes, 200 points have 3200",
        ),
        (
            "a.pcd",
            pcd_header(PLAIN, "binary_compressed") + struct.pack("<II", 99, 3200) + b"\xff\xff\xff",
            "damaged at byte 0",
        ),
        ("a.ply", b"ply\n", "header does not end"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "has no vertices"),
        ("a.ply", b"ply\nformat text 1.0\n", "its format is 'text'"),
        ("a.ply", b"ply\nend_header\n", "does not state the format"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex many\n",
            "the line 'element vertex many'",
        ),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\n"
            b"property float y\nproperty float z\nend_header\n",
            "claims 99999999999 points",
        ),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement a 999999999999999999\n"
            b"property float x\nelement vertex 3\nend_header\n",
            "claims 999999999999999999 of 'a'",
        ),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement face 3\n"
            b"property list uchar int vertex_indices\nelement vertex 3\nend_header\n",
            "lists of 'face' stand before its vertices",
        ),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path: Path, name: str, content: bytes, problem: str) -> None:
    path = write(tmp_path, name, content)
    with pytest.raises(RecordingError, match=problem) as caught:
        read_cloud(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none.pcd"):
        with pytest.raises(RecordingError, match="cannot be read"):
            read_cloud(path)


@given(st.data())
def test_any_bytes_are_a_cloud_or_an_error(tmp_path_factory: Any, data: st.DataObject) -> None:
    heads = [
        pcd_header(PLAIN, "ascii"),
        pcd_header(PLAIN, "binary"),
        pcd_header(PLAIN, "binary_compressed") + struct.pack("<II", 60, 3200),
        ply_header(PLAIN, "ascii"),
        ply_header(PLAIN, "binary_big_endian"),
        b"",
    ]
    content = bytearray(data.draw(st.sampled_from(heads)) + data.draw(st.binary(max_size=400)))
    for at in data.draw(st.lists(st.integers(0, max(0, len(content) - 1)), max_size=4)):
        content[at : at + 1] = data.draw(st.binary(max_size=2))
    path = tmp_path_factory.mktemp("any") / "a.bin"
    path.write_bytes(content)
    try:
        cloud = read_cloud(path, [])
    except RecordingError:
        return
    assert np.isfinite(cloud.xyz_m).any()


@pytest.mark.data
@pytest.mark.parametrize("name", ["opencalib_street/calib.pcd", "opencalib_manual/0.pcd"])
def test_clouds_of_other_people_as_open3d_reads_them(data_folder: Path, name: str) -> None:
    import open3d as o3d

    path = data_folder / "real/calibration" / name
    ours, theirs = read_cloud(path), o3d.t.io.read_point_cloud(str(path))
    np.testing.assert_array_equal(ours.xyz_m, theirs.point.positions.numpy())
    np.testing.assert_array_equal(ours.intensity, theirs.point.intensity.numpy()[:, 0])


@pytest.mark.data
def test_kitti_as_numpy_reads_it(data_folder: Path) -> None:
    path = data_folder / "real/calibration/kitti_000000/000000.bin"
    ours, theirs = read_cloud(path), np.fromfile(path, np.float32).reshape(-1, 4)
    np.testing.assert_array_equal(ours.xyz_m, theirs[:, :3])
    np.testing.assert_array_equal(ours.intensity, theirs[:, 3])
