"""Octrees in OctoMap's full format (``.ot``).

Source: OctoMap's ``AbstractOcTree::write``: lines of text to "data", then the nodes depth first,
each with its log odds and a bit for each child.
"""

from pathlib import Path

import numpy as np

from fusion_core.files.regular_file import read_regular
from fusion_core.model.errors import RecordingError
from fusion_core.model.octree import NODE_TYPE, OccupancyOctree

_FIRST_LINE = b"# Octomap OcTree file"
_MAX_BYTES = 2 << 30
_MAX_HEADER_BYTES = 4096


def read_octree(path: Path) -> OccupancyOctree:
    """An octree of occupancy. Raises RecordingError where the file is none."""
    try:
        content = read_regular(path, _MAX_BYTES)
        head, found, body = content.partition(b"\ndata\n")
        if not content.startswith(_FIRST_LINE) or not found or len(head) > _MAX_HEADER_BYTES:
            raise ValueError("its head is not that of an OcTree")
        lines = [line.split() for line in head.decode("ascii").splitlines()]
        fields = {line[0]: line[1] for line in lines if len(line) == 2 and line[0] != "#"}
        if fields["id"] != "OcTree":
            raise ValueError(f"a tree of the kind {fields['id']}")
        count = int(fields["size"])
        if len(body) != count * NODE_TYPE.itemsize:
            raise ValueError(f"{len(body)} bytes for {count} nodes")
        nodes = np.frombuffer(body, dtype=NODE_TYPE).copy()
        return OccupancyOctree(resolution_m=float(fields["res"]), nodes=nodes)
    except (OSError, ValueError, KeyError) as error:
        raise RecordingError(
            f"is no octree that can be read: {type(error).__name__}: {error}.",
            file=path,
            advice="It must be an .ot file of OctoMap with occupancy alone.",
        ) from error
