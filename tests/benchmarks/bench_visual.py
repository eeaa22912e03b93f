"""Visual SLAM on recorded RGB-D images: error, speed, memory and faults.

    python -m tests.benchmarks.bench_visual            # error, with Open3D's beside it
    python -m tests.benchmarks.bench_visual --cuts     # error over parts of the images
    python -m tests.benchmarks.bench_visual --speed    # images a second, cost and memory by length
    python -m tests.benchmarks.bench_visual --faults   # error of images that were spoilt
    python -m tests.benchmarks.bench_visual --objects  # what moves through the image, in many ways

SCANLOOM_TEST_DATA names the folder of recordings.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from fusion_core.evaluation.umeyama import align_positions
from fusion_core.freed_memory import give_freed_memory_back
from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.errors import MappingFailed
from fusion_core.model.geometry import invert_transform
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics, PoseSample
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.topics import choose_streams
from fusion_core.slam.visual.visual_slam import (
    VisualSlamResult,
    VisualSlamSettings,
    visual_slam,
)
from fusion_core.workflows.map.rgbd_frames import RgbdFrames
from fusion_core.workflows.map.visual.color_registration import register_colors

RECORDINGS = {
    "seven_scenes": "real/rgbd/seven_scenes",
    "Redwood": "real/rgbd/redwood_and_odd_encodings",
}
# Images at the start of each run that are not counted: functions are compiled there.
_WARM_UP = 30
# Open3D: images between those among which its pose graph looks for loops, how near they must be.
_O3D_KEYFRAME_STEP = 20
_O3D_LOOP_M, _O3D_LOOP_RAD = 0.4, 0.5


@dataclass
class Images:
    """A recording's images with the recorded poses, (N, 4, 4), of their camera."""

    frames: RgbdFrames
    intrinsics: CameraIntrinsics
    truth: FloatArray


def read_images(name: str) -> Images:
    recording = open_recording(Path(os.environ["SCANLOOM_TEST_DATA"]) / RECORDINGS[name])
    frames = RgbdFrames(recording, choose_streams(recording), purpose="Visual SLAM")
    poses = [
        message.value.T_parent_child
        for message in recording.messages(["/camera/pose"])
        if isinstance(message.value, PoseSample)
    ]
    return Images(frames, frames.intrinsics, np.stack(poses))


def ate_m(estimate: FloatArray, truth: FloatArray) -> float:
    """RMSE of positions after rigid alignment without scale."""
    aligned = align_positions(estimate[:, :3, 3], truth[:, :3, 3], "se3").apply(estimate)
    return float(np.sqrt(((aligned[:, :3, 3] - truth[:, :3, 3]) ** 2).sum(axis=1).mean()))


def run_slam(frames, intrinsics: CameraIntrinsics) -> VisualSlamResult:
    with ThreadPoolExecutor(1) as executor:
        return visual_slam(frames, intrinsics, executor=executor)


# --- error -------------------------------------------------------------------


