"""The camera of depth images: its intrinsics in their size."""

from fusion_core.model.errors import MappingFailed
from fusion_core.model.sensors import CameraIntrinsics


def depth_intrinsics(intrinsics: CameraIntrinsics, shape: tuple[int, int]) -> CameraIntrinsics:
    """Of depth images of ``shape`` (height, width) that show the same as those of ``intrinsics``.

    Raises MappingFailed where the camera cannot have them.
    """
    try:
        return intrinsics.scaled_to(shape)
    except ValueError as error:
        raise MappingFailed(
            f"a depth image of {shape[1]} x {shape[0]} pixels is not of a camera with images of "
            f"{intrinsics.width} x {intrinsics.height}: {error}."
        ) from error
