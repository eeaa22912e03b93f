"""Folders of depth and colour images in every layout that is read."""

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from fusion_core.model.sensors import (
    CameraInfo,
    CameraIntrinsics,
    ColorImage,
    DepthImage,
    PoseSample,
)
from tests.recordings.samples.ros_messages import ROS2, pose, pose_sample, ros_message
from tests.recordings.samples.sample import MS, T0, Sample, Written

FRAME_COUNT = 5


def frame_messages(numbers: Sequence[int], intrinsics: bool) -> list[Written]:
    """What a folder of frames gives, in the order of iteration; the stamp is used as log time."""
    written = []
    for number in numbers:
        stamp = (number - numbers[0]) * 10**9 // 30
        info = CameraInfo(
            stamp_ns=stamp,
            received_ns=None,
            frame_id="camera",
            intrinsics=CameraIntrinsics(width=4, height=3, fx=3.5, fy=3.25, cx=1.5, cy=1.0),
        )
        mm = frame_depth_mm(number)
        metres = mm.astype(np.float32) / np.float32(1000)
        metres[(mm == 0) | (mm == 65535)] = np.nan
        image = DepthImage(
            stamp_ns=stamp, received_ns=None, frame_id="camera", depth_m=metres, encoding="16UC1"
        )
        picture = ColorImage(
            stamp_ns=stamp, received_ns=None, frame_id="camera", rgb=frame_rgb(number)
        )
        sample = PoseSample(
            stamp_ns=stamp,
            received_ns=None,
            parent="world",
            child="camera",
            T_parent_child=pose(number),
        )
        written.append(Written("/camera/color/image_raw", stamp, picture))
        if intrinsics:
            written.append(Written("/camera/depth/camera_info", stamp, info))
        written.append(Written("/camera/depth/image_raw", stamp, image))
        written.append(Written("/camera/pose", stamp, sample))
    return written


def frame_depth_mm(number: int) -> np.ndarray:
    mm = (np.arange(12, dtype=np.uint16) * 300 + number).reshape(3, 4)
    mm[0, 0], mm[2, 3] = 0, 65535
    return mm


def frame_rgb(number: int) -> np.ndarray:
    return (np.arange(36, dtype=np.uint8) * 3 + number).reshape(3, 4, 3)


def write_png(file: Path, pixels: np.ndarray) -> None:
    if pixels.ndim == 3:
        pixels = np.ascontiguousarray(pixels[:, :, ::-1])
    assert cv2.imwrite(str(file), pixels)


def build_seven_scenes(path: Path) -> Sample:
    folder = path / "seq-01"
    folder.mkdir()
    # A frame is missing: its successors keep their own time.
    numbers = [3, 4, 6, 7, 8]
    for n in numbers:
        write_png(folder / f"frame-{n:06d}.depth.png", frame_depth_mm(n))
        write_png(folder / f"frame-{n:06d}.color.png", frame_rgb(n))
        np.savetxt(folder / f"frame-{n:06d}.pose.txt", pose(n), fmt="%.17e")
    np.savetxt(folder / "camera-intrinsics.txt", [[3.5, 0, 1.5], [0, 3.25, 1.0], [0, 0, 1]])
    return Sample(folder, frame_messages(numbers, True), has_log=False, nominal=True)


def build_redwood(path: Path) -> Sample:
    folder = path / "redwood"
    for name in ("depth", "color"):
        (folder / name).mkdir(parents=True)
    lines = []
    for n in range(FRAME_COUNT):
        write_png(folder / f"depth/{n:05d}.png", frame_depth_mm(n))
        write_png(folder / f"color/{n:05d}.png", frame_rgb(n))
        lines.append(f"{n} {n} {n + 1}")
        lines += [" ".join(f"{v:.17e}" for v in row) for row in pose(n)]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")
    camera = {"width": 4, "height": 3, "intrinsic_matrix": [3.5, 0, 0, 0, 3.25, 0, 1.5, 1.0, 1]}
    (folder / "camera_primesense.json").write_text(json.dumps(camera))
    return Sample(folder, frame_messages(range(FRAME_COUNT), True), has_log=False, nominal=True)


def build_slambook(path: Path) -> Sample:
    folder = path / "slambook"
    for name in ("depth", "color"):
        (folder / name).mkdir(parents=True)
    # Frame 10 follows frame 9, not frame 1.
    numbers = list(range(1, 13))
    lines = []
    for n in numbers:
        write_png(folder / f"depth/{n}.png", frame_depth_mm(n))
        write_png(folder / f"color/{n}.png", frame_rgb(n))
        q = ros_message(ROS2, pose_sample(n, MS, "a", "")).pose.orientation
        lines.append(" ".join(f"{v:.17e}" for v in (*pose(n)[:3, 3], q.x, q.y, q.z, q.w)))
    (folder / "pose.txt").write_text("\n".join(lines) + "\n")
    return Sample(folder, frame_messages(numbers, False), has_log=False, nominal=True)