def open3d_poses(images: Images) -> tuple[FloatArray, FloatArray]:
    """(N, 4, 4) by Open3D's RGB-D odometry alone, and with its pose graph over loops."""
    import open3d as o3d

    given = images.intrinsics
    camera = o3d.camera.PinholeCameraIntrinsic(
        given.width, given.height, given.fx, given.fy, given.cx, given.cy
    )
    jacobian = o3d.pipelines.odometry.RGBDOdometryJacobianFromHybridTerm()
    option = o3d.pipelines.odometry.OdometryOption()

    def image(frame: RgbdFrame):
        return o3d.geometry.RGBDImage.create_from_color_and_depth(
            o3d.geometry.Image(np.ascontiguousarray(frame.rgb)),
            o3d.geometry.Image(np.nan_to_num(frame.depth_m)),
            depth_scale=1.0,
            depth_trunc=4.0,
            convert_rgb_to_intensity=True,
        )

    def step(source, target, start: FloatArray):
        return o3d.pipelines.odometry.compute_rgbd_odometry(
            source, target, camera, start, jacobian, option
        )

    registration = o3d.pipelines.registration
    graph = registration.PoseGraph()
    poses, before, kept = [np.eye(4)], None, {}
    for index, frame in enumerate(images.frames):
        now = image(frame)
        if before is not None:
            _, T_before_now, information = step(now, before, np.eye(4))
            poses.append(poses[-1] @ T_before_now)
            graph.edges.append(
                registration.PoseGraphEdge(index, index - 1, T_before_now, information, False)
            )
        if index % _O3D_KEYFRAME_STEP == 0:
            kept[index] = now
        before = now
    graph.nodes.extend(registration.PoseGraphNode(pose) for pose in poses)
    for first in kept:
        for second in kept:
            start = invert_transform(poses[first]) @ poses[second]
            angle = np.arccos(np.clip(0.5 * (np.trace(start[:3, :3]) - 1.0), -1.0, 1.0))
            near = np.linalg.norm(start[:3, 3]) < _O3D_LOOP_M and angle < _O3D_LOOP_RAD
            if second <= first or not near:
                continue
            found, T_first_second, information = step(kept[second], kept[first], start)
            if found:
                graph.edges.append(
                    registration.PoseGraphEdge(second, first, T_first_second, information, True)
                )
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(
            max_correspondence_distance=0.05, edge_prune_threshold=0.25, reference_node=0
        ),
    )
    return np.stack(poses), np.stack([node.pose for node in graph.nodes])


def print_errors() -> None:
    print(f"{'recording':14} {'method':34} {'poses':>9} {'ATE RMSE (m)':>13} {'time (s)':>9}")
    for name in RECORDINGS:
        images = read_images(name)
        start_s = time.perf_counter()
        frames = register_colors(images.frames, images.intrinsics, VisualSlamSettings())
        result = run_slam(frames, images.intrinsics)
        seconds = time.perf_counter() - start_s
        tracked = result.is_tracked
        rows = [
            ("visual SLAM", ate_m(result.T_map_camera[tracked], images.truth[tracked]), tracked)
        ]
        times = [seconds]
        start_s = time.perf_counter()
        odometry, graph = open3d_poses(images)
        seconds = time.perf_counter() - start_s
        for method, poses in (
            ("Open3D RGB-D odometry", odometry),
            ("Open3D RGB-D odometry, pose graph", graph),
        ):
            rows.append((method, ate_m(poses, images.truth), np.ones(len(poses), np.bool_)))
            times.append(seconds)
        for (method, error_m, placed), took_s in zip(rows, times, strict=True):
            count = f"{placed.sum()}/{len(images.truth)}"
            print(f"{name:14} {method:34} {count:>9} {error_m:13.4f} {took_s:9.1f}", flush=True)


