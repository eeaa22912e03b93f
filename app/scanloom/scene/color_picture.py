"""A camera's colour image as it is shown in the scene: upright, like its depth, and small."""

import cv2
import numpy as np

from fusion_core.model.conventions import ByteArray
from fusion_core.workflows.fuse.camera_rig import CameraRig


def upright_color(rgb: ByteArray, rig: CameraRig, camera: int, most_px: int = 320) -> ByteArray:
    """A stored colour image as the camera's upright view has it, at most ``most_px`` wide: turned
    as the depth is, and cut to the columns that are used."""
    view = rig.views[camera]
    R = view.R_stored_view
    turns = round(np.arctan2(R[1, 0], R[0, 0]) / (0.5 * np.pi)) % 4
    turned = np.rot90(rgb, turns)
    used = view.intrinsics.width / view.stored_shape[1 if turns % 2 == 0 else 0]
    first = round(0.5 * (1.0 - used) * turned.shape[1])
    turned = np.ascontiguousarray(turned[:, first : turned.shape[1] - first])
    height, width = turned.shape[:2]
    if width <= most_px:
        return turned
    size = (most_px, max(1, round(height * most_px / width)))
    return np.asarray(cv2.resize(turned, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
