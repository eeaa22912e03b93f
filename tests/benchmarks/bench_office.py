"""Tables 4 and 5 of Fu 2024 on the simulated office, beside the paper's own figures.

    python -m tests.benchmarks.bench_office [--seeds 10] [--first 0] [--quick]

For each seed the office is recorded anew, with other noise and another drift; ``--quick`` takes
images of half the size. The paper does not mention the wheels of its vehicle: two runs use them,
and say so.

    visual SLAM       the camera alone                    --slam visual
    laser odometry    the LiDAR alone, without a map      --motion laser --slam none
    LiDAR SLAM        the LiDAR alone                     --motion none --slam pose-graph
    LiDAR, wheels     the LiDAR and the wheels            --motion wheel --slam pose-graph
    camera            virtual scans of the camera alone   --scan camera --motion visual
    fused             the LiDAR's scans with the camera's obstacles, visual SLAM as their prior
                                                          --scan merged --motion visual-slam
    fused, wheels     the same with the odometry of wheels, laser and camera together
                                                          --scan merged --motion fused
    table, bayes      as fused; the LiDAR's grid and the camera's, cell by cell

Table 5 is the absolute trajectory error of the LiDAR's pose at all scans, after a rigid alignment
in space of the whole trajectory (the same for all; scale 1), and, pooled over the seeds, its six
statistics. The paper does not say how it aligned; its "before" is ORB-SLAM2, its "after" the fused.

Table 4 is the detection rate (10) of Li 2022 over the outline that any of the sensors could see,
and over all outline; the paper does not define its own. An occupied cell is false where no outline
lies within a cell and 2 cm of it; most of those are noisy returns beyond a wall, and the tops of
low things, on which the camera looks down: those in free space are counted, too. Seconds are those
of the whole map command; the paper's (185, 262, 215) are of its vehicle's drives, and say nothing
about these.
"""

import argparse
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fusion_core.evaluation.map_outlines import TOLERANCE_M
from fusion_core.evaluation.trajectories import MAX_GAP_S, associate, evaluate_trajectory
from fusion_core.model.conventions import FloatArray
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.model.trajectory import Trajectory
from fusion_core.recordings.ros_map import read_ros_map
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.recordings.world_file import read_world, world_path
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from tests.benchmarks.map_figures import number, percent, statistics

QUICK_SCALE = 0.5


@dataclass(frozen=True, kw_only=True)
class Run:
    """One way to map the office. ``map_name``: of the grid that Table 4 measures, None for none.
    ``paper``: the paper's detection rate in per cent and its mean error in metres, where it has
    any."""

    name: str
    options: dict[str, Any]
    map_name: str | None = None
    in_table_5: bool = True
    paper_rate: float | None = None
    paper_error_m: float | None = None


