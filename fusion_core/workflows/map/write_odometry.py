"""Odometry as files: a trajectory for each source, the weights as a table and as a figure."""

from pathlib import Path

import numpy as np

from fusion_core.exporting.figures_odometry import write_odometry_weights
from fusion_core.exporting.tables import CsvTable
from fusion_core.exporting.tum_trajectory import write_tum_trajectory
from fusion_core.model.trajectory import Trajectory
from fusion_core.motion.fusion_weights import FusionWeights
from fusion_core.motion.odometry_trajectory import OdometryTrajectory
from fusion_core.workflows.map.motion_prior import MotionPrior

WEIGHTS_TABLE = "odometry_weights.csv"
WEIGHTS_FIGURE = "odometry_weights.png"


def write_odometry(folder: Path, motion: MotionPrior) -> tuple[str, ...]:
    """``odometry_NAME.tum`` for each track; where sources were fused, their weights too. Returns
    the files' names.

    A pose of which nothing was measured, neither before nor after it, is left out, and a track
    without any other has no file. Raises ExportError where the folder cannot be written.
    """
    written = []
    for track in motion.tracks:
        trajectory = _measured_trajectory(track)
        if trajectory is not None:
            name = f"odometry_{track.name}.tum"
            write_tum_trajectory(folder / name, trajectory)
            written.append(name)
    if motion.weights is not None and motion.weights.stamps_ns.size > 1:
        _write_table(folder / WEIGHTS_TABLE, motion.weights)
        heading = f"Odometry fused from {', '.join(motion.weights.sources)}"
        write_odometry_weights(folder / WEIGHTS_FIGURE, heading, motion.weights)
        written += [WEIGHTS_TABLE, WEIGHTS_FIGURE]
    return tuple(written)


def _measured_trajectory(track: OdometryTrajectory) -> Trajectory | None:
    beside = np.concatenate([[False], track.measured]) | np.concatenate([track.measured, [False]])
    if not beside.any():
        return None
    return Trajectory.from_planar(
        track.stamps_ns[beside], np.ascontiguousarray(track.poses_odom_lidar[beside])
    )


def _write_table(path: Path, weights: FusionWeights) -> None:
    columns = ["from_ns", "to_ns"]
    arrays = {
        "translation": weights.translation,
        "rotation": weights.rotation,
        "rejected": weights.rejected,
        "residual_m": weights.residual_m,
        "residual_rad": weights.residual_rad,
    }
    columns += [f"{source}_{name}" for source in weights.sources for name in arrays]
    gains = ("gain_x", "gain_y", "gain_yaw") if weights.gain is not None else ()
    with CsvTable(path, [*columns, *gains]) as table:
        for k in range(weights.stamps_ns.size - 1):
            row: dict[str, object] = {
                "from_ns": int(weights.stamps_ns[k]),
                "to_ns": int(weights.stamps_ns[k + 1]),
            }
            for number, source in enumerate(weights.sources):
                row |= {f"{source}_{name}": array[k, number] for name, array in arrays.items()}
            if weights.gain is not None:
                row |= dict(zip(gains, weights.gain[k], strict=True))
            table.append(row)
