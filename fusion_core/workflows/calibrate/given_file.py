"""Extrinsics that a person has set, as a file that every ``--extrinsics`` reads."""

import json
from pathlib import Path

from fusion_core.files.atomic import write_text
from fusion_core.model.given_extrinsics import GivenExtrinsics


def write_given_extrinsics(path: Path, given: GivenExtrinsics) -> None:
    """Write the transforms as JSON: that of the only camera by itself, those of several by topic.

    Raises ExportError where it cannot be written.
    """
    tables = {
        topic: {"T_camera_lidar": pose.T_camera_lidar.tolist()}
        for topic, pose in given.cameras.items()
    }
    document = next(iter(tables.values())) if len(tables) == 1 else {"cameras": tables}
    write_text(path, json.dumps(document, indent=1) + "\n")
