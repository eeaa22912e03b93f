"""Outlines of solids: against a raster of the same solids, and against known worlds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.simulation import arena, buildings, worlds
from fusion_core.simulation.obstacle_outlines import obstacle_outlines, outer_wall_edges
from fusion_core.simulation.paths import WeavingPath
from fusion_core.simulation.solids import Material, Opening, SolidObject, make_object

SIZE = (4.0, 3.0)
CELL = 0.25


def length_m(outline) -> float:
    return float(np.linalg.norm(np.diff(outline, axis=0), axis=1).sum())


def block(x0, y0, x1, y1, z=(0.0, 1.0), name="block") -> SolidObject:
    return make_object(name, [((x0, y0, z[0]), (x1, y1, z[1]), Material.WOOD)])


def raster_border_m(footprints) -> float:
    """Sides of free cells inside the room at which a taken cell or the room's wall begins."""
    columns, rows = round(SIZE[0] / CELL), round(SIZE[1] / CELL)
    taken = np.ones((rows + 2, columns + 2), dtype=bool)
    taken[1:-1, 1:-1] = False
    for x0, y0, x1, y1 in footprints:
        taken[
            1 + round(y0 / CELL) : 1 + round(y1 / CELL), 1 + round(x0 / CELL) : 1 + round(x1 / CELL)
        ] = True
    changes = (taken[1:] != taken[:-1]).sum() + (taken[:, 1:] != taken[:, :-1]).sum()
    return float(changes) * CELL


cells_x = st.tuples(st.integers(0, 15), st.integers(1, 6))
cells_y = st.tuples(st.integers(0, 11), st.integers(1, 6))


@given(st.lists(st.tuples(cells_x, cells_y), min_size=1, max_size=6), st.booleans())
def test_the_outlines_border_the_free_floor(drawn, as_one):
    """Overlapping, touching and nested boxes, as things of their own or as parts of one."""
    footprints = [
        (x * CELL, y * CELL, min(x + w, 16) * CELL, min(y + h, 12) * CELL)
        for (x, w), (y, h) in drawn
    ]
    if as_one:
        blocks = [((x0, y0, 0.0), (x1, y1, 1.0), Material.WOOD) for x0, y0, x1, y1 in footprints]
        pieces = [make_object("block", blocks)]
    else:
        pieces = [block(*footprint) for footprint in footprints]
    found = obstacle_outlines(outer_wall_edges(SIZE, ((),) * 4, 2.6), pieces, SIZE)
    total = sum(length_m(obstacle.outline_m) for obstacle in found)
    assert total == pytest.approx(raster_border_m(footprints), abs=1e-6)
    assert len({obstacle.name for obstacle in found}) == len(found)


def test_only_obstacles_below_the_robots_height_count():
    shelf = block(1, 1, 2, 2, z=(0.55, 0.8), name="shelf")
    mat = block(2.5, 1, 3, 2, z=(0.0, 0.01), name="mat")
    bench = block(1, 2.2, 2, 2.6, z=(0.3, 0.5), name="bench")
    found = {s.name: s for s in obstacle_outlines({}, [shelf, mat, bench], SIZE)}
    assert found.keys() == {"bench"}
    assert (found["bench"].z_min_m, found["bench"].z_max_m) == (0.3, 0.5)
    outline = found["bench"].outline_m
    np.testing.assert_array_equal(outline[0], outline[-1])
    assert outline.shape == (5, 2)


def test_legs_are_separate_parts_and_rotation_keeps_lengths():
    legs = [((x, 1.0, 0.0), (x + 0.05, 1.05, 0.7), Material.WOOD) for x in (1.0, 2.0)]
    top = ((1.0, 1.0, 0.7), (2.05, 1.05, 0.75), Material.WOOD)
    table = make_object("table", [*legs, top])
    for thing in (table, table.rotated(0.4)):
        found = obstacle_outlines({}, [thing], SIZE)
        assert [s.name for s in found] == ["table, part 1", "table, part 2"]
        assert [length_m(s.outline_m) for s in found] == pytest.approx([0.2, 0.2])


def test_doors_are_open_and_panes_and_sills_are_not():
    openings = (
        (Opening(1.0, 2.0, 0.0, 2.0),),
        (Opening(1.0, 2.0, 0.0, 2.0, glazed=True),),
        (Opening(1.0, 2.0, 0.9, 2.0),),
        (Opening(1.0, 2.0, 0.0, 0.5),),
    )
    walls = outer_wall_edges(SIZE, openings, 2.6)
    lengths = {
        name: sum(np.linalg.norm(edge.b - edge.a) for edge in edges)
        for name, edges in walls.items()
    }
    assert lengths == pytest.approx(
        {"south wall": 3.0, "east wall": 3.0, "north wall": 4.0, "west wall": 3.0}
    )


def test_the_arena_is_the_papers():
    """Its size, and which object is in the way: B's bar is not, A's is."""
    world = arena.arena(1)
    assert world.size_m == (5.6, 3.18)
    named = {obstacle.name: obstacle for obstacle in world.obstacles}
    assert (named["A"].z_min_m, named["A"].z_max_m) == (0.0, 0.47)
    assert length_m(named["A"].outline_m) == pytest.approx(2 * (0.8 + 0.05))
    assert "B" not in named
    for part in ("B, part 1", "B, part 2"):
        assert length_m(named[part].outline_m) == pytest.approx(0.2)
    # C touches the wall, which has no outline there.
    assert length_m(named["C"].outline_m) == pytest.approx(0.4 + 2 * 0.35)
    assert named["D"].z_max_m < 0.3 < named["C"].z_max_m
    assert [line.length_m for line in world.lines] == pytest.approx([3.18, 5.6, 2.83])
    assert [np.degrees(angle.angle_rad) for angle in world.angles] == pytest.approx([90.0, 90.0])


@pytest.mark.parametrize(
    ("make", "way_m"),
    [(arena.arena, 9.0), (buildings.two_room_loop, 20.0), (buildings.whole_floor, 100.0)],
)
@pytest.mark.parametrize("seed", [1, 3, 8])
def test_a_turtlebot_touches_nothing(make, way_m, seed):
    """Its radius is 0.18 m. A metre between points of an outline is a centimetre here."""
    world = make(seed)
    path = WeavingPath(world.route_m, speed_m_s=0.5, start=0.0, weave_m=0.05)
    assert path.length_m > way_m
    at = np.array([path.pose(t)[:2] for t in np.arange(0.0, path.length_m / 0.5, 0.2)])
    for obstacle in world.obstacles:
        for a, b in zip(obstacle.outline_m, obstacle.outline_m[1:], strict=False):
            fraction = np.clip((at - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            gaps = np.linalg.norm(at - a - fraction[:, None] * (b - a), axis=1)
            assert gaps.min() > 0.25, obstacle.name


def test_the_floor_has_six_rooms_and_the_route_visits_each():
    world = buildings.whole_floor(3)
    for x in (3.0, 9.0, 15.0):
        for low, high in ((1.0, 4.5), (7.9, 11.4)):
            inside = (np.abs(world.route_m[:, 0] - x) < 2.5) & (world.route_m[:, 1] > low)
            assert (inside & (world.route_m[:, 1] < high)).sum() > 20
    assert sum(obstacle.name.startswith("cabinet") for obstacle in world.obstacles) >= 12


def test_an_open_door_shows_the_yard_and_a_pane_does_not():
    names = {s.name for s in worlds.open_corridor(2).obstacles}
    assert "yard" in names
    assert "yard" not in {s.name for s in worlds.furnished_room(2).obstacles}
