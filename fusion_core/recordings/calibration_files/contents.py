"""Whether a file is a calibration, for whoever opens it as something else."""

from pathlib import Path

from fusion_core.model.errors import SettingsError
from fusion_core.recordings.calibration_files.document import NUMBERS_ALONE, read_document
from fusion_core.recordings.calibration_files.extrinsics import read_extrinsics
from fusion_core.recordings.calibration_files.stated_camera import stated_camera


def describe_calibration(path: Path) -> str | None:
    """What a calibration file states, as words; None for any other file.

    Numbers alone could be anything.
    """
    try:
        document = read_document(path, "")
    except SettingsError:
        return None
    if NUMBERS_ALONE in document:
        return None
    stated = []
    try:
        stated_camera(document)
        stated.append("intrinsics")
    except (ValueError, OverflowError):
        pass
    try:
        read_extrinsics(path)
        stated.append("extrinsics")
    except SettingsError:
        pass
    return f"the {' and '.join(stated)} of a calibration" if stated else None
