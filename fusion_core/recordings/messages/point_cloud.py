"""sensor_msgs/PointCloud2 to points, with any field layout, byte order and padding."""

from typing import Any

import numpy as np

from fusion_core.model.conventions import NS_PER_S, Float32Array, FloatArray, RingArray
from fusion_core.recordings.messages.bad_message import BadMessage

# Set by hand, above any scanner's cloud; keeps the values and masks well below 256 MiB.
MAX_POINTS = 1 << 23
# PointField's INT8 to FLOAT64.
_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_AXES = ("x", "y", "z")
_TIME_FIELDS = ("time", "t", "offset_time", "timestamp")
_RING_FIELDS = ("ring", "line")
# The year 5138 in seconds: what is greater is nanoseconds.
_SECONDS_MAX = 1e11
_OFFSET_MAX_S = 10.0


def read_points(raw: Any) -> tuple[Float32Array, Float32Array | None]:
    """(N, 3) metres and (N,) intensity of a cloud, in its order; None if it has no intensity.

    A point is NaN if a coordinate is not finite, regardless of ``is_dense``, or if all are 0, which
    some drivers use for a missing point. Other fields are ignored.

    Raises BadMessage for a cloud whose sizes, fields and data contradict each other.
    """
    width, height = int(raw.width), int(raw.height)
    count = width * height
    if count > MAX_POINTS:
        raise BadMessage(
            f"the cloud claims {width} x {height} points, more than {MAX_POINTS}",
            "The message is damaged; leave the topic out.",
        )
    fields = {field.name: field for field in reversed(raw.fields)}
    with_intensity = "intensity" in fields
    xyz_m = np.empty((count, 3), np.float32)
    intensity = np.empty(count, np.float32) if with_intensity else None
    if count == 0:
        return xyz_m, intensity
    _check_data(raw, width, height)
    # A float64 beyond float32 becomes infinite, and then NaN; a signalling NaN is one as well.
    with np.errstate(over="ignore", invalid="ignore"):
        for axis, name in enumerate(_AXES):
            xyz_m.reshape(height, width, 3)[:, :, axis] = _column(raw, fields, name)
        if intensity is not None:
            intensity.reshape(height, width)[:] = _column(raw, fields, "intensity")
            intensity[~np.isfinite(intensity)] = np.nan
        xyz_m[~np.isfinite(xyz_m).all(axis=1) | ~xyz_m.any(axis=1)] = np.nan
    return xyz_m, intensity


def read_offsets(raw: Any, stamp_ns: int) -> FloatArray | None:
    """(N,) seconds from a cloud's stamp to each point's instant; None where no field gives it.

    Drivers have ``time`` in seconds (Velodyne) or ``t`` and ``offset_time`` in whole nanoseconds
    (Ouster, Livox) since the stamp, or ``timestamp`` in seconds or nanoseconds since 1970. NaN
    where a value is not finite or is further from the stamp than a scan lasts.
    """
    fields = {field.name: field for field in reversed(raw.fields)}
    name = next((name for name in _TIME_FIELDS if name in fields), None)
    if name is None or int(raw.width) * int(raw.height) == 0:
        return None
    # Checked when the coordinates were read.
    values = _column(raw, fields, name)
    is_whole = values.dtype.kind in "iu"
    with np.errstate(over="ignore", invalid="ignore"):
        if name == "timestamp":
            # In float64 a time of today is exact to a fraction of a microsecond.
            scale = 1.0 if is_whole or np.nanmax(np.abs(values)) > _SECONDS_MAX else NS_PER_S
            since = values - (stamp_ns if scale == 1.0 else stamp_ns / NS_PER_S)
            offsets = since.astype(np.float64) * (scale / NS_PER_S)
        else:
            offsets = values.astype(np.float64) / (NS_PER_S if is_whole else 1.0)
        offsets[~(np.abs(offsets) <= _OFFSET_MAX_S)] = np.nan
    return offsets.reshape(-1)


def read_rings(raw: Any) -> RingArray | None:
    """(N,) the number of the laser of each point; None where no field gives it."""
    fields = {field.name: field for field in reversed(raw.fields)}
    name = next((name for name in _RING_FIELDS if name in fields), None)
    if name is None or int(raw.width) * int(raw.height) == 0:
        return None
    values = _column(raw, fields, name)
    if values.dtype.kind not in "iu":
        return None
    return values.reshape(-1).astype(np.uint16)


def _check_data(raw: Any, width: int, height: int) -> None:
    row_bytes, row_step = width * int(raw.point_step), int(raw.row_step)
    # Some drivers leave row_step at 0 in unordered clouds, which have one row.
    if height > 1 and row_step < row_bytes:
        raise BadMessage(
            f"rows of {width} points of {raw.point_step} bytes cannot have row_step {row_step}",
            "Check the driver that publishes the cloud.",
        )
    needed = (height - 1) * row_step + row_bytes
    if raw.data.nbytes < needed:
        raise BadMessage(
            f"the cloud holds {raw.data.nbytes} bytes, {width} x {height} points need {needed}",
            "The message was cut short; record again or leave the topic out.",
        )


def _column(raw: Any, fields: dict[str, Any], name: str) -> np.ndarray[Any, Any]:
    """(H, W) view of one field."""
    field = fields.get(name)
    if field is None:
        raise BadMessage(f"the cloud has no field {name}", "Name another topic.")
    # Old drivers write a count of 0 for 1.
    if field.datatype not in _DTYPES or field.count > 1:
        raise BadMessage(
            f"field {name} is of datatype {field.datatype}, {field.count} a point",
            "A coordinate and an intensity are one number of datatype 1 to 8.",
        )
    dtype = np.dtype((">" if raw.is_bigendian else "<") + _DTYPES[field.datatype])
    point_step, offset = int(raw.point_step), int(field.offset)
    if offset + dtype.itemsize > point_step:
        raise BadMessage(
            f"field {name} at byte {offset} reaches beyond a point of {point_step} bytes",
            "Check the driver that publishes the cloud.",
        )
    strides = (int(raw.row_step), point_step)
    return np.ndarray((int(raw.height), int(raw.width)), dtype, raw.data, offset, strides)
