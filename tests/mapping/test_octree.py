"""The octree map: (7), (8) against a plain loop over voxels, OctoMap itself, and its files read by
plain recursion."""

import itertools
import math
from collections import defaultdict

import numpy as np
import pyoctomap
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.exporting.octomap_files import write_octree
from fusion_core.mapping.octree import OctreeBuilder, OctreeSettings
from fusion_core.mapping.octree_nodes import boxes_of, leaves_of, prune
from fusion_core.model.errors import ExportError, MappingFailed, RecordingError, VolumeTooLarge
from fusion_core.model.octree import NODE_TYPE, OccupancyOctree
from fusion_core.recordings.octree_file import read_octree
from fusion_core.workflows.map.octree_boxes import octree_boxes
from tests.mapping.octomap_reader import read_bt, read_ot

RESOLUTION_M = 0.25
# Beyond all points.
FAR_M = 50.0


def clouds(seed, count=4, points=40):
    """Clouds on a bent wall with noise, each seen from its own place, in 32-bit coordinates, which
    is what OctoMap computes with."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        origin_m = random.uniform(-1.0, 1.0, 3)
        angle = random.uniform(-1.2, 1.2, points)
        points_m = np.column_stack(
            [2.5 * np.cos(angle), 3.0 * np.sin(angle), random.normal(size=points)]
        )
        points_m += random.normal(scale=0.05, size=(points, 3))
        yield (
            points_m.astype(np.float32).astype(np.float64),
            origin_m.astype(np.float32).astype(np.float64),
        )


def build(seed, settings=None, **kwargs):
    builder = OctreeBuilder(settings or OctreeSettings(resolution_m=RESOLUTION_M))
    for points_m, origin_m in clouds(seed, **kwargs):
        builder.add(points_m, origin_m)
    return builder.build()


def cells_on_ray(start_m, end_m, resolution_m):
    """The cells that a segment enters, without that of its end, by sorting all its crossings of
    cell borders."""
    start, end = start_m / resolution_m, end_m / resolution_m
    crossings = {0.0, 1.0}
    for axis in range(3):
        low, high = sorted((start[axis], end[axis]))
        for border in range(math.ceil(low), math.floor(high) + 1):
            if end[axis] != start[axis]:
                crossings.add((border - start[axis]) / (end[axis] - start[axis]))
    ordered = sorted(t for t in crossings if 0.0 <= t <= 1.0)
    cells = {
        tuple(np.floor(start + 0.5 * (before + after) * (end - start)).astype(int))
        for before, after in itertools.pairwise(ordered)
        if after - before > 1e-9
    }
    return cells - {tuple(np.floor(end).astype(int))}


def log_odds(p):
    return math.log(p / (1.0 - p))


def voxel_log_odds(seed, settings, **kwargs):
    """(7) and (8) for each voxel in a dictionary: one hit or one miss a cloud, clamped."""
    voxels = defaultdict(float)
    low, high = log_odds(settings.p_lowest), log_odds(settings.p_highest)
    for points_m, origin_m in clouds(seed, **kwargs):
        hit = {tuple(cell) for cell in np.floor(points_m / settings.resolution_m).astype(int)}
        passed = set()
        for cell in hit:
            centre_m = (np.array(cell) + 0.5) * settings.resolution_m
            passed |= cells_on_ray(origin_m, centre_m, settings.resolution_m)
        for cells, step in ((passed - hit, settings.p_miss), (hit, settings.p_hit)):
            for cell in cells:
                voxels[cell] = min(max(voxels[cell] + log_odds(step), low), high)
    return voxels


@pytest.mark.parametrize("range_max_m", [1.0, 2.0, 2.6])
def test_far_points_free_the_way_up_to_the_range(range_max_m):
    """By whole cells along an axis, where nobody can differ about a ray."""
    settings = OctreeSettings(resolution_m=RESOLUTION_M, range_max_m=range_max_m)
    origin_m = np.array([0.125, 0.125, 0.125])
    ends_m = origin_m + np.array(
        [[0.0, 0.0, 0.75], [0.0, 2.5, 0.0], [40.0, 0.0, 0.0], [-1e30, 0, 0]]
    )
    builder = OctreeBuilder(settings)
    builder.add(ends_m, origin_m)
    cells = expanded(as_dictionary(leaves_of(builder.build())))
    assert cells[0, 0, 3] > 0.0
    assert [cell for cell, value in cells.items() if value > 0.0 and cell != (0, 0, 3)] == (
        [(0, 10, 0)] if range_max_m > 2.5 else []
    )
    for axis, sign in ((0, 1), (0, -1), *(((1, 1),) if range_max_m < 2.0 else ())):
        passed = sorted(sign * cell[axis] for cell in cells if cell[axis] * sign > 0)
        # Every cell up to the range, and no more than a cell's diagonal beyond it.
        assert passed == list(range(1, len(passed) + 1))
        assert range_max_m - RESOLUTION_M <= len(passed) * RESOLUTION_M
        assert len(passed) * RESOLUTION_M <= range_max_m + 2.0 * RESOLUTION_M


@pytest.mark.parametrize("seed", range(3))
def test_hits_within_range_do_not_depend_on_what_is_beyond(seed):
    settings = OctreeSettings(resolution_m=RESOLUTION_M, range_max_m=2.5)
    found, expected = OctreeBuilder(settings), OctreeBuilder(settings)
    for points_m, origin_m in clouds(seed):
        found.add(points_m, origin_m)
        expected.add(points_m[np.linalg.norm(points_m - origin_m, axis=1) <= 2.5], origin_m)
    found, expected = leaves_of(found.build()), leaves_of(expected.build())
    hit = {
        cell
        for cell, value in expanded(as_dictionary(expected)).items()
        if value == expected.log_odds.max()
    }
    cells = expanded(as_dictionary(found))
    assert hit
    assert len(cells) > len(expanded(as_dictionary(expected)))
    assert np.mean([cells[cell] > 0.0 for cell in hit]) > 0.8


def expanded(leaves):
    """Each finest cell's value."""
    cells = {}
    for (x, y, z, side), value in leaves.items():
        for dx in range(side):
            for dy in range(side):
                for dz in range(side):
                    cells[x + dx, y + dy, z + dz] = value
    return cells


