"""The map of a truth: the LiDAR's true ranges at the poses that the other maps are made from."""

from pathlib import Path

import numpy as np

from fusion_core.evaluation.associated_truth import beam_angles_rad
from fusion_core.evaluation.fuse_folder import open_fuse_folder
from fusion_core.evaluation.truth import load_truth
from fusion_core.mapping.grid import GridBuilder, GridSettings
from fusion_core.model.grids import OccupancyGrid
from fusion_core.workflows.recorded_poses import PoseLookup


def reference_map(
    truth_file: Path, fuse_dir: Path, poses: PoseLookup, settings: GridSettings
) -> OccupancyGrid:
    """What a LiDAR without noise, holes and limit of range would have mapped.

    Raises ScanLoomError where the truth cannot be read or is of another recording, and
    MappingFailed where no scan of it has a pose or the map would be too large.
    """
    truth = load_truth(truth_file)
    azimuth_rad = beam_angles_rad(truth, open_fuse_folder(fuse_dir))
    builder = GridBuilder(settings)
    for stamp_ns, range_m in zip(truth.scan_stamp_ns, truth.range_m, strict=True):
        pose = poses.at(int(stamp_ns))
        if pose is not None:
            held_m = np.where(range_m <= settings.side_max_m, range_m, np.nan)
            builder.add_scan(pose, azimuth_rad, held_m, settings.side_max_m)
    return builder.build()
