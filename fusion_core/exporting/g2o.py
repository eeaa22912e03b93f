"""Pose graphs as g2o reads them (Kümmerle et al. 2011, "g2o: a general framework")."""

from pathlib import Path

import numpy as np

from fusion_core.files.atomic import write_text
from fusion_core.model.conventions import FloatArray
from fusion_core.model.pose_graph import PoseGraph

# The upper triangle of the information, row by row.
_UPPER = np.triu_indices(3)


def write_g2o(file: Path, graph: PoseGraph) -> None:
    """Write ``VERTEX_SE2 id x y yaw``, then ``EDGE_SE2 first second x y yaw`` and the information.

    Metres and radians; the first vertex is fixed. Raises ExportError where the folder cannot be
    written.
    """
    lines = [
        f"VERTEX_SE2 {node} {_numbers(pose)}" for node, pose in enumerate(graph.poses_map_node)
    ]
    lines.append("FIX 0")
    lines += [
        f"EDGE_SE2 {first} {second} {_numbers(pose)} {_numbers(information[_UPPER])}"
        for first, second, pose, information in zip(
            graph.first, graph.second, graph.pose_first_second, graph.information, strict=True
        )
    ]
    write_text(file, "\n".join(lines) + "\n")


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:z.9f}" for value in values.tolist())
