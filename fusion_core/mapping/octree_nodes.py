"""Octrees as arrays of nodes: their leaves down to a depth, and pruning."""

import numpy as np
from numpy.typing import NDArray

from fusion_core.compiled import compiled
from fusion_core.model.conventions import (
    BoolArray,
    ByteArray,
    Float32Array,
    Int32Array,
)
from fusion_core.model.octree import TREE_DEPTH, OccupancyOctree, OctreeLeaves

# A node leaves at most seven brothers waiting at each level.
_STACK = 8 * (TREE_DEPTH + 1)


def leaves_of(octree: OccupancyOctree, depth_max: int = TREE_DEPTH) -> OctreeLeaves:
    """The leaves, in the order of the nodes; nodes at ``depth_max`` count as leaves.

    Such a node has the greatest log odds of what it covers, as OctoMap's own queries of a limited
    depth have it. Raises ValueError for nodes that are no octree.
    """
    if not 0 <= depth_max <= TREE_DEPTH:
        raise ValueError(f"depth_max must be 0 to {TREE_DEPTH}, got {depth_max}")
    log_odds, children = _columns(octree.nodes)
    corners = np.empty((len(children), 3), dtype=np.int32)
    sides = np.empty(len(children), dtype=np.int32)
    places = np.empty(len(children), dtype=np.int32)
    count = _walk(children, depth_max, corners, sides, places) if len(children) else 0
    if count < 0:
        raise ValueError("the nodes are no octree: children are missing, too many or too deep")
    return OctreeLeaves(
        resolution_m=octree.resolution_m,
        corners=corners[:count].copy(),
        sides=sides[:count].copy(),
        log_odds=log_odds[places[:count]],
    )


def boxes_of(
    octree: OccupancyOctree, depth: int = TREE_DEPTH, boxes_max: int = 50_000
) -> tuple[OctreeLeaves, int]:
    """The occupied leaves for display, at most ``boxes_max``, and the depth that they are cut to.

    That is ``depth``, or the greatest one less than it that has few enough.
    """
    for cut in range(depth, -1, -1):
        leaves = leaves_of(octree, cut)
        occupied = leaves.select(leaves.occupied)
        if len(occupied) <= boxes_max:
            break
    return occupied, cut


def prune(nodes: NDArray[np.void]) -> NDArray[np.void]:
    """The same octree with the fewest nodes: eight leaves of the same log odds become one.

    Gives each inner node the greatest log odds of its children, whatever it had.
    """
    if not len(nodes):
        return nodes.copy()
    pruned = nodes.copy()
    log_odds, children = _columns(pruned)
    kept = _prune(log_odds, children)
    pruned["log_odds"], pruned["children"] = log_odds, children
    fewest: NDArray[np.void] = pruned[kept]
    return fewest


def _columns(nodes: NDArray[np.void]) -> tuple[Float32Array, ByteArray]:
    return np.ascontiguousarray(nodes["log_odds"]), np.ascontiguousarray(nodes["children"])


@compiled(error_model="numpy")
def _walk(
    children: ByteArray,
    depth_max: int,
    corners: Int32Array,
    sides: Int32Array,
    places: Int32Array,
) -> int:
    """Fill in the boxes of the leaves and their places among the nodes; how many, -1 for none."""
    # Of each inner node on the path: which children are still to come, and where it lies.
    waiting = np.zeros(TREE_DEPTH + 1, dtype=np.int64)
    low = np.zeros((TREE_DEPTH + 1, 3), dtype=np.int64)
    low[0, :] = -(1 << (TREE_DEPTH - 1))
    depth = 0
    count = 0
    for i in range(children.size):
        mask = np.int64(children[i])
        if depth == depth_max or (mask == 0 and depth < depth_max):
            for axis in range(3):
                corners[count, axis] = low[depth, axis]
            sides[count] = 1 << (TREE_DEPTH - depth)
            places[count] = i
            count += 1
        if mask != 0 and depth == TREE_DEPTH:
            return -1
        waiting[depth] = mask
        while depth >= 0 and waiting[depth] == 0:
            depth -= 1
        if depth < 0:
            return count if i == children.size - 1 else -1
        child = 0
        while not (waiting[depth] >> child) & 1:
            child += 1
        waiting[depth] &= ~(1 << child)
        half = 1 << (TREE_DEPTH - depth - 1)
        for axis in range(3):
            low[depth + 1, axis] = low[depth, axis] + half * ((child >> axis) & 1)
        depth += 1
    return -1


@compiled(error_model="numpy")
def _prune(log_odds: Float32Array, children: ByteArray) -> BoolArray:
    """Prune in place; which nodes remain. Backwards, so that children come before their parent."""
    kept = np.ones(children.size, dtype=np.bool_)
    # The nodes whose parent is still to come, the first child on top.
    stack = np.empty(_STACK, dtype=np.int64)
    top = 0
    for i in range(children.size - 1, -1, -1):
        if children[i] != 0:
            first = stack[top - 1]
            greatest = log_odds[first]
            alike = children[i] == 255
            mask = np.int64(children[i])
            start = top
            while mask != 0:
                mask &= mask - 1
                top -= 1
                child = stack[top]
                greatest = max(greatest, log_odds[child])
                alike = alike and children[child] == 0 and log_odds[child] == log_odds[first]
            log_odds[i] = greatest
            if alike:
                children[i] = 0
                for k in range(top, start):
                    kept[stack[k]] = False
        stack[top] = i
        top += 1
    return kept
