"""Boards before a camera that is known, drawn by a homography and not by the project's code."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.calibration.board.board import Board
from fusion_core.model.sensors import CameraIntrinsics

BOARD = Board(columns=7, rows=5, square_m=0.1)
PINHOLE = CameraIntrinsics(
    width=640,
    height=480,
    fx=520.0,
    fy=515.0,
    cx=327.0,
    cy=231.0,
    distortion=(-0.28, 0.09, 0.001, -0.0007),
)
FISHEYE = CameraIntrinsics(
    width=640,
    height=480,
    fx=300.0,
    fy=301.0,
    cx=322.0,
    cy=238.0,
    distortion_model="equidistant",
    distortion=(-0.02, 0.004, 0.0, 0.0),
)


def board_pose(rng, tilt_deg=35.0):
    """(4, 4) of a board that faces the camera, tilted about both axes, whole in the image."""
    T = np.eye(4)
    angles = rng.uniform(-tilt_deg, tilt_deg, 3)
    T[:3, :3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    middle = BOARD.points_m().mean(axis=0)
    distance = rng.uniform(0.9, 1.6)
    target = np.array([*rng.uniform(-0.3, 0.3, 2), 1.0]) * distance
    T[:3, 3] = target - T[:3, :3] @ middle
    return T


def opencv_projection(points_m, T, camera):
    """(N, 2) by the documented formulas of the two models, written out."""
    p = points_m @ T[:3, :3].T + T[:3, 3]
    x, y = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    r = np.hypot(x, y)
    if camera.distortion_model == "equidistant":
        theta = np.arctan(r)
        powers = sum(k * theta ** (2 * n + 2) for n, k in enumerate(camera.distortion))
        factor = theta * (1 + powers) / np.maximum(r, 1e-12)
        x, y = x * factor, y * factor
    else:
        k1, k2, p1, p2 = camera.distortion
        radial = 1 + k1 * r**2 + k2 * r**4
        x, y = (
            x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2),
            y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y,
        )
    return np.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], axis=1)


def corner_sets(camera, seed, count=14, sigma_px=0.1, tilt_deg=35.0):
    """Corners of boards that lie inside the image, with noise of each."""
    rng = np.random.default_rng(seed)
    sets = []
    while len(sets) < count:
        pixels = opencv_projection(BOARD.points_m(), board_pose(rng, tilt_deg), camera)
        if (pixels > 5).all() and (pixels < (camera.width - 6, camera.height - 6)).all():
            sets.append(pixels + rng.normal(0.0, sigma_px, pixels.shape))
    return sets


def board_image(T, focal_px=520.0, size=(640, 480), board=BOARD, seed=0):
    """A grey image of the board with a white rim before a grey wall, and its (N, 2) corners; no
    distortion."""
    cell = 40
    squares = np.indices((board.rows + 1, board.columns + 1)).sum(axis=0) % 2
    pattern = np.kron(squares, np.ones((cell, cell))) * 215.0 + 20.0
    pattern = np.pad(pattern, cell, constant_values=235.0)
    # Pixel (cell * 2 - 0.5) of the pattern is the first inner corner.
    to_board = np.array(
        [
            [board.square_m / cell, 0, -(2 * cell - 0.5) * board.square_m / cell],
            [0, board.square_m / cell, -(2 * cell - 0.5) * board.square_m / cell],
            [0, 0, 1],
        ]
    )
    K = np.array([[focal_px, 0, size[0] / 2], [0, focal_px, size[1] / 2], [0, 0, 1]])
    H = K @ np.column_stack([T[:3, 0], T[:3, 1], T[:3, 3]]) @ to_board
    # Drawn four times as fine, then averaged, as a camera does.
    fine = np.diag([4.0, 4.0, 1.0])
    fine[:2, 2] = 1.5
    drawn = cv2.warpPerspective(
        pattern, fine @ H, (4 * size[0], 4 * size[1]), flags=cv2.INTER_LINEAR, borderValue=128.0
    )
    image = cv2.resize(drawn, size, interpolation=cv2.INTER_AREA)
    image += np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    p = board.points_m() @ T[:3, :3].T + T[:3, 3]
    corners = (p @ K.T)[:, :2] / p[:, 2:]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), corners
