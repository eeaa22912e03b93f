"""Tables 3 to 5 of Li 2022 on the simulated site, beside the paper's own figures.

    python -m tests.benchmarks.bench_arena [--seeds 10] [--first 0] [--slam particle-filter]
        [--preset default|published]

For each seed the site is recorded anew, with other noise and another drift, and mapped three times
with each preset: from the LiDAR alone and from the camera alone, both with the wheels' odometry as
the paper's "laser" and "camera", and from both with the fused odometry. A figure is the mean over
the seeds ± its standard deviation, and the worst of them; beside it the paper's, or "-".

The paper's detection rate (10) has all outline of the site as its denominator, whether a sensor
could see it or not; the paper's figures stand beside that one. The rates over what any sensor could
see, and over what those could see that the map is made of, say how much is lost by mapping.
"objects" leaves out the site's own walls, which are the easiest part. False cells are occupied
cells of no obstacle, seen or not (``evaluate map``). A line or angle that a map does not show has
no error; how many are shown is stated, of all seeds together, and so is how many runs of ``map``
failed. Seconds are those of the whole map command; the paper's (23.3, 54.6, 35.7) are of its
robot's drives, and say nothing about these.

Table 5 is over the straight segments of the drive. The error of the wheels is put in, as the lines
above it state: its scale is the paper's own 0.23 %. The other rows are results.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.model.errors import MappingFailed
from fusion_core.recordings.world_file import world_path
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.evaluate.odometry import odometry, put_in_lines
from fusion_core.workflows.fuse.settings import PresetName
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.motion_prior import MotionKind
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.scan_source import ScanKind
from tests.benchmarks.map_figures import number, percent, statistics

RUNS: tuple[tuple[ScanKind, MotionKind, str], ...] = (
    ("lidar", "wheel", "visible_to_lidar"),
    ("camera", "wheel", "visible_to_camera"),
    ("merged", "fused", "visible"),
)
PRESETS: tuple[PresetName, ...] = ("default", "published")
SOURCES = ("wheel", "laser", "visual", "fused")

ALL, LINES, ANGLES = "all outline found, %", "line error of those, %", "angle error of those, deg"
# Counts, of as many.
LINES_FOUND, ANGLES_FOUND, FAILED = "lines found", "angles found", "runs failed"
# The paper's figures by measure, for laser, camera and both.
PAPER = {ALL: (61.28, 73.45, 93.31), LINES: (2.79, 15.54, 1.45), ANGLES: (1.5, 3.5, 0.5)}
PAPER_ODOMETRY = {"wheel": 0.23, "fused": 0.11}

Figures = dict[str, float]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--slam", default="particle-filter")
    parser.add_argument("--preset", choices=PRESETS, action="append")
    asked = parser.parse_args()
    presets = asked.preset or PRESETS
    maps: dict[tuple[str, str], list[Figures]] = {}
    tracks: dict[tuple[str, str], list[Figures]] = {}
    put_in: list[str] = []
    for seed in range(asked.first, asked.first + asked.seeds):
        with tempfile.TemporaryDirectory() as name:
            recording = Path(name) / "arena.mcap"
            settings = find_scene("arena").settings.model_copy(update={"seed": seed})
            write_scene("arena", recording, settings=settings)
            for preset in presets:
                for scan, motion, own in RUNS:
                    options = MapOptions(scan=scan, motion=motion, slam=asked.slam, preset=preset)
                    folder = Path(name) / f"{preset}_{scan}"
                    figures = _map_figures(recording, folder, options, own)
                    maps.setdefault((preset, scan), []).append(figures)
                    print(f"seed {seed} {preset} {scan}:", _in_a_line(figures), flush=True)
                drift = odometry(Path(name) / f"{preset}_merged", truth_path(recording))
                put_in = put_in_lines(drift["put_in"])
                for source in SOURCES:
                    tracks.setdefault((preset, source), []).append(
                        _track_figures(drift["tracks"][source])
                    )
    for preset in presets:
        print(f"\nTables 3 and 4, {preset}, {asked.seeds} seeds: mean ± sd (worst) | paper")
        _print_maps([maps[preset, scan] for scan, _, _ in RUNS])
    print(f"\nTable 5, {asked.seeds} seeds: mean ± sd (worst) | paper")
    print("\n".join(put_in))
    _print_tracks(tracks)


def _map_figures(recording: Path, folder: Path, options: MapOptions, own: str) -> Figures:
    """What one map shows; ``own`` names the outline that its sensors could see."""
    start_s, failed = time.perf_counter(), 0.0
    try:
        build_map(recording, folder, options)
    except MappingFailed:
        # More than half of its scans cannot be trusted; its map is there all the same.
        failed = 1.0
    seconds = time.perf_counter() - start_s
    found = evaluate.ros_map(folder / f"map_{options.scan}.yaml", world_path(recording))
    objects = [part["all"] for part in found["obstacles"] if " wall" not in part["name"]]
    return {
        ALL: percent(found["all"]["rate"]),
        "visible outline found, %": percent(found["visible"]["rate"]),
        "visible to its sensors found, %": percent(found[own]["rate"]),
        "all outline of objects found, %": percent(
            sum(part["found_m"] for part in objects) / sum(part["outline_m"] for part in objects)
        ),
        "false, % of occupied cells": percent(found["false_obstacles"]),
        "false cells per m2 mapped": number(found["false_cells_per_m2"]),
        LINES_FOUND: float(found["lines"]["measured"]),
        f"{LINES_FOUND}, of": float(found["lines"]["total"]),
        LINES: percent(found["lines"]["relative_error"]),
        ANGLES_FOUND: float(found["angles"]["measured"]),
        f"{ANGLES_FOUND}, of": float(found["angles"]["total"]),
        ANGLES: number(found["angles"]["mean_absolute_error_deg"]),
        FAILED: failed,
        f"{FAILED}, of": 1.0,
        "seconds": seconds,
    }


def _track_figures(track: dict[str, Any]) -> Figures:
    """Errors of one odometry: Li's over straight segments, and of all metres of the path."""
    return {
        "Table 5, %": percent(track["straight"]["error"]),
        "of a metre, %": percent(track["over_stretches"]["translation_error"]),
        "deg per m": track["over_stretches"]["rotation_deg_per_m"],
    }