CUTS: dict[str, Callable[[list], list]] = {
    "first half": lambda images: images[: len(images) // 2],
    "second half": lambda images: images[len(images) // 2 :],
    "middle half": lambda images: images[len(images) // 4 : 3 * len(images) // 4],
    "every second": lambda images: images[::2],
    "reversed": lambda images: images[::-1],
}


class FrameList(list[RgbdFrame]):
    """Frames in memory, as ``register_colors`` takes them."""

    @property
    def image_count(self) -> int:
        return len(self)


def print_cuts() -> None:
    """The error over parts of the images, each with a map and a zoom of its own."""
    images = read_images("seven_scenes")
    both = list(zip(images.frames, images.truth, strict=True))
    print(f"{'images':14} {'poses':>9} {'ATE RMSE (m)':>13} {'zoom of colour':>14}")
    for name, cut in CUTS.items():
        part = cut(both)
        frames = FrameList(
            replace(frame, stamp_ns=33_333_333 * k) for k, (frame, _) in enumerate(part)
        )
        registered = register_colors(frames, images.intrinsics, VisualSlamSettings())
        result = run_slam(registered, images.intrinsics)
        tracked = result.is_tracked
        error_m = ate_m(result.T_map_camera[tracked], np.stack([T for _, T in part])[tracked])
        count = f"{tracked.sum()}/{len(part)}"
        print(f"{name:14} {count:>9} {error_m:13.4f} {registered.zoom:14.3f}", flush=True)


# --- speed -------------------------------------------------------------------


def to_and_fro(images: list[RgbdFrame], count: int) -> Iterator[RgbdFrame]:
    """``count`` images: through the given ones forwards, backwards, and so on."""
    period = 2 * (len(images) - 1)
    for number in range(count):
        place = number % period
        frame = images[min(place, period - place)]
        yield replace(frame, stamp_ns=33_333_333 * number)


def measure_length(count: int) -> dict[str, float]:
    """Cost and memory of a run; in a process of its own."""
    source = read_images("seven_scenes")
    images = list(register_colors(source.frames, source.intrinsics, VisualSlamSettings()))
    run_slam(images[:_WARM_UP], source.intrinsics)
    give_freed_memory_back()
    # The peak so far was that of reading the images.
    Path("/proc/self/clear_refs").write_text("5")
    base_mib = _memory_mib("VmRSS")
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    result = run_slam(to_and_fro(images, count), source.intrinsics)
    wall_s, cpu_s = time.perf_counter() - wall_s, time.process_time() - cpu_s
    peak_mib = _memory_mib("VmHWM") - base_mib
    give_freed_memory_back()
    return {
        "images": count,
        "wall_s": wall_s,
        "cpu_s": cpu_s,
        "tracking_s": sum(result.seconds[name] for name in ("features", "tracking", "local map")),
        "waiting_s": result.seconds["waiting for mapping"],
        "mapping_s": result.seconds["mapping"],
        "growth_mib": _memory_mib("VmRSS") - base_mib,
        "peak_mib": peak_mib,
        "keyframes": len(result.visual_map.kept_keyframes),
        "tracked": int(result.is_tracked.sum()),
    }


def _memory_mib(name: str) -> float:
    """Of this process: VmRSS is what it has now, VmHWM the most that it had."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024.0


def print_speed(lengths: list[int]) -> None:
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, images of 640 x 480")
    print(
        f"{'images':>7} {'tracked':>8} {'keyframes':>9} {'images/s':>9} {'CPU (s)':>8} "
        f"{'mapping (s)':>11} {'waiting (s)':>11} {'kept (MiB)':>10} {'peak (MiB)':>10}"
    )
    rows = []
    for count in lengths:
        done = subprocess.run(
            [sys.executable, "-m", "tests.benchmarks.bench_visual", "--length", str(count)],
            check=True,
            capture_output=True,
            text=True,
        )
        row = json.loads(done.stdout.splitlines()[-1])
        rows.append(row)
        print(
            f"{count:7d} {row['tracked']:8d} {row['keyframes']:9d} {count / row['wall_s']:9.1f} "
            f"{row['cpu_s']:8.1f} {row['mapping_s']:11.1f} {row['waiting_s']:11.1f} "
            f"{row['growth_mib']:10.0f} {row['peak_mib']:10.0f}",
            flush=True,
        )
    if len(rows) > 1:
        logs = np.log([[row["images"], row["cpu_s"]] for row in rows])
        print(f"exponent of CPU time against length: {np.polyfit(*logs.T, 1)[0]:.2f}")


# --- faults ------------------------------------------------------------------


def blurred(frames: list[RgbdFrame]) -> Iterator[RgbdFrame]:
    """Five images of each thirty moved by 25 pixels while exposed."""
    for number, frame in enumerate(frames):
        if number % 30 < 25:
            yield frame
        else:
            yield replace(frame, gray=cv2.blur(frame.gray, (25, 3)))


def dark(frames: list[RgbdFrame]) -> Iterator[RgbdFrame]:
    """Five images of each fifty with a hundredth of the light."""
    for number, frame in enumerate(frames):
        is_dark = number % 50 >= 45
        yield replace(frame, gray=(frame.gray * 0.01).astype(np.uint8)) if is_dark else frame


def scaled_depth(frames: list[RgbdFrame]) -> Iterator[RgbdFrame]:
    for frame in frames:
        yield replace(frame, depth_m=(1.04 * frame.depth_m).astype(np.float32))


def moving_object(
    frames: list[RgbdFrame],
    part: float = 0.5,
    depth_m: float = 1.0,
    pace: float = 20.0,
    *,
    vertical: bool = False,
    cell_px: int = 12,
    contrast: tuple[int, int] = (30, 226),
    crossing: tuple[int, int] | None = None,
) -> Iterator[RgbdFrame]:
    """A part of the image hidden by something textured at a depth, that moves to and fro with a
    period of 2 pi ``pace`` images, or crosses once between two images. What is nearer hides it."""
    height, width = frames[0].gray.shape
    shape = (height // cell_px + 1, width // cell_px + 1)
    cells = np.random.default_rng(0).integers(*contrast, shape, np.uint8)
    texture = cv2.resize(cells, (width, height), interpolation=cv2.INTER_NEAREST)
    size = height if vertical else width
    extent = int(part * size)
    for number, frame in enumerate(frames):
        first = int(0.5 * (1.0 - part) * size * (1.0 + np.sin(number / pace)))
        if crossing is not None:
            way = (number - crossing[0]) / (crossing[1] - crossing[0])
            first = int((size + extent) * way) - extent
        begin, end = max(first, 0), min(first + extent, size)
        if end <= begin:
            yield frame
            continue
        whole = slice(None)
        at, of = slice(begin, end), slice(begin - first, end - first)
        here, there = ((at, whole), (of, whole)) if vertical else ((whole, at), (whole, of))
        gray, depth = frame.gray.copy(), frame.depth_m.copy()
        is_hidden = ~(depth[here] < depth_m)
        gray[here] = np.where(is_hidden, texture[there], gray[here])
        depth[here] = np.where(is_hidden, np.float32(depth_m), depth[here])
        yield replace(frame, gray=gray, depth_m=depth)


def late_depth(frames: list[RgbdFrame]) -> Iterator[RgbdFrame]:
    """Each image with the depth of 40 ms later: of the next image, 33 ms, and each fifth time of
    the one after."""
    for number, frame in enumerate(frames):
        later = min(number + (2 if number % 5 == 0 else 1), len(frames) - 1)
        yield replace(frame, depth_m=frames[later].depth_m)


def lost_images(frames: list[RgbdFrame]) -> Iterator[RgbdFrame]:
    """Fifteen images of each sixty are not there."""
    for number, frame in enumerate(frames):
        if number % 60 < 45:
            yield frame


FAULTS: dict[str, Callable[[list[RgbdFrame]], Iterator[RgbdFrame]]] = {
    "none": iter,
    "blurred, 5 of 30": blurred,
    "dark, 5 of 50": dark,
    "depth + 4 %": scaled_depth,
    "moving block over half": moving_object,
    "depth 40 ms late": late_depth,
    "15 of 60 left out": lost_images,
}


OBJECTS: dict[str, dict] = {
    "half, 1 m": {},
    "a quarter": {"part": 0.25},
    "a third": {"part": 0.35},
    "two thirds": {"part": 0.65},
    "fast": {"pace": 8.0},
    "slow": {"pace": 60.0},
    "at 1.5 m": {"depth_m": 1.5},
    "at 2 m": {"depth_m": 2.0},
    "up and down": {"vertical": True},
    "weak texture": {"contrast": (100, 156)},
    "fine texture": {"cell_px": 6},
    "crosses in 3 s": {"crossing": (60, 150)},
    "crosses in 1 s": {"crossing": (100, 130)},
    "crosses in 7 s": {"crossing": (50, 250)},
    "a third crosses in 3 s": {"part": 0.35, "crossing": (60, 150)},
}
# Over so many images an error that has grown by more is asked to be named.
_GROWTH_IMAGES, _GROWTH_M = 10, 0.05


def print_objects(count: int, names: list[str]) -> None:
    """What moves through the image, in many ways: the error, and how much of it is named."""
    images = read_images("seven_scenes")
    registered = register_colors(images.frames, images.intrinsics, VisualSlamSettings())
    frames = list(registered)[:count]
    print(
        f"{'moving object':24} {'poses':>9} {'ATE RMSE (m)':>12} {'doubtful images':>15} "
        f"error grows in, of these named"
    )
    for name in names or OBJECTS:
        result = run_slam(moving_object(frames, **OBJECTS[name]), images.intrinsics)
        tracked = result.is_tracked
        poses, truth = result.T_map_camera[tracked], images.truth[:count][tracked]
        stamps = result.stamps_ns[tracked]
        named = np.zeros(len(stamps), np.bool_)
        for stretch in result.doubtful:
            named |= (stretch.first_stamp_ns <= stamps) & (stamps <= stretch.last_stamp_ns)
        growth_m = np.array(
            [
                np.linalg.norm(
                    (
                        invert_transform(invert_transform(true_first) @ true_last)
                        @ invert_transform(first)
                        @ last
                    )[:3, 3]
                )
                for first, last, true_first, true_last in zip(
                    poses, poses[_GROWTH_IMAGES:], truth, truth[_GROWTH_IMAGES:], strict=False
                )
            ]
        )
        grows = np.flatnonzero(growth_m > _GROWTH_M)
        of_these = sum(named[k : k + _GROWTH_IMAGES + 1].any() for k in grows)
        print(
            f"{name:24} {f'{tracked.sum()}/{len(frames)}':>9} {ate_m(poses, truth):12.4f} "
            f"{named.sum():15d} {len(grows)}, {of_these}",
            flush=True,
        )


def print_faults(count: int) -> None:
    images = read_images("seven_scenes")
    registered = register_colors(images.frames, images.intrinsics, VisualSlamSettings())
    frames = list(registered)[:count]
    place = {frame.stamp_ns: number for number, frame in enumerate(frames)}
    print(
        f"{'fault':24} {'poses':>9} {'ATE RMSE (m)':>12} {'greatest step (m)':>17} "
        f"{'jumps':>5} {'doubtful (s)':>12} lost"
    )
    for name, spoil in FAULTS.items():
        spoilt = list(spoil(frames))
        try:
            result = run_slam(spoilt, images.intrinsics)
        except MappingFailed as error:
            print(f"{name:24} {error}")
            continue
        tracked = result.is_tracked
        truth = images.truth[[place[stamp] for stamp in result.stamps_ns.tolist()]][tracked]
        poses = result.T_map_camera[tracked]
        step_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).max()
        # Stretches of different reasons overlap.
        seconds = np.diff(result.stamps_ns) / NS_PER_S
        doubtful_s = sum(
            step_s
            for step_s, stamp in zip(seconds, result.stamps_ns[1:], strict=True)
            if any(s.first_stamp_ns < stamp <= s.last_stamp_ns for s in result.doubtful)
        )
        lost = ", ".join(
            f"{stretch.first}-{stretch.last} {stretch.reason}" for stretch in result.lost
        )
        print(
            f"{name:24} {f'{tracked.sum()}/{len(spoilt)}':>9} {ate_m(poses, truth):12.4f} "
            f"{step_m:17.3f} {len(result.jumps):5d} {doubtful_s:12.1f} {lost or '-'}",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cuts", action="store_true")
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--faults", action="store_true")
    parser.add_argument("--objects", nargs="*", help="names of moving objects; by default all")
    parser.add_argument("--images", type=int, default=300, help="of --faults")
    parser.add_argument("--lengths", type=int, nargs="+", default=[300, 600, 1200, 3000])
    parser.add_argument("--length", type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    cv2.setNumThreads(1)
    if chosen.length:
        print(json.dumps(measure_length(chosen.length)))
    elif chosen.cuts:
        print_cuts()
    elif chosen.speed:
        print_speed(chosen.lengths)
    elif chosen.faults:
        print_faults(chosen.images)
    elif chosen.objects is not None:
        print_objects(chosen.images, chosen.objects)
    else:
        print_errors()


if __name__ == "__main__":
    main()