def as_dictionary(leaves):
    return {
        (*corner, side): value
        for corner, side, value in zip(
            map(tuple, leaves.corners.tolist()),
            leaves.sides.tolist(),
            leaves.log_odds.tolist(),
            strict=True,
        )
    }


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "changes", [{}, {"p_hit": 0.9, "p_miss": 0.2, "p_lowest": 0.3, "p_highest": 0.8}]
)
def test_seven_and_eight_for_each_voxel(seed, changes):
    settings = OctreeSettings(resolution_m=RESOLUTION_M, range_max_m=FAR_M, **changes)
    found = expanded(as_dictionary(leaves_of(build(seed, settings, count=6))))
    expected = voxel_log_odds(seed, settings, count=6)
    # A ray through an edge between cells may go either way; there are few.
    differing = found.keys() ^ expected.keys()
    assert len(differing) <= 0.01 * len(expected)
    both = sorted(found.keys() & expected.keys())
    wrong = [c for c in both if not math.isclose(found[c], expected[c], abs_tol=1e-5)]
    assert len(wrong) <= 0.01 * len(expected)
    values = np.array([expected[cell] for cell in both])
    assert values.max() > 0.0 > values.min()
    # The clamping is at work.
    ends = np.array([log_odds(settings.p_lowest), log_odds(settings.p_highest)])
    if changes:
        assert (np.abs(values[:, np.newaxis] - ends) < 1e-9).any(axis=0).all()


@pytest.mark.parametrize("resolution_m", [0.1, 0.25])
def test_the_same_nodes_as_octomaps_own_insertion(resolution_m, tmp_path):
    octree = build(5, OctreeSettings(resolution_m=resolution_m, range_max_m=FAR_M), points=400)
    tree = pyoctomap.OcTree(resolution_m)
    for points_m, origin_m in clouds(5, points=400):
        tree.insertPointCloud(points_m, origin_m, discretize=True)
    write_octree(tmp_path / "octree.ot", octree)
    assert (tmp_path / "octree.ot").read_bytes() == tree.write()
    write_octree(tmp_path / "octree.bt", octree)
    assert (tmp_path / "octree.bt").read_bytes() == tree.writeBinary()


