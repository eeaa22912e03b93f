"""The axis of a frame that turns about a fixed line, from its poses."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.calibration.turning.axis_angles import AxisAngles, make_axis_angles
from fusion_core.model.conventions import FloatArray, IntArray, read_only
from fusion_core.model.errors import CalibrationFailed
from fusion_core.model.geometry import make_transform

_TURN_MIN_RAD = float(np.deg2rad(1.0))


@dataclass(frozen=True, slots=True)
class RotatingFrame:
    """``angles``: since the first pose. ``T_axis_frame``: (4, 4) from the frame that turns to the
    one whose z is the axis."""

    angles: AxisAngles
    T_axis_frame: FloatArray

    def __post_init__(self) -> None:
        read_only(self.T_axis_frame)


def find_rotation_axis(stamps_ns: IntArray, T_parent_frame: FloatArray) -> RotatingFrame:
    """The axis of (N, 4, 4) poses at (N,) stamps.

    Raises CalibrationFailed for fewer than two poses and for a frame that does not turn.
    """
    order = np.argsort(stamps_ns, kind="stable")
    stamps_ns, T_parent_frame = stamps_ns[order], T_parent_frame[order]
    rotations = Rotation.from_matrix(T_parent_frame[:, :3, :3])
    steps = (rotations[:-1].inv() * rotations[1:]).as_rotvec() if len(stamps_ns) > 1 else None
    if steps is None or np.linalg.norm(steps, axis=1).sum() < _TURN_MIN_RAD:
        raise CalibrationFailed(
            "the axis stands still in the recorded transforms.",
            advice="Record while it turns through 360 degrees.",
        )
    _, _, directions = np.linalg.svd(steps, full_matrices=False)
    axis = directions[0]
    # The side of the line on which its largest part is positive, so that +z stays +z.
    axis = axis * np.sign(axis[np.abs(axis).argmax()])
    angles_rad = np.concatenate([[0.0], np.cumsum(steps @ axis)])
    return RotatingFrame(
        make_axis_angles(stamps_ns, angles_rad),
        make_transform(_to_z(axis), np.zeros(3)) @ _to_line(T_parent_frame, axis),
    )


def _to_z(axis: FloatArray) -> FloatArray:
    """(3, 3) the smallest rotation that brings a unit vector to z."""
    if axis[2] < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    cross = np.cross(axis, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(cross))
    if sine < 1e-12:
        return np.eye(3)
    return np.asarray(Rotation.from_rotvec(cross / sine * np.arctan2(sine, axis[2])).as_matrix())


def _to_line(T_parent_frame: FloatArray, axis: FloatArray) -> FloatArray:
    """(4, 4) the shift by which the frame's origin lies off the axis.

    With the origin at c + R l for a fixed c, l is where it lies from the axis; how far along it
    does not show, and is 0.
    """
    count = len(T_parent_frame)
    design = np.concatenate(
        [np.broadcast_to(np.eye(3), (count, 3, 3)), T_parent_frame[:, :3, :3]], axis=2
    ).reshape(-1, 6)
    solution, *_ = np.linalg.lstsq(design, T_parent_frame[:, :3, 3].reshape(-1), rcond=1e-9)
    return make_transform(np.eye(3), solution[3:] - (solution[3:] @ axis) * axis)