RUNS = (
    Run(name="visual SLAM", options={"slam": "visual"}, paper_error_m=0.0108),
    Run(name="laser odometry", options={"motion": "laser", "slam": "none"}),
    Run(name="LiDAR SLAM", options={"motion": "none"}, map_name="lidar", paper_rate=89.3),
    Run(name="LiDAR, wheels", options={"motion": "wheel"}, map_name="lidar"),
    Run(
        name="camera",
        options={"scan": "camera", "motion": "visual"},
        map_name="camera",
        in_table_5=False,
        paper_rate=78.6,
    ),
    Run(
        name="fused",
        options={"scan": "merged", "motion": "visual-slam"},
        map_name="merged",
        paper_rate=96.8,
        paper_error_m=0.0080,
    ),
    Run(name="fused, wheels", options={"scan": "merged", "motion": "fused"}, map_name="merged"),
    Run(
        name="table",
        options={"scan": "merged", "motion": "visual-slam", "fusion": "table"},
        map_name="fused",
        in_table_5=False,
    ),
    Run(
        name="bayes",
        options={"scan": "merged", "motion": "visual-slam", "fusion": "bayes"},
        map_name="fused",
        in_table_5=False,
    ),
)
# Table 5 of the paper in metres: min, max, mean, median and standard deviation, before and after.
# The digits of its variances are one column off, and they are no squares of its deviations.
PAPER_TABLE_5 = {
    "visual SLAM": (0.0003, 0.0691, 0.0108, 0.0089, 0.0078),
    "fused": (0.0002, 0.0331, 0.0080, 0.0072, 0.0051),
}
AIMS = {"rate": 96.8, "mean_m": 0.008, "of_best": 0.74}
Figures = dict[str, float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", action="append", choices=[run.name for run in RUNS])
    asked = parser.parse_args()
    chosen = [run for run in RUNS if asked.only is None or run.name in asked.only]
    errors_m: dict[str, list[FloatArray]] = {}
    maps: dict[str, list[Figures]] = {}
    for seed in range(asked.first, asked.first + asked.seeds):
        with tempfile.TemporaryDirectory() as name:
            recording = Path(name) / "office.mcap"
            record(recording, seed, quick=asked.quick)
            for run in chosen:
                folder = Path(name) / run.name.replace(" ", "_")
                start_s = time.perf_counter()
                try:
                    build_map(recording, folder, MapOptions(**run.options))
                except (ScanLoomError, TypeError) as error:
                    print(f"seed {seed} {run.name}: no result: {error}", flush=True)
                    continue
                seconds = time.perf_counter() - start_s
                line = f"seed {seed} {run.name}: {seconds:.1f} s"
                if run.in_table_5:
                    own_m = trajectory_errors_m(folder, recording)
                    errors_m.setdefault(run.name, []).append(own_m)
                    line += f", error mean {own_m.mean():.4f} m, max {own_m.max():.4f} m"
                if run.map_name is not None:
                    figures = map_figures(folder / f"map_{run.map_name}.yaml", recording)
                    maps.setdefault(run.name, []).append({**figures, "seconds": seconds})
                    line += ", found {:.2f} % of visible, {:.2f} % of all".format(*figures.values())
                print(line, flush=True)
            differing = fusion_difference(Path(name))
            if differing is not None:
                print(f"seed {seed}: {differing}", flush=True)
    print_table_5(errors_m)
    print_table_4(maps)


def record(recording: Path, seed: int, *, quick: bool) -> None:
    """The office of a seed."""
    own = find_scene("office").settings
    scale = QUICK_SCALE if quick else own.image_scale
    settings = own.model_copy(update={"seed": seed, "image_scale": scale})
    write_scene("office", recording, settings=settings)


def true_trajectory(recording: Path) -> Trajectory:
    """Where the LiDAR was at each scan."""
    truth = np.load(truth_path(recording))
    return Trajectory.from_planar(truth["scan_stamp"], truth["pose"])


def trajectory_errors_m(folder: Path, recording: Path) -> FloatArray:
    """(K,) distances of an estimated trajectory from the truth after the rigid alignment."""
    estimate = read_tum_trajectory(folder / "trajectory.tum").trajectory
    true = true_trajectory(recording)
    report = evaluate_trajectory(estimate, true, alignment="se3")
    assert report.similarity is not None
    pairs = associate(estimate, true, MAX_GAP_S)
    placed = report.similarity.apply(pairs.T_map_estimate)
    offsets_m = placed[:, :3, 3] - pairs.T_map_reference[:, :3, 3]
    errors_m: FloatArray = np.linalg.norm(offsets_m, axis=1)
    return errors_m


def map_figures(file: Path, recording: Path) -> Figures:
    """What one map shows."""
    found = evaluate.ros_map(file, world_path(recording))
    placed = found["alignment"]
    pose = np.array([placed["x_m"], placed["y_m"], np.radians(placed["yaw_deg"])])
    in_free_space = false_cells_in_free_space(file, recording, pose)
    return {
        "visible outline found, %": percent(found["visible"]["rate"]),
        "all outline found, %": percent(found["all"]["rate"]),
        "false, % of occupied cells": percent(found["false_obstacles"]),
        "false cells per m2 mapped": number(found["false_cells_per_m2"]),
        "false cells in free space": float(in_free_space),
    }


def false_cells_in_free_space(file: Path, recording: Path, pose_world_map: FloatArray) -> int:
    """Occupied cells inside the office that lie neither near an outline nor within a thing."""
    drawn, outline = read_ros_map(file), read_world(world_path(recording))
    cells_m = transform_planar_points(pose_world_map, drawn.occupied_m())
    samples_m = np.concatenate([thing.samples_m() for thing in outline.obstacles])
    apart_m, _ = cKDTree(samples_m).query(cells_m)
    truth = np.load(truth_path(recording))
    false = (apart_m > drawn.resolution_m + TOLERANCE_M) & (cells_m > 0.0).all(axis=1)
    false &= (cells_m < truth["size"]).all(axis=1)
    for x0, y0, x1, y1 in truth["blocks"]:
        false &= ~((cells_m > (x0, y0)) & (cells_m < (x1, y1))).all(axis=1)
    return int(false.sum())


def fusion_difference(folder: Path) -> str | None:
    """In how many cells the two fusions have different states, None where one is missing."""
    files = [folder / name / "map_fused.yaml" for name in ("table", "bayes")]
    if not all(file.exists() for file in files):
        return None
    table, bayes = (read_ros_map(file) for file in files)
    if table.occupied.shape != bayes.occupied.shape:
        return f"table and bayes have {table.occupied.shape} and {bayes.occupied.shape} cells"
    known = table.occupied | table.free | bayes.occupied | bayes.free
    differ = (table.occupied != bayes.occupied) | (table.free != bayes.free)
    only = table.occupied & ~bayes.occupied
    return (
        f"table and bayes differ in {int(differ.sum())} of {int(known.sum())} cells that either "
        f"shows; in {int(only.sum())} of them table alone shows an obstacle"
    )


def print_table_5(errors_m: dict[str, list[FloatArray]]) -> None:
    """The statistics of all errors of all seeds, the paper's, and the two aims."""
    print(
        "\nTable 5, absolute trajectory error in metres, all seeds pooled (rigid alignment, SE(3))"
    )
    names = ("min", "max", "mean", "median", "variance", "std", "RMSE")
    print(f"{'':<24}" + "".join(f"{name:>11}" for name in names) + "   means of the seeds")
    means: dict[str, float] = {}
    for name, rows in errors_m.items():
        pooled = np.concatenate(rows)
        means[name] = float(pooled.mean())
        values = (pooled.min(), pooled.max(), pooled.mean(), np.median(pooled), pooled.var())
        figures = [*values, pooled.std(), float(np.sqrt((pooled**2).mean()))]
        of_seeds = statistics(np.array([row.mean() for row in rows]), digits=4)
        cells = "".join(f"{v:>11.3g}" if v < 1e-3 else f"{v:>11.4f}" for v in figures)
        print(f"{name:<24}{cells}   {of_seeds}")
        if name in PAPER_TABLE_5:
            low, high, mean, median, std = (f"{v:>11.4f}" for v in PAPER_TABLE_5[name])
            print(f"{'  paper':<24}{low}{high}{mean}{median}{'-':>11}{std}{'-':>11}")
    for fused in ("fused", "fused, wheels"):
        wheels = fused.endswith("wheels")
        single = {
            name: mean
            for name, mean in means.items()
            if not name.startswith("fused") and (wheels or not name.endswith("wheels"))
        }
        if fused not in means or not single:
            continue
        best = min(single, key=lambda name: single[name])
        ratio = means[fused] / single[best]
        print(f"{fused}: mean {means[fused]:.4f} m (aim {AIMS['mean_m']} m);", end=" ")
        print(f"of {best}, the best without it: {ratio:.2f} (aim {AIMS['of_best']}, paper 0.74)")


def print_table_4(maps: dict[str, list[Figures]]) -> None:
    """Mean ± standard deviation (worst) over the seeds; the paper's rates last."""
    print("\nTable 4, mean ± sd (worst) over the seeds")
    measures = list(next(iter(maps.values()), [{}])[0])
    print(f"{'':<16}" + "".join(f"{measure:<29}" for measure in measures) + "paper, %")
    for run in RUNS:
        if run.name not in maps:
            continue
        cells = ""
        for measure in measures:
            values = np.array([row[measure] for row in maps[run.name]])
            cell = statistics(values, more_is_better=measure.endswith("found, %"))
            cells += f"{cell:<29}"
        paper = "-" if run.paper_rate is None else f"{run.paper_rate:.1f}"
        print(f"{run.name:<16}{cells}{paper}")
    if "fused" in maps:
        print(f"aim of fused: {AIMS['rate']} % found")


if __name__ == "__main__":
    main()