def test_the_files_hold_the_same_leaves(tmp_path):
    octree = build(7, points=300)
    own = as_dictionary(leaves_of(octree))
    write_octree(tmp_path / "octree.ot", octree)
    resolution_m, leaves = read_ot((tmp_path / "octree.ot").read_bytes())
    assert resolution_m == RESOLUTION_M
    assert leaves == own
    again = read_octree(tmp_path / "octree.ot")
    assert again.resolution_m == RESOLUTION_M
    assert np.array_equal(again.nodes, octree.nodes)
    write_octree(tmp_path / "octree.bt", octree)
    resolution_m, states = read_bt((tmp_path / "octree.bt").read_bytes())
    assert resolution_m == RESOLUTION_M
    occupied = {cell: float(value >= 0.0) for cell, value in expanded(own).items()}
    assert expanded(states) == occupied
    with pytest.raises(ExportError, match="format"):
        write_octree(tmp_path / "octree.ply", octree)


def test_another_binding_reads_the_same_leaves(tmp_path):
    octomap = pytest.importorskip("octomap", reason="octomap-python is not installed")
    octree = build(8, points=300)
    for suffix in (".ot", ".bt"):
        write_octree(tmp_path / f"octree{suffix}", octree)
    full = octomap.OcTree.read(bytes(tmp_path / "octree.ot"))
    found = {}
    for leaf in full.begin_leafs():
        side = round(leaf.getSize() / RESOLUTION_M)
        corner = np.rint(np.array(leaf.getCoordinate()) / RESOLUTION_M - 0.5 * side).astype(int)
        found[(*corner.tolist(), side)] = leaf.getValue()
    assert {box: np.float32(value) for box, value in found.items()} == as_dictionary(
        leaves_of(octree)
    )
    binary = octomap.OcTree(RESOLUTION_M)
    assert binary.readBinary(bytes(tmp_path / "octree.bt"))
    found = {}
    for leaf in binary.begin_leafs():
        side = round(leaf.getSize() / RESOLUTION_M)
        corner = np.rint(np.array(leaf.getCoordinate()) / RESOLUTION_M - 0.5 * side).astype(int)
        found[(*corner.tolist(), side)] = float(leaf.getValue() >= 0.0)
    assert found == read_bt((tmp_path / "octree.bt").read_bytes())[1]


@given(seed=st.integers(0, 99))
def test_the_order_of_points_does_not_matter(seed):
    random = np.random.default_rng(seed)
    one = OctreeBuilder(OctreeSettings(resolution_m=RESOLUTION_M))
    other = OctreeBuilder(OctreeSettings(resolution_m=RESOLUTION_M))
    for points_m, origin_m in clouds(seed, count=2, points=20):
        one.add(points_m, origin_m)
        other.add(random.permutation(np.vstack([points_m, points_m[:5]])), origin_m)
    assert np.array_equal(one.build().nodes, other.build().nodes)


@given(seed=st.integers(0, 99), shift=st.tuples(*[st.integers(-40, 40)] * 3))
def test_a_map_moved_by_whole_cells(seed, shift):
    """Coordinates are multiples of a power of two, so that moving them is exact."""
    step = 2.0**-6
    moved_m = np.array(shift) * RESOLUTION_M
    one = OctreeBuilder(OctreeSettings(resolution_m=RESOLUTION_M))
    other = OctreeBuilder(OctreeSettings(resolution_m=RESOLUTION_M))
    for points_m, origin_m in clouds(seed, count=2, points=10):
        points_m, origin_m = np.rint(points_m / step) * step, np.rint(origin_m / step) * step
        # Off the borders, where a ray may go either way.
        origin_m += step / 3.0
        one.add(points_m, origin_m)
        other.add(points_m + moved_m, origin_m + moved_m)
    found = expanded(as_dictionary(leaves_of(other.build())))
    expected = {
        tuple(np.add(cell, shift)): value
        for cell, value in expanded(as_dictionary(leaves_of(one.build()))).items()
    }
    assert len(found.keys() ^ expected.keys()) <= 0.02 * len(expected)


