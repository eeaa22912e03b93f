"""Street scenes of other people, each a cloud and an image with given extrinsics."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray, FloatArray
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.recordings.calibration_files.extrinsics import read_guess
from fusion_core.recordings.calibration_files.intrinsics import read_intrinsics
from fusion_core.recordings.clouds.formats import read_cloud

# Cloud, image, intrinsics, extrinsics.
SCENES = {
    "opencalib_street": ("calib.pcd", "calib.jpg", "calib.txt", "calib.txt"),
    "opencalib_manual": (
        "0.pcd",
        "0.png",
        "center_camera-intrinsic.json",
        "top_center_lidar-to-center_camera-extrinsic.json",
    ),
    "kitti_000000": ("000000.bin", "000000.png", "000000.txt", "000000.txt"),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetScene:
    """A cloud, an image and the given extrinsics."""

    points_m: FloatArray
    intensity: FloatArray
    grey: ByteArray
    intrinsics: CameraIntrinsics
    T_given: FloatArray


def read_scene(data: Path, name: str) -> StreetScene:
    """One of SCENES below the folder that SCANLOOM_TEST_DATA names."""
    folder = data / "real" / "calibration" / name
    cloud_name, image_name, intrinsics_name, extrinsics_name = SCENES[name]
    grey = cv2.imread(str(folder / image_name), cv2.IMREAD_GRAYSCALE)
    assert grey is not None, image_name
    cloud = read_cloud(folder / cloud_name)
    assert cloud.intensity is not None
    size = (grey.shape[1], grey.shape[0])
    return StreetScene(
        points_m=cloud.xyz_m.astype(np.float64),
        intensity=cloud.intensity.astype(np.float64),
        grey=np.asarray(grey, dtype=np.uint8),
        intrinsics=read_intrinsics(folder / intrinsics_name, size, []),
        T_given=read_guess(folder / extrinsics_name),
    )
