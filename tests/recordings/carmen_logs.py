"""A small CARMEN log with every kind of line, and the values that it must give."""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import (
    LaserScan,
    PoseSample,
    SensorValue,
    Transform,
    TransformBatch,
)

IPC_ZERO_NS = 976_052_857_337_284_000
MS = 1_000_000
NAN = float("nan")

HEADER = """# CARMEN Logfile
# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp
PARAM robot_frontlaser_offset 0.25 nohost 0
PARAM robot_front_laser_max 50.0 nohost 0
PARAM laser_front_laser_resolution 45.0 nohost 0
PARAM laser_rear_laser_resolution 45.0 nohost 0
PARAM robot_name pioneer nohost 0
SYNC start 976052857.337284 nohost 0.000000

"""


def stamps(logged_ns: int) -> str:
    """The end of a line; the ipc stamp is 3 ms older than the logger's."""
    ipc_ns = IPC_ZERO_NS + logged_ns - 3 * MS
    times = [f"{ns // 10**9}.{ns % 10**9 // 1000:06d}" for ns in (ipc_ns, logged_ns)]
    return f"{times[0]} nohost {times[1]}"


def text_of(numbers: Sequence[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def planar(x: float, y: float, yaw: float) -> np.ndarray:
    return make_transform(rotation_from_yaw_pitch_roll(yaw, 0.0, 0.0), np.array([x, y, 0.0]))


def numbers_of(matrix: np.ndarray) -> list[float]:
    return [matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])]


def sweep(
    logged_ns: int, frame: str, ranges: Sequence[float], maximum: float, intensities: bool = False
) -> LaserScan:
    return LaserScan(
        stamp_ns=IPC_ZERO_NS + logged_ns - 3 * MS,
        received_ns=logged_ns,
        frame_id=frame,
        angle_min_rad=-np.pi / 2,
        angle_increment_rad=np.pi / 4,
        range_min_m=0.0,
        range_max_m=maximum,
        ranges_m=np.array(ranges, dtype=np.float64),
        intensities=np.arange(5.0) if intensities else None,
    )


def at(logged_ns: int, parent: str, child: str, T_parent_child: np.ndarray) -> PoseSample:
    return PoseSample(
        stamp_ns=IPC_ZERO_NS + logged_ns - 3 * MS,
        received_ns=logged_ns,
        parent=parent,
        child=child,
        T_parent_child=T_parent_child.copy(),
    )


def small_log(steps: int = 6) -> tuple[str, list[tuple[str, SensorValue]]]:
    """The text, and (topic, value) in the order in which a reader gives them."""
    mounts = {"flaser": planar(0.25, 0.0, 0.0), "robotlaser1": planar(0.125, -0.5, 0.75)}
    batch = TransformBatch(
        received_ns=0,
        transforms=tuple(
            Transform(
                stamp_ns=IPC_ZERO_NS - 3 * MS, parent="base_link", child=child, T_parent_child=T
            )
            for child, T in mounts.items()
        ),
    )
    lines: list[str] = []
    given: list[tuple[str, SensorValue]] = [("/tf_static", batch)]
    for i in range(steps):
        robot = planar(1.0 + i, -0.5 * i, 0.25 * i)
        true = planar(2.0 + i, -0.5 * i, 0.125 * i)
        # As a log that SLAM has corrected: the rear laser's pose departs from odometry.
        corrected = planar(1.0 + 1.5 * i, -0.25 * i, 0.25 * i)
        ns = 100 * MS * i
        odometry = text_of(numbers_of(robot))
        lines.append(f"TRUEPOS {text_of(numbers_of(true))} {odometry} {stamps(ns)}")
        given.append(("/truepos/ground_truth", at(ns, "map", "base_link", true)))

        ns += 10 * MS
        lines.append(f"ODOM {odometry} 0.5 0.0 0.0 {stamps(ns)}")
        given.append(("/odom", at(ns, "odom", "base_link", robot)))

        ns += 10 * MS
        front = text_of(numbers_of(robot @ mounts["flaser"]))
        readings = text_of([1.0 + i, 0.0, 50.0, 81.91, 49.99])
        lines.append(f"FLASER 5 {readings} {front} {odometry} {stamps(ns)}")
        given.append(("/flaser", sweep(ns, "flaser", [1.0 + i, NAN, NAN, NAN, 49.99], 50.0)))
        given.append(("/flaser/odom", at(ns, "odom", "base_link", robot)))

        # Two lines of one time, and the order of their topics.
        ns += 10 * MS
        config = f"2 {text_of([-np.pi / 2, np.pi, np.pi / 4, 30.0, 0.01])} 0"
        readings = text_of([2.0, 3.0 + i, -1.0, 30.0, float("inf")])
        ranges = [2.0, 3.0 + i, NAN, NAN, NAN]
        side = text_of(numbers_of(robot @ mounts["robotlaser1"]))
        lines.append(
            f"ROBOTLASER1 {config} 5 {readings} 5 {text_of(range(5))} {side} {odometry} "
            f"0.5 0 0.25 0.25 1e6 {stamps(ns)}"
        )
        lines.append(f"RAWLASER1 {config} 5 {readings} 0 {stamps(ns)}")
        given.append(("/rawlaser1", sweep(ns, "rawlaser1", ranges, 30.0)))
        given.append(("/robotlaser1", sweep(ns, "robotlaser1", ranges, 30.0, intensities=True)))
        given.append(("/robotlaser1/odom", at(ns, "odom", "base_link", robot)))

        ns += 10 * MS
        rear = text_of(numbers_of(corrected))
        readings = text_of([4.0, 81.82, 81.83, 81.91, 0.5])
        lines.append(f"RLASER 5 {readings} {rear} {odometry} {stamps(ns)}")
        given.append(("/rlaser", sweep(ns, "rlaser", [4.0, 81.82, NAN, NAN, 0.5], 81.83)))
        given.append(("/rlaser/odom", at(ns, "odom", "base_link", robot)))
        given.append(("/rlaser/pose", at(ns, "map", "rlaser", corrected)))
    return HEADER + "\n".join(lines) + "\n", given
