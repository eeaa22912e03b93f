"""Cell by cell fusion of two grids (Fu 2024 §3.2): Table 3, (10), and both on a recording.

    python -m tests.benchmarks.bench_grid_fusion [--scene office] [--seconds 25] [--seed 1]
        [--recording FILE] [--motion visual]

First all nine cases of Table 3 beside the paper's; then (10) on random cells, a third of them
unknown to either grid, against a plain loop of the formula over probabilities. Then a scene, or a
recording of one's own, is mapped from merged scans by both rules: the number of cells for each pair
of states, those in which the rules differ, how the two grids lie on each other, and where the
scene's world is known the detection rate (Li 2022, 10) and the false cells of each map.
"""

import argparse
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.mapping.bayes import fuse_grids
from fusion_core.model.grid_fusion import CellState, FusionRule, cell_states
from fusion_core.model.grids import OccupancyGrid
from fusion_core.recordings.world_file import world_path
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.motion_prior import MotionKind
from fusion_core.workflows.map.options import MapOptions

RULES: tuple[FusionRule, ...] = ("table", "bayes")
# Table 3: rows the camera, columns the LiDAR, in this order.
ORDER = (CellState.OCCUPIED, CellState.EMPTY, CellState.UNKNOWN)
PUBLISHED = (
    (CellState.OCCUPIED, CellState.OCCUPIED, CellState.OCCUPIED),
    (CellState.OCCUPIED, CellState.EMPTY, CellState.EMPTY),
    (CellState.OCCUPIED, CellState.EMPTY, CellState.UNKNOWN),
)
LOG_ODDS = {CellState.OCCUPIED: 0.85, CellState.EMPTY: -0.41, CellState.UNKNOWN: math.nan}
CELLS = 300


def grid_of(log_odds: Any) -> OccupancyGrid:
    return OccupancyGrid(
        resolution_m=0.05, origin_m=(0.0, 0.0), log_odds=np.array(log_odds, dtype=np.float64)
    )


def print_table_3() -> None:
    print("Table 3: camera, LiDAR -> fused (paper)")
    right = 0
    for camera, row in zip(ORDER, PUBLISHED, strict=True):
        for lidar, paper in zip(ORDER, row, strict=True):
            pair = {"camera": grid_of([[LOG_ODDS[camera]]]), "lidar": grid_of([[LOG_ODDS[lidar]]])}
            fused = CellState(int(cell_states(fuse_grids(pair).table.log_odds).item()))
            right += fused == paper
            print(f"  {camera.name:8} {lidar.name:8} -> {fused.name:8} ({paper.name})")
    print(f"  {right} of 9 as in the paper\n")


def print_ten(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pair = []
    for _ in range(2):
        values = rng.normal(scale=2.0, size=(CELLS, CELLS))
        values[rng.random((CELLS, CELLS)) < 1.0 / 3.0] = np.nan
        pair.append(values)
    fused = fuse_grids({"a": grid_of(pair[0]), "b": grid_of(pair[1])}).bayes.probability
    farthest, unknown = 0.0, 0
    for place in np.ndindex(fused.shape):
        p, q = (float(1.0 / (1.0 + math.exp(-values[place]))) for values in pair)
        if math.isnan(p) and math.isnan(q):
            assert math.isnan(fused[place])
            unknown += 1
            continue
        if math.isnan(p) or math.isnan(q):
            expected = q if math.isnan(p) else p
        else:
            expected = p * q / (p * q + (1.0 - p) * (1.0 - q))
        farthest = max(farthest, abs(float(fused[place]) - expected))
    print(
        f"(10) on {fused.size} random cells against a plain loop: largest difference "
        f"{farthest:.1e}; {unknown} cells unknown to both stay unknown\n"
    )


def print_recording(recording: Path, folder: Path, motion: MotionKind) -> None:
    reports = {}
    for rule in RULES:
        options = MapOptions(scan="merged", motion=motion, slam="pose-graph", fusion=rule)
        reports[rule] = build_map(recording, folder / rule, options).report["grid_fusion"]
    said = reports["table"]
    print(f"{recording.name}: cells by the states of {' and '.join(said['grids'])}")
    for states, count in said["cells"].items():
        print(f"  {states:18} {count:7}")
    print(
        f"  Table 3 and (10) differ in {said['rules_differ']} cells; "
        f"map_fused.pgm in {said['drawn_cells_differ']}"
    )
    found = said["misalignment"]
    for name in ("dx_m", "dy_m", "yaw_rad"):
        value = found.get(name)
        text = "not observable" if value is None else f"{value:+.4f} ± {found['sigma_' + name]:.4f}"
        print(f"  misalignment {name:8} {text}")
    world = world_path(recording)
    if not world.exists():
        return
    print(f"  {'outline found':14} {'visible':>8} {'all':>8} {'false, of occupied':>20}")
    for label, file in (
        ("lidar", "table/map_lidar"),
        ("camera", "table/map_camera"),
        ("fused, table", "table/map_fused"),
        ("fused, bayes", "bayes/map_fused"),
    ):
        found = evaluate.ros_map(folder / f"{file}.yaml", world)
        print(
            f"  {label:14} {found['visible']['rate']:8.2%} {found['all']['rate']:8.2%} "
            f"{found['false_obstacles']:20.2%}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="office")
    parser.add_argument("--seconds", type=float, default=25.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--recording", type=Path)
    parser.add_argument("--motion", default="visual")
    options = parser.parse_args()
    print_table_3()
    print_ten(options.seed)
    with tempfile.TemporaryDirectory() as temporary:
        folder, recording = Path(temporary), options.recording
        if recording is None:
            scene = find_scene(options.scene)
            recording = folder / f"{options.scene}.mcap"
            changed = {"seed": options.seed, "duration_s": options.seconds}
            write_scene(
                options.scene, recording, settings=scene.settings.model_copy(update=changed)
            )
        print_recording(recording, folder, options.motion)


if __name__ == "__main__":
    main()
