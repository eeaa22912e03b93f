"""A room of 11 x 8 m with four boxes: pairs of noisy sweeps in it, and how well they could match.

Poses are (x, y, yaw) in metres and radians; a sweep has beams on the full turn, the first one at
-pi. The boxes stand where a person could have put them: two along the walls' axes, two askew.
"""

from dataclasses import dataclass

import numpy as np

from fusion_core.model.conventions import FloatArray, IntArray

ROOM_M = (11.0, 8.0)
# Centre x, y, width, depth, yaw of each box.
BOXES = (
    (2.2, 6.0, 1.2, 0.6, 0.0),
    (8.6, 6.2, 0.8, 0.8, 0.5),
    (3.4, 1.8, 0.9, 0.7, -0.35),
    (8.2, 2.0, 1.5, 0.5, 0.0),
)
CLEARANCE_M = 0.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two sweeps, (N,) metres each, and the pose (3,) of the second in the first's frame.

    ``poses``: (2, 3), of both in the room.
    """

    first_m: FloatArray
    second_m: FloatArray
    angle_min_rad: float
    angle_increment_rad: float
    pose_first_second: FloatArray
    poses: FloatArray


def rectangle(centre: tuple[float, float], size: tuple[float, float], yaw_rad: float) -> FloatArray:
    """(4, 2, 2) the sides of a rectangle: start and end of each."""
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * size
    turn = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
    corners = corners @ turn.T + centre
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


WALLS = np.concatenate(
    [rectangle((ROOM_M[0] / 2, ROOM_M[1] / 2), ROOM_M, 0.0)]
    + [rectangle((x, y), (width, depth), yaw) for x, y, width, depth, yaw in BOXES]
)


def cast(
    walls: FloatArray, pose: FloatArray, angles_rad: FloatArray
) -> tuple[FloatArray, IntArray]:
    """(N,) range of the first wall met by each beam (inf where none is), and (N,) its index."""
    direction = np.stack([np.cos(pose[2] + angles_rad), np.sin(pose[2] + angles_rad)], axis=1)
    along = walls[:, 1] - walls[:, 0]
    to_start = walls[:, 0] - pose[:2]
    across = direction[:, :1] * along[:, 1] - direction[:, 1:] * along[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (to_start[:, 0] * along[:, 1] - to_start[:, 1] * along[:, 0]) / across
        share = (to_start[:, 0] * direction[:, 1:] - to_start[:, 1] * direction[:, :1]) / across
    met = (distance > 0.0) & (share >= 0.0) & (share <= 1.0)
    distance = np.where(met, distance, np.inf)
    wall = distance.argmin(axis=1)
    return distance[np.arange(angles_rad.size), wall], wall


def full_turn(beams: int) -> tuple[float, float]:
    """First angle and increment of a sweep that covers the full turn."""
    return -np.pi, 2.0 * np.pi / beams


def is_free(position_m: FloatArray) -> bool:
    """Whether a robot can stand there: inside the room, off walls and boxes."""
    if (position_m < CLEARANCE_M).any() or (position_m > np.array(ROOM_M) - CLEARANCE_M).any():
        return False
    for x, y, width, depth, yaw in BOXES:
        turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        off = np.abs((position_m - (x, y)) @ turn) - np.array([width, depth]) / 2.0
        if (off < CLEARANCE_M).all():
            return False
    return True


def compose(pose_a_b: FloatArray, pose_b_c: FloatArray) -> FloatArray:
    """pose_a_c, its yaw wrapped."""
    c, s = np.cos(pose_a_b[2]), np.sin(pose_a_b[2])
    x = pose_a_b[0] + c * pose_b_c[0] - s * pose_b_c[1]
    y = pose_a_b[1] + s * pose_b_c[0] + c * pose_b_c[1]
    yaw = pose_a_b[2] + pose_b_c[2]
    return np.array([x, y, np.arctan2(np.sin(yaw), np.cos(yaw))])


def inverse(pose_a_b: FloatArray) -> FloatArray:
    """pose_b_a."""
    c, s = np.cos(pose_a_b[2]), np.sin(pose_a_b[2])
    x, y = pose_a_b[:2]
    return np.array([-c * x - s * y, s * x - c * y, -pose_a_b[2]])


def draw_pair(
    rng: np.random.Generator, beams: int, shift_m: float, turn_rad: float, sigma_m: float
) -> Pair:
    """Two sweeps from free places.

    The distance is uniform up to ``shift_m`` in a uniform direction, the turn uniform within
    ± ``turn_rad``; the noise is Gaussian on each range of both sweeps.
    """
    while True:
        first = np.append(rng.uniform((0.0, 0.0), ROOM_M), rng.uniform(-np.pi, np.pi))
        distance, direction = rng.uniform(0.0, shift_m), rng.uniform(-np.pi, np.pi)
        moved = np.array(
            [distance * np.cos(direction), distance * np.sin(direction), rng.uniform(-1.0, 1.0)]
        )
        moved[2] *= turn_rad
        second = compose(first, moved)
        if is_free(first[:2]) and is_free(second[:2]):
            break
    angle_min_rad, angle_increment_rad = full_turn(beams)
    angles_rad = angle_min_rad + angle_increment_rad * np.arange(beams)
    ranges_m = [
        cast(WALLS, pose, angles_rad)[0] + rng.normal(0.0, sigma_m, beams)
        for pose in (first, second)
    ]
    return Pair(
        first_m=ranges_m[0],
        second_m=ranges_m[1],
        angle_min_rad=angle_min_rad,
        angle_increment_rad=angle_increment_rad,
        pose_first_second=moved,
        poses=np.stack([first, second]),
    )


def bound(pair: Pair, sigma_m: float) -> FloatArray:
    """(3, 3) Cramér-Rao bound of the second pose in the first's frame, the walls being unknown.

    Both sweeps are noisy, and each wall that they meet is a line with two unknowns (direction and
    distance); which beam meets which wall is taken as known, so no matcher can be better.
    """
    angles_rad = pair.angle_min_rad + pair.angle_increment_rad * np.arange(pair.first_m.size)
    information = np.zeros((3 + 2 * len(WALLS), 3 + 2 * len(WALLS)))
    for sweep, pose in enumerate(pair.poses):
        ranges_m, wall = cast(WALLS, pose, angles_rad)
        along = WALLS[wall, 1] - WALLS[wall, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # In the first frame, in which the pose is to be found.
        turn = pair.poses[0, 2]
        along = along @ np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        azimuth = angles_rad + (pair.pose_first_second[2] if sweep else 0.0)
        direction = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        place = pair.pose_first_second[:2] * sweep
        point = place + ranges_m[:, None] * direction
        slope = (normal * direction).sum(axis=1)
        rows = np.zeros((ranges_m.size, information.shape[0]))
        # n(φ) · (t + r d(θ)) = h, differentiated for r.
        index = np.arange(ranges_m.size)
        rows[index, 3 + 2 * wall] = 1.0 / slope
        rows[index, 4 + 2 * wall] = (along * point).sum(axis=1) / slope
        if sweep:
            lever = np.stack([-direction[:, 1], direction[:, 0]], axis=1) * ranges_m[:, None]
            rows[:, :2] = -normal / slope[:, None]
            rows[:, 2] = -(normal * lever).sum(axis=1) / slope
        information += rows.T @ rows / sigma_m**2
    # Lines that few beams meet leave their own unknowns open, not the pose.
    lines = information[3:, 3:]
    pose_information = (
        information[:3, :3]
        - information[:3, 3:] @ np.linalg.pinv(lines, hermitian=True) @ information[3:, :3]
    )
    return np.linalg.inv(pose_information)