@pytest.mark.parametrize("depth", [16, 15, 14, 10, 1, 0])
def test_leaves_cut_to_a_depth(depth):
    octree = build(9, points=200)
    cut = leaves_of(octree, depth)
    assert (cut.sides >= 1 << (16 - depth)).all()
    inside = defaultdict(list)
    boxes = sorted(as_dictionary(cut))
    for cell, value in expanded(as_dictionary(leaves_of(octree))).items():
        for x, y, z, side in boxes:
            if x <= cell[0] < x + side and y <= cell[1] < y + side and z <= cell[2] < z + side:
                inside[x, y, z, side].append(value)
                break
        else:
            raise AssertionError("a cell lies in no box")
    assert {box: max(values) for box, values in inside.items()} == as_dictionary(cut)


def test_boxes_for_display_are_few_enough(tmp_path):
    octree = build(9, points=200)
    boxes, depth = boxes_of(octree)
    occupied = leaves_of(octree).occupied
    assert (len(boxes), depth) == (occupied.sum(), 16)
    assert np.allclose(boxes.sides_m, RESOLUTION_M * boxes.sides)
    half_m = 0.5 * boxes.sides_m[:, np.newaxis]
    assert np.allclose(boxes.centres_in_map_m - half_m, RESOLUTION_M * boxes.corners)
    few, depth = boxes_of(octree, boxes_max=40)
    assert 0 < len(few) <= 40
    assert depth < 16
    assert len(boxes_of(octree, depth + 1)[0]) > 40
    write_octree(tmp_path / "octree.ot", octree)
    shown = octree_boxes(read_octree(tmp_path / "octree.ot"), 16, boxes_max=40)
    assert shown.depth == depth
    assert shown.finest_side_m == RESOLUTION_M * 2 ** (16 - depth)
    assert np.allclose(shown.centres_in_map_m, few.centres_in_map_m)
    assert np.allclose(shown.sides_m, few.sides_m)


def test_pruning_joins_alike_leaves_alone():
    def tree(last):
        leaves = [(-0.5, 0)] * 7 + [(last, 0)]
        return np.array([(0.0, 0b10), (0.0, 255), *leaves], dtype=NODE_TYPE)

    assert prune(tree(-0.5)).tolist() == [(-0.5, 0b10), (-0.5, 0)]
    kept = prune(tree(0.25))
    assert len(kept) == 10
    assert kept["log_odds"][:2].tolist() == [0.25, 0.25]
    assert len(prune(tree(0.25)[:0])) == 0


def test_what_is_no_octree_is_refused(tmp_path):
    octree = build(1)
    path = tmp_path / "octree.ot"
    write_octree(path, octree)
    good = path.read_bytes()
    start = good.index(b"data\n") + 5
    for bad in (
        b"",
        good[:-1],
        good + b"x",
        good.replace(b"res 0.25", b"res -1"),
        good.replace(b"res 0.25", b"res nan"),
        good.replace(b"id OcTree", b"id ColorOcTree"),
        good[:start] + bytes(len(good) - start),
        good[:start] + b"\xff" * (len(good) - start),
    ):
        path.write_bytes(bad)
        with pytest.raises(RecordingError, match="octree") as raised:
            octree_boxes(read_octree(path), 16)
        assert "\n" not in str(raised.value)
    with pytest.raises(RecordingError, match="can be read"):
        read_octree(tmp_path / "none.ot")
    with pytest.raises(ValueError, match="depth_max"):
        leaves_of(octree, 17)
    with pytest.raises(ValueError, match="nodes"):
        OccupancyOctree(resolution_m=0.1, nodes=np.zeros(3))


def test_nothing_too_much_and_too_far():
    builder = OctreeBuilder(OctreeSettings(nodes_max=1000))
    with pytest.raises(MappingFailed, match="no points"):
        builder.build()
    builder.add(np.empty((0, 3)), np.zeros(3))
    with pytest.raises(MappingFailed, match="no points"):
        builder.build()
    with pytest.raises(MappingFailed, match="too far"):
        builder.add(np.array([[1.0, 2.0, 1639.0]]), np.array([1.0, 2.0, 1638.0]))
    with pytest.raises(MappingFailed, match="too far"):
        builder.add(np.zeros((1, 3)), np.array([1e9, 0.0, 0.0]))
    with pytest.raises(VolumeTooLarge, match="1000 nodes"):
        builder.add(np.random.default_rng(0).normal(size=(50, 3)), np.zeros(3))
    for points_m in (np.zeros(3), np.full((1, 3), np.nan)):
        with pytest.raises(ValueError, match="points_in_map_m"):
            builder.add(points_m, np.zeros(3))
