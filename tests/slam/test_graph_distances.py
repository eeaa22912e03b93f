"""Distances along the graph, against a brute-force search of the shortest paths."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.slam.graph_distances import (
    BRIDGED_LOSS_DISTANCE_M,
    LOSS_DISTANCE_M,
    GraphDistances,
)

PER_SUBMAP, SUBMAPS = 5, 8
NODES = PER_SUBMAP * SUBMAPS


def trajectory(steps_m):
    """Keyframes on a straight line, a submap begun with every fifth."""
    places_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    poses = np.stack([places_m, np.zeros(NODES), np.zeros(NODES)], axis=1)
    submaps = [SimpleNamespace(first=PER_SUBMAP * number) for number in range(SUBMAPS)]
    return SimpleNamespace(poses_local_node=poses, submaps=submaps)


def losses(nodes=(), is_bridged=()):
    return SimpleNamespace(
        node_after=np.array(nodes, dtype=np.int64), is_bridged=np.array(is_bridged, dtype=bool)
    )


def expected_m(steps_m, loops, node):
    """Bellman-Ford over submaps, from the one that contains the node."""
    path_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    first = PER_SUBMAP * np.arange(SUBMAPS)
    edges = [(n, n + 1, path_m[first[n + 1]] - path_m[first[n]]) for n in range(SUBMAPS - 1)]
    for number, end in loops:
        other = end // PER_SUBMAP
        edges.append((number, other, 1.0 + path_m[end] - path_m[first[other]]))
    distances_m = np.full(SUBMAPS, np.inf)
    distances_m[node // PER_SUBMAP] = 0.0
    for _ in range(SUBMAPS):
        for a, b, length_m in edges:
            distances_m[b] = min(distances_m[b], distances_m[a] + length_m)
            distances_m[a] = min(distances_m[a], distances_m[b] + length_m)
    return distances_m + path_m[node] - path_m[first[node // PER_SUBMAP]]


steps = st.lists(st.floats(0.05, 3.0), min_size=NODES - 1, max_size=NODES - 1)
ends = st.tuples(st.integers(0, SUBMAPS - 1), st.integers(0, NODES - 1))


@given(steps, st.lists(ends, max_size=6), st.integers(0, NODES - 1))
def test_distances_are_the_shortest(steps_m, loops, node):
    distances = GraphDistances(trajectory(steps_m), losses())
    for done, (number, end) in enumerate(loops):
        # A result from before must not be returned after the next loop.
        np.testing.assert_allclose(
            distances.to_submaps(node), expected_m(steps_m, loops[:done], node), atol=1e-9
        )
        distances.add_loop(number, end)
    np.testing.assert_allclose(
        distances.to_submaps(node), expected_m(steps_m, loops, node), atol=1e-9
    )


@pytest.mark.parametrize(
    ("is_bridged", "longer_m"), [(True, BRIDGED_LOSS_DISTANCE_M), (False, LOSS_DISTANCE_M)]
)
def test_a_tracking_loss_is_a_long_distance(is_bridged, longer_m):
    steps_m = np.full(NODES - 1, 0.2)
    whole = GraphDistances(trajectory(steps_m), losses())
    with_loss = GraphDistances(trajectory(steps_m), losses([12], [is_bridged]))
    more_m = with_loss.to_submaps(0) - whole.to_submaps(0)
    np.testing.assert_allclose(more_m, [0.0] * 3 + [longer_m] * 5, atol=1e-6)
    with_loss.set_losses(losses())
    np.testing.assert_array_equal(with_loss.to_submaps(0), whole.to_submaps(0))
