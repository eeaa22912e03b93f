"""Rooms of Robot@Home and Robot@Home2, with the values that they must give."""

from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.model.geometry import make_transform, rotation_from_yaw_pitch_roll
from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    LaserScan,
    Transform,
    TransformBatch,
)
from tests.recordings import robot_at_home_trees
from tests.recordings.samples.sample import Sample, Written


def robot_at_home_messages(source: Any, depth_bits: int) -> list[Written]:
    """What a room gives, from what the exporters store of it."""
    intrinsics = CameraIntrinsics(
        width=320,
        height=240,
        fx=286.441384,
        fy=271.36999,
        cx=157.3245865,
        cy=120.0802295,
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    )
    written, transforms = [], {}
    for sweep in source.sweeps[2]:
        step = 4.1847 / sweep.ranges_m.size
        value = LaserScan(
            stamp_ns=sweep.stamp_ns,
            received_ns=None,
            frame_id="laser",
            angle_min_rad=-0.5 * (sweep.ranges_m.size - 1) * step,
            angle_increment_rad=step,
            range_min_m=0.0,
            range_max_m=5.6,
            ranges_m=sweep.ranges_m,
            scan_time_s=0.1,
        )
        written.append(Written("/laser", sweep.stamp_ns, value))
        transforms["laser"] = sweep.pose
    for sight in source.sights:
        name = sight.label.lower()
        transforms[f"{name}_optical"] = sight.pose
        head = {
            "stamp_ns": sight.stamp_ns,
            "received_ns": None,
            "frame_id": f"{name}_optical",
        }
        units = robot_at_home_trees.stored_depth(sight.depth_m).astype(np.float64)
        if depth_bits == 8:
            units = np.where(units >= 256, 256 * (units // 256) + 127.5, 0)
        metres = np.where(units > 0, units / 6553.5, np.nan)
        values = {
            "camera_info": CameraInfo(**head, intrinsics=intrinsics),
            "color": ColorImage(**head, rgb=sight.rgb.copy()),
            "depth": DepthImage(
                **head,
                depth_m=metres.astype(np.float32),
                quantum_m=256 / 6553.5 if depth_bits == 8 else None,
            ),
        }
        for kind, image in values.items():
            written.append(Written(f"/{name}/{kind}", sight.stamp_ns, image))
    first = min(m.received_ns for m in written)
    # Optical axes in those of the body: right is -y, down is -z, forward is x.
    optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    batch = TransformBatch(
        received_ns=None,
        transforms=tuple(
            Transform(
                stamp_ns=first,
                parent="base_link",
                child=child,
                T_parent_child=make_transform(
                    rotation_from_yaw_pitch_roll(*p[3:]) @ (optical if p[5] else np.eye(3)),
                    np.array(p[:3]),
                ),
            )
            for child, p in sorted(transforms.items())
        ),
    )
    written.append(Written("/tf_static", first, batch))
    return sorted(written, key=lambda m: (m.received_ns, m.topic))


def build_plain_text_room(path: Path) -> Sample:
    source = robot_at_home_trees.small_room()
    root = robot_at_home_trees.write_plain_text(path / "robot_at_home", [source])
    written = robot_at_home_messages(source, depth_bits=16)
    return Sample(root, written, has_log=False)


def build_robot_at_home2_room(path: Path) -> Sample:
    source = robot_at_home_trees.small_room()
    root = robot_at_home_trees.write_robot_at_home2(path / "R@H2", [source])
    written = robot_at_home_messages(source, depth_bits=8)
    return Sample(root, written, has_log=False, warnings=("steps of 39 mm",))
