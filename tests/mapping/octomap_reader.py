"""The published formats .ot and .bt read by plain recursion, independent of OctoMap and of ours.

Leaves are a dictionary of (x, y, z, side) in finest cells from the map's origin.
"""

import struct

DEPTH = 16
Leaves = dict[tuple[int, int, int, int], float]


def read_ot(content: bytes) -> tuple[float, Leaves]:
    """Resolution, and the log odds of each leaf."""
    resolution, count, body = _header(content, b"# Octomap OcTree file")
    leaves: Leaves = {}
    place = 0
    nodes = 0

    def node(corner, depth):
        nonlocal place, nodes
        log_odds, children = struct.unpack_from("<fB", body, place)
        place += 5
        nodes += 1
        if children == 0:
            leaves[(*corner, 1 << (DEPTH - depth))] = log_odds
        for i in range(8):
            if children >> i & 1:
                node(_child(corner, depth, i), depth + 1)

    node(_root(), 0)
    assert place == len(body)
    assert nodes == count
    return resolution, leaves


def read_bt(content: bytes) -> tuple[float, Leaves]:
    """Resolution, and whether each leaf is occupied, 1.0 or 0.0."""
    resolution, count, body = _header(content, b"# Octomap OcTree binary file")
    leaves: Leaves = {}
    place = 0
    nodes = 1

    def node(corner, depth):
        nonlocal place, nodes
        bits = body[place] | body[place + 1] << 8
        place += 2
        inner = []
        for i in range(8):
            first, second = bits >> 2 * i & 1, bits >> (2 * i + 1) & 1
            if not first and not second:
                continue
            nodes += 1
            child = _child(corner, depth, i)
            if first and second:
                inner.append(child)
            else:
                leaves[(*child, 1 << (DEPTH - depth - 1))] = float(second)
        for child in inner:
            node(child, depth + 1)

    node(_root(), 0)
    assert place == len(body)
    assert nodes == count
    return resolution, leaves


def _header(content, first_line):
    head, found, body = content.partition(b"\ndata\n")
    assert found
    lines = head.split(b"\n")
    assert lines[0] == first_line
    fields = dict(line.split(b" ", 1) for line in lines[1:] if not line.startswith(b"#"))
    assert fields[b"id"] == b"OcTree"
    return float(fields[b"res"]), int(fields[b"size"]), body


def _root():
    return (-(1 << (DEPTH - 1)),) * 3


def _child(corner, depth, i):
    half = 1 << (DEPTH - depth - 1)
    return tuple(corner[axis] + half * (i >> axis & 1) for axis in range(3))
