"""Trajectories as files in the format of the TUM RGB-D benchmark, which evo and others read."""

from pathlib import Path

import numpy as np

from fusion_core.files.atomic import write_text
from fusion_core.model.conventions import NS_PER_S
from fusion_core.model.errors import ExportError
from fusion_core.model.trajectory import Trajectory

_HEADER = "# timestamp tx ty tz qx qy qz qw\n"


def write_tum_trajectory(file: Path, trajectory: Trajectory) -> None:
    """Write ``stamp x y z qx qy qz qw`` a line: seconds, metres, nine decimals each.

    The nine decimals of a stamp are its nanoseconds. Of the two quaternions of a rotation it is the
    one with w >= 0, and no number is written as -0. Raises ExportError where the folder cannot be
    written, or for stamps below 0, which readers of the format refuse.
    """
    from scipy.spatial.transform import Rotation

    if trajectory.stamps_ns[0] < 0:
        raise ExportError(
            f"cannot hold the stamp {trajectory.stamps_ns[0]} ns.",
            file=file,
            advice="Shift the recording's clock so that it begins at 0 or later.",
        )
    quaternions = Rotation.from_matrix(trajectory.T_map_body[:, :3, :3]).as_quat(canonical=True)
    poses = np.concatenate([trajectory.T_map_body[:, :3, 3], quaternions], axis=1)
    lines = [
        f"{stamp_ns // NS_PER_S}.{stamp_ns % NS_PER_S:09d} "
        + " ".join(f"{value:z.9f}" for value in pose)
        for stamp_ns, pose in zip(trajectory.stamps_ns.tolist(), poses.tolist(), strict=True)
    ]
    write_text(file, _HEADER + "\n".join(lines) + "\n")
