"""One line of a CARMEN log: its fields, its two clocks, and the values that it holds.

After the logger of CARMEN (carmen.sourceforge.net/logger_playback.html)::

    ODOM x y theta tv rv accel
    TRUEPOS true_x true_y true_theta odom_x odom_y odom_theta
    FLASER num_readings [ranges] x y theta odom_x odom_y odom_theta
    RAWLASER1 laser_type start_angle field_of_view angular_resolution maximum_range accuracy
        remission_mode num_readings [ranges] num_remissions [remissions]
    ROBOTLASER1 (as RAWLASER1) laser_pose (x y theta) robot_pose (x y theta) laser_tv laser_rv
        forward_safety_dist side_safety_dist turn_axis

each followed by ``ipc_timestamp ipc_hostname logger_timestamp``: metres, radians, seconds.
"""

from dataclasses import dataclass
from math import isfinite, radians

import numpy as np

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import POSITION_MAX_M
from fusion_core.model.sensors import LaserScan
from fusion_core.model.sweep import ImplausibleSweep, require_plausible_sweep
from fusion_core.recordings.decimal_time import ns_from_decimal_seconds
from fusion_core.recordings.quoting import quote_clipped
from fusion_core.recordings.units import ranges_m

# SICK LMS and PLS measure in centimetres of 13 bits; 8183 and above are codes (out of range,
# dazzled, no signal), also where a log names 81.9 m as the maximum range.
SICK_FIRST_CODE_M = 81.83
_SICK_TYPES = (0, 1)

_CONFIG_FIELDS = 7
_STAMP_FIELDS = 3
# No number is written with more characters.
_MAX_NUMBER_CHARS = 40
# Readings of a SICK LMS: the resolution in degrees. An even number lacks the last beam.
SICK_RESOLUTIONS_DEG = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25}
_SICK_FIELDS_OF_VIEW_DEG = (100.0, 180.0, 270.0)


class BadLine(ValueError):
    """A line contradicts its format; the text says how."""


@dataclass(frozen=True, slots=True)
class LineKind:
    """The fields between the keyword and the stamps: ``body_fields`` follow the counted lists.

    ``has_config``: the line itself has the angles and limits of its readings.
    """

    body_fields: int
    has_readings: bool = False
    has_config: bool = False


_OLD_LASER = LineKind(body_fields=6, has_readings=True)
KINDS: dict[bytes, LineKind] = {
    b"ODOM": LineKind(body_fields=6),
    b"TRUEPOS": LineKind(body_fields=6),
    b"FLASER": _OLD_LASER,
    b"RLASER": _OLD_LASER,
    **{b"LASER%d" % n: _OLD_LASER for n in range(1, 6)},
    **{b"RAWLASER%d" % n: LineKind(0, has_readings=True, has_config=True) for n in range(1, 6)},
    **{b"ROBOTLASER%d" % n: LineKind(11, has_readings=True, has_config=True) for n in range(6)},
}


@dataclass(frozen=True, slots=True)
class CarmenLine:
    """The fields of a line as text. ``received_ns`` is None where the logger's stamp is missing.

    ``config`` and the lists are empty where the kind has none; ``body`` may be short in old logs.
    """

    stamp_ns: int
    received_ns: int | None
    config: list[bytes]
    readings: list[bytes]
    remissions: list[bytes]
    body: list[bytes]


@dataclass(frozen=True, slots=True)
class LaserDefaults:
    """A laser's values from PARAM lines, for lines without them; None where PARAM has none."""

    resolution_deg: float | None = None
    range_max_m: float | None = None


def parse_line(line: bytes) -> CarmenLine:
    """Split a line whose keyword is in KINDS. Raises BadLine."""
    fields = line.split()
    kind = KINDS[fields[0]]
    position = 1
    config: list[bytes] = []
    readings: list[bytes] = []
    remissions: list[bytes] = []
    if kind.has_config:
        config = fields[1 : 1 + _CONFIG_FIELDS]
        position += _CONFIG_FIELDS
    if kind.has_readings:
        readings, position = _take_counted_list(fields, position, "readings")
    if kind.has_config:
        remissions, position = _take_counted_list(fields, position, "remissions")
    tail = fields[position:]
    stamp, received, body = _split_stamps(tail, kind.body_fields)
    stamp_ns = _time_ns(stamp, "ipc timestamp")
    received_ns = None if received is None else _log_time_ns(received)
    return CarmenLine(stamp_ns, received_ns, config, readings, remissions, body)


def planar_pose(line: CarmenLine, first: int = 0) -> FloatArray:
    """(x, y, theta) at ``first`` in the body of a line. Raises BadLine."""
    fields = line.body[first : first + 3]
    if len(fields) < 3:
        raise BadLine(f"has {len(line.body)} fields where a pose should end at {first + 3}")
    pose = np.array([_number(field, "pose") for field in fields])
    farthest_m = float(np.abs(pose[:2]).max())
    if farthest_m > POSITION_MAX_M:
        raise BadLine(f"has a pose {farthest_m:g} m away, more than {POSITION_MAX_M:g} m")
    return pose


