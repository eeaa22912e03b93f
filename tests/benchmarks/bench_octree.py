"""The octree map: time beside the binding's own insertion, memory beside the dense cloud, files.

    python -m tests.benchmarks.bench_octree [--frames 30]

Keyframes are every tenth frame of ``real/rgbd/seven_scenes`` below SCANLOOM_TEST_DATA at its given
poses, each of 76,800 pixels (every second one across and down), those without depth filled by the
nearest ones of their row so that each cloud has 76,800 points. "ours" is all of OctreeBuilder.add;
"binding" is pyoctomap's ``insertPointCloud(..., discretize=True)``, and "binding, lazy" the same
without its update of the inner nodes after each cloud, which we leave for the end as well. Both
are run in turns on trees of their own; times are medians over the clouds of the fastest of the
rounds.

The files are read back by a plain recursion over the published format, and by octomap-python
where that is installed.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pyoctomap

from fusion_core.exporting.octomap_files import write_octree
from fusion_core.mapping.dense_cloud import DenseCloudBuilder, DenseCloudSettings, points_in_map
from fusion_core.mapping.octree import OctreeBuilder, OctreeSettings
from fusion_core.mapping.octree_nodes import leaves_of
from fusion_core.model.octree import OccupancyOctree
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.workflows.map.keyframe_images import KeyframeImages
from tests.mapping.octomap_reader import Leaves, read_bt, read_ot

INTRINSICS = CameraIntrinsics(width=640, height=480, fx=585.0, fy=585.0, cx=320.0, cy=240.0)
ROUNDS = 3
BYTES_PER_POINT = 15


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=30)
    asked = parser.parse_args()
    folder = Path(os.environ["SCANLOOM_TEST_DATA"]) / "real" / "rgbd" / "seven_scenes"
    clouds = [cloud_of(folder, 10 * i) for i in range(asked.frames)]
    points = sum(len(points_m) for points_m, _, _ in clouds)
    print(f"{len(clouds)} clouds of {points // len(clouds)} points, median milliseconds a cloud")
    print(f"{'cells':<8}{'ours':>8}{'binding':>10}{'ratio':>8}{'binding, lazy':>16}{'ratio':>8}")
    for resolution_m in (0.1, 0.05):
        ours, binding, lazy = times_ms(clouds, resolution_m)
        print(
            f"{f'{resolution_m:g} m':<8}{ours:>8.1f}{binding:>10.1f}{ours / binding:>8.2f}"
            f"{lazy:>16.1f}{ours / lazy:>8.2f}",
            flush=True,
        )
    print()
    for resolution_m in (0.1, 0.05):
        print_memory_and_files(clouds, resolution_m)


Cloud = tuple[np.ndarray, np.ndarray, np.ndarray]


def cloud_of(folder: Path, number: int) -> Cloud:
    """76,800 points in the map, their colours, and the camera's place."""
    name = folder / f"frame-{number:06d}"
    millimetres = cv2.imread(f"{name}.depth.png", cv2.IMREAD_UNCHANGED)
    bgr = cv2.imread(f"{name}.color.jpg")
    assert millimetres is not None
    assert bgr is not None
    depth_m = millimetres[::2, ::2].astype(np.float32) / np.float32(1000.0)
    missing = (depth_m == 0.0) | (depth_m > 60.0)
    # The nearest pixel with depth to the left, else to the right.
    places = np.where(missing, 0, np.arange(depth_m.shape[1]))
    filled = np.take_along_axis(depth_m, np.maximum.accumulate(places, axis=1), axis=1)
    filled[(filled == 0.0) | (filled > 60.0)] = np.median(depth_m[~missing])
    T_map_camera = np.loadtxt(f"{name}.pose.txt")
    rays = KeyframeImages(INTRINSICS).geometry(filled).rays
    points_m, _ = points_in_map(filled, rays, T_map_camera)
    return points_m, bgr[::2, ::2, ::-1].reshape(-1, 3), T_map_camera[:3, 3].copy()


