"""Free space that repairs and maps invent, on each recording by itself.

    python -m tests.benchmarks.bench_free_space [--output DIR] [--preset default|published] [NAME …]

Repairs: of the LiDAR's holes and burrs that were filled, those more than 0.3 m behind the true
surface, by source; the fraction of the holes that were filled; median and 90th percentile of the
error beside those of linear interpolation. Recordings: the rooms below SCANLOOM_TEST_DATA where
that is set, the built-in sample, and the simulated panorama.

Maps: cells that are free or occupied and are not so in truth, from the recorded true poses, for the
LiDAR alone and for both sensors: of room_1, room_4 and the simulated floor.

Each is fused once, into DIR; what is there already is used again.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.repair import evaluate_repair
from fusion_core.workflows.evaluate.evaluate import map_cells
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from tests.benchmarks.known_recordings import Known, recordings

MAPPED = ("room_1", "room_4", "floor")


def _repair_line(known: Known, folder: Path) -> str:
    truth = known.load_truth()
    report = evaluate_repair(folder, truth).lidar
    entries = report.to_json()
    sources = entries["by_source"]
    linear_m = report.baseline_error_m["linear"]
    own_m = report.error_m
    cells = [known.name, str(own_m.size)]
    cells += [_percent(sources[name]["behind_surface"]) for name in ("all", "other_sensor")]
    cells += [_percent(sources["neighbours"]["behind_surface"])]
    cells += [str(sources["neighbours"]["count"])]
    cells += [_percent(entries["holes_filled"]), _percent(entries["moved_farther"])]
    for error_m in (own_m, linear_m):
        quantiles = np.percentile(error_m, [50, 90]) if error_m.size else (np.nan, np.nan)
        cells += [f"{1000.0 * value:.0f}" for value in quantiles]
    return "".join(f"{cell:>11}" for cell in cells)


def _percent(fraction: float | None) -> str:
    return "-" if fraction is None else f"{100.0 * fraction:.2f}"


def _map_lines(known: Known, folder: Path) -> Iterator[str]:
    for name in ("lidar", "fused"):
        found: dict[str, Any] = map_cells(folder / f"map_{name}.yaml", known.truth)
        cells = [known.name, name]
        cells += [str(found[k]) for k in ("free", "false_free", "occupied", "false_occupied")]
        yield "".join(f"{cell:>15}" for cell in cells)


def main() -> None:
    """Fuse and measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--output", type=Path, metavar="DIR")
    parser.add_argument("--preset", default="default", choices=("default", "published"))
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = asked.output or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        titles = ("recording", "filled", "behind %", "camera %", "neighb. %", "neighb.")
        titles += ("holes %", "moved %", "median mm", "p90 mm", "lin. med", "lin. p90")
        print("".join(f"{title:>11}" for title in titles))
        maps = []
        for known in recordings(work, asked.names):
            folder = work / asked.preset / known.name
            mapped = known.name in MAPPED
            pose_topic = "/ground_truth" if mapped else None
            options = FuseOptions(
                preset=asked.preset, figures=False, maps=mapped, pose_topic=pose_topic
            )
            fuse(known.recording, folder, options)
            print(_repair_line(known, folder), flush=True)
            maps += list(_map_lines(known, folder)) if mapped else []
    titles = ("recording", "map", "free", "false free", "occupied", "false occupied")
    print("\n" + "".join(f"{title:>15}" for title in titles), *maps, sep="\n")


if __name__ == "__main__":
    main()