def laser_scan(
    line: CarmenLine, received_ns: int | None, frame_id: str, defaults: LaserDefaults
) -> LaserScan:
    """The readings of a line as a scan.

    A line without angles is a SICK's: 180 or 181 readings are 1 degree apart, 360 or 361 half a
    degree, 400 or 401 a quarter, others 180 degrees / (N - 1), unless ``defaults`` say it. The
    sweep is symmetric, but an even number that fills 100, 180 or 270 degrees lacks the last beam:
    180 readings go from -90 to +89 degrees, as CARMEN itself reads its old logs. Ranges from the
    maximum range on, and a SICK's codes, are NaN. Raises BadLine.
    """
    count = len(line.readings)
    if count == 0:
        raise BadLine("has no readings")
    if line.config:
        laser_type, start_rad, _, increment_rad, range_max_m = (
            _number(field, "configuration") for field in line.config[:5]
        )
        if increment_rad == 0.0:
            raise BadLine("has an angular resolution of 0")
        limit_m = min(range_max_m, SICK_FIRST_CODE_M) if laser_type in _SICK_TYPES else range_max_m
    else:
        start_rad, increment_rad = _sick_angles(count, defaults.resolution_deg)
        range_max_m = defaults.range_max_m or SICK_FIRST_CODE_M
        limit_m = min(range_max_m, SICK_FIRST_CODE_M)
    try:
        require_plausible_sweep(count, start_rad, increment_rad)
    except ImplausibleSweep as error:
        raise BadLine(f"is no scan: {error.problem}") from None
    if not range_max_m > 0.0:
        raise BadLine(f"has a maximum range of {range_max_m:g} m")
    ranges = _numbers(line.readings, "readings")
    has_remissions = len(line.remissions) == count
    return LaserScan(
        stamp_ns=line.stamp_ns,
        received_ns=received_ns,
        frame_id=frame_id,
        angle_min_rad=start_rad,
        angle_increment_rad=increment_rad,
        range_min_m=0.0,
        range_max_m=range_max_m,
        ranges_m=ranges_m(ranges, 0.0, limit_m),
        intensities=_numbers(line.remissions, "remissions") if has_remissions else None,
    )


def _sick_angles(count: int, resolution_deg: float | None) -> tuple[float, float]:
    """The first angle and the step, in radians."""
    if resolution_deg is None:
        resolution_deg = SICK_RESOLUTIONS_DEG.get(count, 180.0 / max(count - 1, 1))
    covered_deg = count * resolution_deg
    lacks_last = count % 2 == 0 and any(
        abs(covered_deg - full_deg) < 1e-6 for full_deg in _SICK_FIELDS_OF_VIEW_DEG
    )
    span_deg = resolution_deg * (count if lacks_last else count - 1)
    return radians(-0.5 * span_deg), radians(resolution_deg)


def _take_counted_list(fields: list[bytes], position: int, what: str) -> tuple[list[bytes], int]:
    """The list whose length is at ``position``, and its end."""
    if position >= len(fields):
        raise BadLine(f"ends before its number of {what}")
    text = fields[position]
    # int() would take signs, underscores, and digits by the million.
    if not text.isdigit() or len(text) > _MAX_NUMBER_CHARS:
        raise BadLine(f"has {_quote(text)} for its number of {what}")
    count = int(text)
    start = position + 1
    if count > len(fields) - start:
        raise BadLine(f"claims {count} {what} and has {len(fields) - start} fields left")
    return fields[start : start + count], start + count


def _split_stamps(tail: list[bytes], body_fields: int) -> tuple[bytes, bytes | None, list[bytes]]:
    """The ipc stamp, the logger's if there is one, and the body before them.

    The host name between the two stamps, which is no number, shows where a shorter body of an old
    logger ends.
    """
    extra = len(tail) - body_fields
    if extra == _STAMP_FIELDS:
        return tail[-3], tail[-1], tail[:-3]
    if extra > _STAMP_FIELDS:
        raise BadLine(f"has {extra - _STAMP_FIELDS} fields too many")
    if len(tail) >= 3 and not _is_number(tail[-2]):
        return tail[-3], tail[-1], tail[:-3]
    if len(tail) >= 2 and not _is_number(tail[-1]):
        return tail[-2], None, tail[:-2]
    if extra == 1:
        return tail[-1], None, tail[:-1]
    raise BadLine("has no timestamps")


def _time_ns(text: bytes, what: str) -> int:
    time_ns = ns_from_decimal_seconds(text.decode("ascii", "replace"))
    if time_ns is None:
        raise BadLine(f"has {_quote(text)} for its {what}")
    return time_ns


def _log_time_ns(text: bytes) -> int:
    """Nanoseconds since the logger's start; negative for messages sent before it was ready."""
    time_ns = _time_ns(text.removeprefix(b"-"), "logger timestamp")
    return -time_ns if text.startswith(b"-") else time_ns


def _numbers(fields: list[bytes], what: str) -> FloatArray:
    """(N,) numbers, NaN and inf among them as written."""
    try:
        return np.array([float(field) for field in fields], dtype=np.float64)
    except ValueError:
        first = next(field for field in fields if not _is_number(field))
        raise BadLine(f"has {_quote(first)} among its {what}") from None


def _number(text: bytes, what: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = float("nan")
    if not isfinite(number):
        raise BadLine(f"has {_quote(text)} in its {what}")
    return number


def _is_number(text: bytes) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _quote(text: bytes) -> str:
    return quote_clipped(text.decode("ascii", "backslashreplace"), _MAX_NUMBER_CHARS)
