"""Intrinsics from images of a board against those that were given with the images.

    python -m tests.benchmarks.bench_intrinsics FOLDER

FOLDER holds images of a board of 7x5 inner corners, 105 mm squares, and camera_info.yaml. Both
cameras are judged on the same corners: the pose of each image is fitted to every other corner, the
error measured on the rest. Ours has not seen the image; the given one is used as it is.
"""

import argparse
import os
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fusion_core.calibration.board.board import find_boards, parse_board
from fusion_core.calibration.board.board_pose import fit_plane_pose
from fusion_core.calibration.board.intrinsics import (
    IntrinsicsSettings,
    estimate_intrinsics,
    held_out_residuals_px,
)
from fusion_core.lens.undistortion import undistort_pixels
from fusion_core.model.conventions import FloatArray
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics


def rms_px(errors_px: FloatArray) -> float:
    return float(np.sqrt((errors_px**2).sum(axis=1).mean()))


def rays(pixels: FloatArray, camera: CameraIntrinsics) -> FloatArray:
    """(N, 3) unit vectors."""
    flat = np.column_stack([undistort_pixels(pixels, camera), np.ones(len(pixels))])
    unit: FloatArray = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    return unit


def agreement_px(one: CameraIntrinsics, other: CameraIntrinsics, pixels: FloatArray) -> FloatArray:
    """(N,) how far the rays of two cameras through the same pixels are apart, in pixels at the
    first one's focal length, after the rotation that brings them together best: a calibration does
    not know how its camera is turned in its housing."""
    first, second = rays(pixels, one), rays(pixels, other)

    def apart(rotation_vector: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(rotation_vector).apply(second)
        return (turned - first).ravel()

    turn = least_squares(apart, np.zeros(3)).x
    difference: FloatArray = one.fx * np.linalg.norm(apart(turn).reshape(-1, 3), axis=1)
    return difference


def main() -> None:
    data = Path(os.environ.get("SCANLOOM_TEST_DATA", "."))
    default = data / "real" / "calibration" / "acfr_board"
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    folder = parser.parse_args().folder
    files = sorted(folder.glob("*.png"))
    images = [cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files]
    found = find_boards(
        [np.asarray(image, np.uint8) for image in images], parse_board("7x5", 0.105)
    )
    board, shape = found.board, images[0].shape[:2]
    given = read_intrinsics(folder / "camera_info.yaml", (shape[1], shape[0]))
    print(f"{board.describe()}; the size given counts {found.board.counted}")
    ours = {
        "fisheye": estimate_intrinsics(
            board, found.corners_px, shape, IntrinsicsSettings(model="fisheye")
        ),
        "pinhole": estimate_intrinsics(board, found.corners_px, shape),
    }
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    theirs = dict(
        zip(names, (given.fx, given.fy, given.cx, given.cy, *given.distortion), strict=True)
    )
    chosen = ours["fisheye"]
    print("\nparameter        given         ours   difference      our sd  diff/sd")
    for name, value, sd in zip(chosen.names, chosen.values, chosen.sd, strict=True):
        off = theirs[name] - value
        print(f"{name:9}{theirs[name]:13.4f}{value:13.4f}{off:13.4f}{sd:12.4f}{off / sd:9.1f}")
    for name in names[chosen.values.size :]:
        print(f"{name:9}{theirs[name]:13.4f}       not kept: images left out gain nothing by it")
    for title, camera in (("given", given), ("ours", chosen.intrinsics)):
        rim = rays(np.array([[0.0, shape[0] / 2], [shape[1] - 1.0, shape[0] / 2]]), camera)
        angle = np.degrees(np.arccos(np.clip(rim[0] @ rim[1], -1.0, 1.0)))
        print(f"field of view across, {title}: {angle:.1f} deg")
    print("\nreprojection rms [px]            same corners   every other corner held out")
    corners = [one for one in found.corners_px if one is not None]
    fitted = [fit_plane_pose(board.points_m(), one, given) for one in corners]
    own = np.concatenate([pose.residuals_px for pose in fitted if pose is not None])
    held = np.concatenate([held_out_residuals_px(board, one, given) for one in corners])
    print(f"{'given':33}{rms_px(own):12.3f}{rms_px(held):15.3f}")
    for title, estimate in ours.items():
        print(
            f"{'ours, ' + title:33}{estimate.rms_used_px:12.3f}"
            f"{estimate.rms_held_out_px:15.3f}   (on images left out)"
        )
    print("\nimage            " + "".join(f"{file.stem:>9}" for file in files))
    given_px = [rms_px(held_out_residuals_px(board, one, given)) for one in corners]
    print("given            " + "".join(f"{value:9.3f}" for value in given_px))
    print("ours, left out   " + "".join(f"{value:9.3f}" for value in chosen.image_rms_px))
    covered = np.concatenate(corners)
    print("\nrays through the covered area, apart after the best rotation [px at our fx]")
    for title, camera in (
        ("given", given),
        ("pinhole", ours["pinhole"].intrinsics),
    ):
        off = agreement_px(chosen.intrinsics, camera, covered)
        print(
            f"ours (fisheye) and {title:8} rms {np.sqrt((off**2).mean()):8.3f}"
            f"  largest {off.max():8.3f}"
        )


if __name__ == "__main__":
    main()
