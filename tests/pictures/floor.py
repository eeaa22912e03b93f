"""The whole floor as Fig. 9 (e), (f) of Xu 2024: maps of the LiDAR alone, repaired and merged.

    python -m tests.pictures.floor OUT.png [--seed 3]

All three from one recording; poses by the pose graph with fused odometry.
"""

import argparse
import tempfile
from pathlib import Path

from fusion_core.exporting.figures_maps import write_maps
from fusion_core.simulation.scenes import find_scene, write_scene
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from fusion_core.workflows.map.result_folder import read_grid
from fusion_core.workflows.map.scan_source import ScanKind

KINDS: tuple[ScanKind, ...] = ("repaired", "merged")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--seed", type=int, default=None)
    asked = parser.parse_args()
    settings = find_scene("floor").settings
    if asked.seed is not None:
        settings = settings.model_copy(update={"seed": asked.seed})
    grids = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = folder / "floor.mcap"
        write_scene("floor", recording, settings=settings)
        for kind in KINDS:
            build_map(recording, folder / kind, MapOptions(scan=kind, motion="fused"))
            grids[kind] = read_grid(folder / kind / f"map_{kind}.yaml")
        grids["lidar"] = read_grid(folder / "repaired" / "map_lidar.yaml")
    write_maps(asked.picture, "floor.mcap", grids, None)


if __name__ == "__main__":
    main()
