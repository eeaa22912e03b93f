"""The files of a run of ``scanloom map``: maps, trajectory, graph, odometry, and their figures."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from fusion_core.exporting import figures_maps
from fusion_core.exporting.figures_slam import write_effective_particles, write_trajectory_figure
from fusion_core.exporting.g2o import write_g2o
from fusion_core.exporting.map_picture import write_difference_picture
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.model.grids import OccupancyGrid
from fusion_core.model.trajectory import Trajectory
from fusion_core.workflows.fuse.sensor_maps import difference_of, write_map
from fusion_core.workflows.map.estimators import PlacedScans


def write_maps(folder: Path, grids: Mapping[str, OccupancyGrid], heading: str) -> None:
    """Each map as ROS files and as a picture; all side by side, and the difference of the two that
    are not fused of others."""
    for name, grid in grids.items():
        write_map(folder, f"map_{name}", grid)
    difference = difference_of({name: grids[name] for name in grids if name != "fused"})
    if difference is not None:
        write_difference_picture(folder / "map_difference.png", difference)
        figures_maps.write_maps(
            folder / "maps.png", heading, grids, difference, {"fused": "cell by cell"}
        )


def write_trajectory(
    folder: Path, placed: PlacedScans, grid: OccupancyGrid | None, heading: str
) -> None:
    """The trajectory, the estimator's own results, and their figures.

    ``grid``: the map that the figure shows, None where there is none.
    """
    stamps_ns, poses = placed.stamps_ns, placed.poses_map_scan
    write_tum_trajectory(folder / "trajectory.tum", Trajectory.from_planar(stamps_ns, poses))
    loops_m = np.zeros((0, 4))
    if placed.graph is not None:
        graph = placed.graph.graph
        write_g2o(folder / "graph.g2o", graph)
        ends = (graph.first[graph.is_loop], graph.second[graph.is_loop])
        loops_m = np.hstack([graph.poses_map_node[end, :2] for end in ends])
    write_trajectory_figure(
        folder / "trajectory.png", heading, grid, poses, placed.trusted, loops_m
    )
    if placed.particles is not None:
        result = placed.particles
        write_effective_particles(
            folder / "effective.png",
            heading,
            stamps_ns[result.keyframes],
            result.effective,
            result.resampled,
            result.weights.size,
        )
