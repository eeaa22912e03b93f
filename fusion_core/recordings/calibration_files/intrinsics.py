"""A camera's intrinsics from a file.

- ROS: camera_info as camera_info_manager writes it (``image_width``, ``camera_matrix``,
  ``distortion_coefficients``), or as the message is printed (``width``, ``K``, ``D``).
- Our own, TOML or JSON: ``K``, ``width``, ``height``, ``distortion``, ``distortion_model``.
- KITTI: ``P2``, the rectified camera of ``image_2``, without distortion.
- OpenCalib: text with ``K`` and ``D``, or JSON with ``cam_K`` and ``cam_dist``.
- Open3D (``intrinsic_matrix``), OpenCV (``camera_matrix``), ``fx`` and the others by name, and the
  numbers of K or fx fy cx cy alone.
"""

from pathlib import Path

from fusion_core.model.errors import SettingsError
from fusion_core.model.sensors import FISHEYE_MODELS, CameraIntrinsics
from fusion_core.recordings.calibration_files.document import read_document
from fusion_core.recordings.calibration_files.stated_camera import StatedCamera, stated_camera
from fusion_core.recordings.quoting import quote_clipped

_ADVICE = "It needs K (3 x 3) or fx, fy, cx, cy, in pixels; width and height; and the distortion."
# OpenCV's model under the names of ROS, Kalibr and others.
_MODELS = ("plumb_bob", "rational_polynomial", "radtan", "pinhole", "none", *FISHEYE_MODELS)
# A file that does not state its images' size is checked by the image's centre: that of a lens lies
# near the middle of the whole image, and would not in one of half or twice the size.
_CENTRE_MIN, _CENTRE_MAX = 0.3, 0.7


def read_intrinsics(
    path: Path, image_size: tuple[int, int] | None = None, notes: list[str] | None = None
) -> CameraIntrinsics:
    """The intrinsics in a file for images of ``image_size`` (width, height) pixels.

    Without ``image_size`` the file must state the size. ``notes`` gets a line where OpenCalib's
    file states another size but has its centre in the middle of the image.

    Raises SettingsError for a file that states no camera, or one with images of another size.
    """
    document = read_document(path, _ADVICE)
    try:
        camera = stated_camera(document)
    except (ValueError, OverflowError) as error:
        raise SettingsError(f"states no camera: {error}.", file=path, advice=_ADVICE) from error
    width, height = _image_size(camera, image_size, path)
    if notes is not None and camera.size not in (None, (width, height)):
        notes.append(
            f"{path.name} states images of {_by(camera.size)} pixels; the image has "
            f"{width} x {height}, and its middle agrees with the file's centre."
        )
    _require_model(camera, path)
    fx, fy, cx, cy = camera.pinhole
    try:
        return CameraIntrinsics(
            width=width,
            height=height,
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            distortion_model=camera.distortion_model,
            distortion=camera.distortion,
        )
    except ValueError as error:
        raise SettingsError(f"states no camera: {error}.", file=path, advice=_ADVICE) from error


def _image_size(
    camera: StatedCamera, image_size: tuple[int, int] | None, path: Path
) -> tuple[int, int]:
    if camera.size is not None and (camera.is_size_certain or image_size is None):
        if image_size not in (None, camera.size):
            raise SettingsError(
                f"is for images of {_by(camera.size)} pixels, the image has {_by(image_size)}.",
                file=path,
                advice="Give the image or the intrinsics of the same size.",
            )
        return camera.size
    if image_size is None:
        raise SettingsError(
            "does not state the size of the images.", file=path, advice="Add width and height."
        )
    centre = (camera.pinhole[2], camera.pinhole[3])
    if not all(
        _CENTRE_MIN <= (place + 0.5) / side <= _CENTRE_MAX
        for place, side in zip(centre, image_size, strict=True)
    ):
        raise SettingsError(
            f"puts the centre at pixel ({centre[0]:g}, {centre[1]:g}), far from the middle of an "
            f"image of {_by(image_size)}: it is for images of another size.",
            file=path,
            advice="Give the image as it was calibrated; for a part of it, add width and height.",
        )
    return image_size


def _by(size: tuple[int, int] | None) -> str:
    return " x ".join(map(str, size or ()))


def _require_model(camera: StatedCamera, path: Path) -> None:
    model = camera.distortion_model
    if model not in _MODELS:
        raise SettingsError(
            f"has the distortion model {quote_clipped(model)}.",
            file=path,
            advice=f"Known are {', '.join(_MODELS)}.",
        )
    if model in FISHEYE_MODELS and len(camera.distortion) not in (0, 4):
        raise SettingsError(
            f"has {len(camera.distortion)} distortion coefficients of the model {model}.",
            file=path,
            advice="A fisheye camera has four: k1, k2, k3, k4.",
        )
