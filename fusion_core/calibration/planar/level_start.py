"""A pose that is turned so that the LiDAR's axis is along the up that the camera sees."""

from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import FloatArray
from fusion_core.model.geometry import make_transform


def turn_level(T_camera_lidar: FloatArray, up: FloatArray) -> FloatArray:
    """(4, 4) the pose with the LiDAR's axis along ``up`` (3,) of the camera's frame, by the least
    turn of the camera about its own place. ``up`` is not opposite to that axis."""
    R, t = T_camera_lidar[:3, :3], T_camera_lidar[:3, 3]
    Q = Rotation.align_vectors(up, R[:, 2])[0].as_matrix()
    # The camera's place in the LiDAR's frame is -R^T t.
    return make_transform(Q @ R, Q @ t)
