"""Tables 3 to 5 of Li 2022 on the simulated site, beside the paper's own figures.

    python -m tests.benchmarks.bench_arena [--seeds 10] [--first 0] [--slam particle-filter]

For each seed the site is recorded anew, with other noise and another drift, and mapped three times:
from the LiDAR alone, from the camera alone and from both, with fused odometry. The detection rate
is (10) over the outline that a sensor could see in that recording, with the rate over all of it
beside. Seconds are those of the whole map command on the wall clock; the paper's are those of the
robot's drive. Means over the seeds; "worst" is the worst of them.
"""

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.recordings.world_file import world_path
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.evaluate import evaluate
from fusion_core.workflows.evaluate.odometry import odometry
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.scan_source import ScanKind

KINDS: tuple[ScanKind, ...] = ("lidar", "camera", "merged")
PAPER = {
    "lidar": (61.28, 100 * 0.0279, 1.5, 23.3),
    "camera": (73.45, 100 * 0.1554, 3.5, 54.6),
    "merged": (93.31, 100 * 0.0145, 0.5, 35.7),
}
PAPER_ODOMETRY = {"wheel": 0.23, "fused": 0.11}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--slam", default="particle-filter")
    asked = parser.parse_args()
    maps: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in KINDS}
    odometry_errors: dict[str, list[float]] = {}
    for seed in range(asked.first, asked.first + asked.seeds):
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "arena.mcap"
            settings = find_scene("arena").settings.model_copy(update={"seed": seed})
            write_scene("arena", recording, settings=settings)
            for kind in KINDS:
                row, tracks = _mapped(recording, Path(folder) / kind, kind, asked.slam)
                maps[kind].append(row)
                if kind == "merged":
                    for name, error in tracks.items():
                        odometry_errors.setdefault(name, []).append(error)
                print(
                    f"seed {seed} {kind:<8}", " ".join(f"{value:8.2f}" for value in row), flush=True
                )
    _print_maps(maps)
    print(f"\nTable 5, straight segments: error (%)\n{'':<12}{'ours':>8}{'worst':>8}{'paper':>8}")
    for name, errors in odometry_errors.items():
        paper = f"{PAPER_ODOMETRY[name]:.2f}" if name in PAPER_ODOMETRY else "-"
        print(f"{name:<12}{np.mean(errors):>8.2f}{np.max(errors):>8.2f}{paper:>8}")


def _mapped(
    recording: Path, folder: Path, kind: ScanKind, slam: str
) -> tuple[tuple[float, ...], dict[str, float]]:
    """Rates over the visible and over all outline, line and angle errors, seconds; and the error
    of each odometry in percent."""
    start_s = time.perf_counter()
    build_map(recording, folder, MapOptions(scan=kind, motion="fused", slam=slam))  # type: ignore[arg-type]  # as asked
    seconds = time.perf_counter() - start_s
    found = evaluate.ros_map(folder / f"map_{kind}.yaml", world_path(recording))
    tracks = odometry(folder, truth_path(recording))["tracks"]
    return (
        100.0 * _rate(found["visible"]),
        100.0 * _rate(found["all"]),
        _percent(found["lines"]["relative_error"]),
        _number(found["angles"]["mean_absolute_error_deg"]),
        seconds,
    ), {name: _percent(track["straight"]["error"]) for name, track in tracks.items()}


def _rate(part: dict[str, Any]) -> float:
    return _number(part["rate"])


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


def _percent(value: float | None) -> float:
    return 100.0 * _number(value)


def _print_maps(maps: dict[str, list[tuple[float, ...]]]) -> None:
    print("\nTables 3 and 4: mean (worst), paper")
    titles = ("visible %", "all %", "line %", "angle deg", "seconds")
    print(f"{'':<8}" + "".join(f"{title:>26}" for title in titles))
    for kind, rows in maps.items():
        values = np.array(rows)
        detection, line, angle, seconds = PAPER[kind]
        papers = (detection, None, line, angle, seconds)
        cells = []
        for column, paper in enumerate(papers):
            own = values[:, column]
            worst = np.nanmin(own) if column < 2 else np.nanmax(own)
            said = "" if paper is None else f", {paper:.2f}"
            cells.append(f"{np.nanmean(own):.2f} ({worst:.2f}){said}")
        print(f"{kind:<8}" + "".join(f"{cell:>26}" for cell in cells))


if __name__ == "__main__":
    main()