def timed_frames(topic_of_truth: str | None, units_per_metre: float) -> list[Written]:
    """Depth at 30 Hz and colour 7 ms later, each with its own stamps, and poses at 100 Hz."""
    written = []
    for n in range(FRAME_COUNT):
        stamp = T0 + n * 33_333_333
        values = frame_depth_mm(n)
        metres = values.astype(np.float32) / np.float32(units_per_metre)
        metres[(values == 0) | (values == 65535)] = np.nan
        head = {"stamp_ns": stamp, "received_ns": None, "frame_id": "camera"}
        info = CameraInfo(
            **head,
            intrinsics=CameraIntrinsics(width=4, height=3, fx=3.5, fy=3.25, cx=1.5, cy=1.0),
        )
        encoding = "16UC1" if units_per_metre == 1000.0 else "32FC1"
        image = DepthImage(**head, depth_m=metres, encoding=encoding)
        later = stamp + 7 * MS
        picture = ColorImage(stamp_ns=later, received_ns=None, frame_id="camera", rgb=frame_rgb(n))
        written.append(Written("/camera/depth/camera_info", stamp, info))
        written.append(Written("/camera/depth/image_raw", stamp, image))
        written.append(Written("/camera/color/image_raw", later, picture))
    for n in range(12 if topic_of_truth else 0):
        stamp = T0 - 5 * MS + n * 10 * MS
        sample = PoseSample(
            stamp_ns=stamp,
            received_ns=None,
            parent="world",
            child="camera",
            T_parent_child=pose(n),
        )
        written.append(Written(str(topic_of_truth), stamp, sample))
    return written


def decimal_seconds(ns: int) -> str:
    return f"{ns // 10**9}.{ns % 10**9:09d}"


def build_tum(path: Path) -> Sample:
    folder = path / "rgbd_dataset"
    lists = {"depth": ["# depth maps", "# timestamp filename"], "rgb": ["# color images"]}
    truth = ["# ground truth trajectory", "# timestamp tx ty tz qx qy qz qw"]
    for name in lists:
        (folder / name).mkdir(parents=True)
    written = timed_frames("/camera/ground_truth", 5000.0)
    n = 0
    for m in written:
        at = decimal_seconds(m.stamp_ns)
        if isinstance(m.value, PoseSample):
            q = ros_message(ROS2, m.value).pose.pose.orientation
            numbers = (*m.value.T_parent_child[:3, 3], q.x, q.y, q.z, q.w)
            truth.append(" ".join([at, *(f"{v:.17e}" for v in numbers)]))
        elif isinstance(m.value, DepthImage):
            write_png(folder / f"depth/{at}.png", frame_depth_mm(n))
            lists["depth"].append(f"{at} depth/{at}.png")
        elif isinstance(m.value, ColorImage):
            write_png(folder / f"rgb/{at}.png", m.value.rgb)
            lists["rgb"].append(f"{at} rgb/{at}.png")
            n += 1
    for name, lines in (*lists.items(), ("groundtruth", truth)):
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    (folder / "accelerometer.txt").write_text("# timestamp ax ay az\n1.5 0.1 8.0 -5.0\n")
    (folder / "calibration.txt").write_text("3.5 3.25 1.5 1.0\n")
    return Sample(folder, written, has_log=False)


def build_timed_images(path: Path) -> Sample:
    """Depth named by nanoseconds and colour by decimal seconds."""
    folder = path / "images by time"
    for name in ("depth", "rgb"):
        (folder / name).mkdir(parents=True)
    written = timed_frames(None, 1000.0)
    n = 0
    for m in written:
        if isinstance(m.value, DepthImage):
            write_png(folder / f"depth/{m.stamp_ns}.png", frame_depth_mm(n))
        elif isinstance(m.value, ColorImage):
            write_png(folder / f"rgb/{decimal_seconds(m.stamp_ns)}.png", m.value.rgb)
            n += 1
    keys = {"fx": 3.5, "fy": 3.25, "cx": 1.5, "cy": 1, "width": 4, "height": 3}
    (folder / "camera.json").write_text(json.dumps(keys | {"depth_scale": 1000}))
    return Sample(folder, written, has_log=False)


def build_numbered_images(path: Path) -> Sample:
    folder = path / "images by number"
    for name in ("depth", "images"):
        (folder / name).mkdir(parents=True)
    # Frame 10 follows frame 9, not frame 1.
    numbers = [2, 9, 10, 11]
    for n in numbers:
        write_png(folder / f"depth/depth_{n}.png", frame_depth_mm(n))
        write_png(folder / f"images/frame{n:06d}.png", frame_rgb(n))
    camera = {"width": 4, "height": 3, "intrinsic_matrix": [3.5, 0, 0, 0, 3.25, 0, 1.5, 1.0, 1]}
    (folder / "intrinsics.json").write_text(json.dumps(camera | {"depth_scale": 0.001}))
    written = [m for m in frame_messages(numbers, True) if m.topic != "/camera/pose"]
    return Sample(folder, written, has_log=False, nominal=True)
