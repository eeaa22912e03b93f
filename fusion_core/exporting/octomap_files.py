"""An octree as OctoMap's files: ``.ot`` with every node's log odds, ``.bt`` with occupied and free
leaves alone."""

import tempfile
from pathlib import Path

import numpy as np

from fusion_core.files.atomic import write_bytes
from fusion_core.model.errors import ExportError
from fusion_core.model.octree import OccupancyOctree


def write_octree(path: Path, octree: OccupancyOctree) -> None:
    """Write ``path`` in the format of its suffix, ``.ot`` or ``.bt``. Raises ExportError for
    another suffix."""
    if path.suffix == ".ot":
        write_bytes(path, _full_content(octree))
    elif path.suffix == ".bt":
        write_bytes(path, _binary_content(octree))
    else:
        raise ExportError(
            f"{path.suffix!r} is not an OctoMap format.", file=path, advice="Use .ot or .bt."
        )


def _full_content(octree: OccupancyOctree) -> bytes:
    header = (
        "# Octomap OcTree file\n"
        "# (feel free to add / change comments, but leave the first line as it is!)\n"
        "#\n"
        "id OcTree\n"
        f"size {len(octree.nodes)}\n"
        f"res {octree.resolution_m!r}\n"
        "data\n"
    )
    return header.encode("ascii") + np.ascontiguousarray(octree.nodes).tobytes()


def _binary_content(octree: OccupancyOctree) -> bytes:
    """By OctoMap, which makes each leaf certain and prunes what is alike then."""
    # Imported here: what only reads and displays does not wait for it.
    import pyoctomap

    with tempfile.TemporaryDirectory() as folder:
        full = Path(folder) / "octree.ot"
        full.write_bytes(_full_content(octree))
        tree = pyoctomap.OcTree(octree.resolution_m).read(str(full))
    if tree is None:
        raise ValueError("the octree's nodes are not what OctoMap reads")
    return bytes(tree.writeBinary())