def times_ms(clouds: list[Cloud], resolution_m: float) -> tuple[float, float, float]:
    """Of ours, the binding's, and the binding's without inner nodes."""
    best = np.full(3, np.inf)
    for _ in range(ROUNDS):
        # Without a range, as the binding's.
        settings = OctreeSettings(resolution_m=resolution_m, range_max_m=1000.0)
        builder = OctreeBuilder(settings)
        eager, lazy = pyoctomap.OcTree(resolution_m), pyoctomap.OcTree(resolution_m)
        taken = []
        for points_m, _, origin_m in clouds:
            start = time.perf_counter()
            builder.add(points_m, origin_m)
            first = time.perf_counter()
            eager.insertPointCloud(points_m, origin_m, discretize=True)
            second = time.perf_counter()
            lazy.insertPointCloud(points_m, origin_m, discretize=True, lazy_eval=True)
            third = time.perf_counter()
            taken.append((first - start, second - first, third - second))
        best = np.minimum(best, 1000.0 * np.median(taken, axis=0))
    ours, binding, without_inner = best.tolist()
    return ours, binding, without_inner


def print_memory_and_files(clouds: list[Cloud], resolution_m: float) -> None:
    builder = OctreeBuilder(OctreeSettings(resolution_m=resolution_m))
    dense = DenseCloudBuilder(DenseCloudSettings())
    for points_m, rgb, origin_m in clouds:
        builder.add(points_m, origin_m)
        dense.add(points_m, rgb)
    octree, cloud = builder.build(), dense.build()
    raw = sum(len(points_m) for points_m, _, _ in clouds)
    with tempfile.TemporaryDirectory() as name:
        paths = {suffix: Path(name) / f"octree{suffix}" for suffix in (".ot", ".bt")}
        for path in paths.values():
            write_octree(path, octree)
        own = {(*corner, side): log_odds for corner, side, log_odds in dictionary_rows(octree)}
        ot, bt = paths[".ot"].read_bytes(), paths[".bt"].read_bytes()
        full, binary = read_ot(ot)[1], read_bt(bt)[1]
        print(f"{resolution_m:g} m: {len(octree.nodes)} nodes, {len(own)} leaves")
        print(f"  the tree while it is built      {builder.memory_bytes:>12,} bytes")
        print(f"  the same pruned, as .ot and .bt {len(ot):>12,} and {len(bt):,} bytes")
        print(f"  the keyframes' points           {BYTES_PER_POINT * raw:>12,} bytes")
        print(
            f"  the dense cloud at {DenseCloudSettings().voxel_m:g} m       "
            f"{BYTES_PER_POINT * len(cloud.rgb):>12,} bytes"
        )
        print(f"  .ot by plain recursion: same leaves: {full == own}")
        print(f"  .bt by plain recursion: same states: {same_states(own, binary)}")
        print(f"  by octomap-python: {other_binding(paths, resolution_m, own, binary)}", flush=True)


def dictionary_rows(octree: OccupancyOctree) -> list[tuple[list[int], int, float]]:
    leaves = leaves_of(octree)
    return list(
        zip(leaves.corners.tolist(), leaves.sides.tolist(), leaves.log_odds.tolist(), strict=True)
    )


def same_states(own: Leaves, binary: Leaves) -> bool:
    """Whether each place is occupied, free or unknown in both; leaves of .bt may be larger."""

    def cells(leaves: Leaves) -> dict[tuple[int, int, int], bool]:
        return {
            (x + dx, y + dy, z + dz): value > 0.5 if leaves is binary else value >= 0.0
            for (x, y, z, side), value in leaves.items()
            for dx in range(side)
            for dy in range(side)
            for dz in range(side)
        }

    return cells(own) == cells(binary)


def other_binding(paths: dict[str, Path], resolution_m: float, own: Leaves, binary: Leaves) -> str:
    try:
        import octomap
    except ImportError:
        return "not installed"
    full = octomap.OcTree.read(bytes(paths[".ot"]))
    states = octomap.OcTree(resolution_m)
    states.readBinary(bytes(paths[".bt"]))

    def boxes(tree: octomap.OcTree) -> Leaves:
        found = {}
        for leaf in tree.begin_leafs():
            side = round(leaf.getSize() / resolution_m)
            low = np.rint(np.array(leaf.getCoordinate()) / resolution_m - 0.5 * side)
            x, y, z = low.astype(int).tolist()
            found[x, y, z, side] = float(np.float32(leaf.getValue()))
        return found

    read = {box: float(value >= 0.0) for box, value in boxes(states).items()}
    return f"same leaves: .ot {boxes(full) == own}, .bt {read == binary}"


if __name__ == "__main__":
    main()
