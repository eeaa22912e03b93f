"""Worlds of a few outlines, and maps drawn from them."""

import numpy as np

from fusion_core.model.world_outline import (
    MeasuredAngle,
    MeasuredLine,
    ObstacleOutline,
    WorldOutline,
    find_runs,
)

WIDTH, DEPTH = 5.0, 3.0


def obstacle(name, points, seen=None):
    outline_m = np.array(points, dtype=np.float64)
    empty = ObstacleOutline(name=name, z_min_m=0.0, z_max_m=1.0, outline_m=outline_m, seen_by={})
    flags = {
        sensor: np.broadcast_to(np.asarray(own), empty.sample_count).astype(bool)
        for sensor, own in (seen or {}).items()
    }
    return ObstacleOutline(
        name=name,
        z_min_m=0.0,
        z_max_m=1.0,
        outline_m=outline_m,
        seen_by={sensor: find_runs(own) for sensor, own in flags.items()},
    )


def rectangle(x0, y0, x1, y1):
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0)]


def room() -> WorldOutline:
    """Four walls that both sensors see, a box that the camera sees, one that neither does."""
    both = {"lidar": True, "camera": True}
    line = MeasuredLine(
        name="width",
        faces_m=np.array([[(0.0, 0.3), (0.0, 2.7)], [(WIDTH, 0.3), (WIDTH, 2.7)]]),
    )
    angle = MeasuredAngle(
        name="corner",
        arms_m=np.array([[(0.0, 0.0), (4.0, 0.0)], [(0.0, 0.0), (0.0, 2.5)]]),
    )
    return WorldOutline(
        robot_height_m=0.55,
        obstacles=(
            obstacle("walls", rectangle(0.0, 0.0, WIDTH, DEPTH), both),
            obstacle("box", rectangle(1.0, 1.0, 1.6, 1.3), {"camera": True}),
            obstacle("hidden", rectangle(3.0, 2.0, 3.3, 2.2)),
        ),
        lines=(line,),
        angles=(angle,),
    )


def occupied_by(world: WorldOutline, resolution_m: float, kept=lambda points: points) -> np.ndarray:
    """(N, 2) middles of the cells that the kept samples of the outlines lie in."""
    samples = kept(np.concatenate([own.samples_m() for own in world.obstacles]))
    cells = np.unique(np.floor(samples / resolution_m).astype(int), axis=0)
    return (cells + 0.5) * resolution_m