def _in_a_line(figures: Figures) -> str:
    return " ".join(f"{value:.2f}" for value in figures.values())


def _print_maps(columns: list[list[Figures]]) -> None:
    print(f"{'':<34}" + "".join(f"{scan:<32}" for scan, _, _ in RUNS))
    for measure in columns[0][0]:
        if measure.endswith(", of"):
            continue
        cells = []
        for column, rows in enumerate(columns):
            own = np.array([row[measure] for row in rows])
            if f"{measure}, of" in rows[0]:
                total = sum(row[f"{measure}, of"] for row in rows)
                cells.append(f"{own.sum():.0f} of {total:.0f}")
                continue
            paper = PAPER.get(measure)
            cell = statistics(own, more_is_better=measure.endswith("found, %"))
            cells.append(cell if paper is None else f"{cell} | {paper[column]:.2f}")
        print(f"{measure:<34}" + "".join(f"{cell:<32}" for cell in cells).rstrip())


def _print_tracks(tracks: dict[tuple[str, str], list[Figures]]) -> None:
    measures = list(next(iter(tracks.values()))[0])
    print(f"{'':<27}" + "".join(f"{measure:<30}" for measure in measures).rstrip())
    for (preset, source), rows in tracks.items():
        cells = []
        for measure in measures:
            cell = statistics(np.array([row[measure] for row in rows]), digits=3)
            if measure.startswith("Table 5") and source in PAPER_ODOMETRY:
                cell += f" | {PAPER_ODOMETRY[source]:.2f}"
            cells.append(cell)
        title = f"{source} (put in)" if source == "wheel" else source
        print(f"{preset:<11}{title:<16}" + "".join(f"{cell:<30}" for cell in cells).rstrip())


if __name__ == "__main__":
    main()
