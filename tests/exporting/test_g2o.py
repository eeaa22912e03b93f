"""Pose graphs as g2o files."""

import numpy as np

from fusion_core.exporting.g2o import write_g2o
from fusion_core.model.pose_graph import PoseGraph


def test_each_number_is_where_g2o_reads_it(tmp_path):
    information = np.array([[4.0, 1.0, 2.0], [1.0, 5.0, 3.0], [2.0, 3.0, 6.0]])
    graph = PoseGraph(
        poses_map_node=np.array([[0.0, -0.0, 0.0], [1.5, -2.0, 0.25]]),
        first=np.array([0]),
        second=np.array([1]),
        pose_first_second=np.array([[1.25, -2.0, 0.5]]),
        information=information[np.newaxis],
        is_loop=np.array([True]),
    )
    write_g2o(tmp_path / "graph.g2o", graph)
    lines = (tmp_path / "graph.g2o").read_text(encoding="utf-8").splitlines()
    words = [line.split() for line in lines]
    assert [line[0] for line in words] == ["VERTEX_SE2", "VERTEX_SE2", "FIX", "EDGE_SE2"]
    assert "-0.0" not in lines[0]
    assert list(map(float, words[1][1:])) == [1, 1.5, -2.0, 0.25]
    assert list(map(float, words[3][1:])) == [0, 1, 1.25, -2.0, 0.5, 4, 1, 2, 5, 3, 6]
