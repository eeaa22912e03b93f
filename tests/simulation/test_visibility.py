"""What sensors could see: against a loop over samples and walls, in the plane."""

import numpy as np
import pytest

from fusion_core.model.geometry import transform_from_planar
from fusion_core.simulation import sensor_mounts
from fusion_core.simulation.obstacle_outlines import obstacle_outlines, outer_wall_edges
from fusion_core.simulation.sensor_simulator import SimulationSetup
from fusion_core.simulation.solids import Material, box, make_object
from fusion_core.simulation.visibility import VisibilityTracker
from fusion_core.simulation.worlds import World

SIZE = (6.0, 4.0)
POSE = np.array([1.5, 1.8, 0.3])


def world_of(plain_room, pieces) -> World:
    room = plain_room([p.mesh for p in pieces])
    walls = outer_wall_edges(SIZE, ((),) * 4, 2.5)
    return World(
        size_m=SIZE,
        mesh=room.mesh,
        blocks_m=room.blocks_m,
        route_m=room.route_m,
        obstacles=obstacle_outlines(walls, pieces, SIZE),
    )


def thing(name, lower, upper, material=Material.WOOD):
    return make_object(name, [(lower, upper, material)])


def tracker(plain_room, standing, pieces, mounts) -> VisibilityTracker:
    world = world_of(plain_room, pieces)
    return VisibilityTracker(
        SimulationSetup(world=world, mounts=mounts, path=standing(*POSE), seed=1)
    )


def hidden(eye, target, boxes) -> bool:
    """Whether the straight line passes through any rectangle (slabs, one by one)."""
    for x0, y0, x1, y1 in boxes:
        enter, leave = 0.0, 1.0 - 1e-3
        for low, high, e, t in ((x0, x1, eye[0], target[0]), (y0, y1, eye[1], target[1])):
            if abs(t - e) < 1e-12:
                if not low < e < high:
                    enter, leave = 1.0, 0.0
                continue
            first, second = sorted(((low - e) / (t - e), (high - e) / (t - e)))
            enter, leave = max(enter, first), min(leave, second)
        if enter < leave:
            return True
    return False


def test_the_lidar_sees_what_no_box_hides(plain_room, standing):
    boxes = [(3.0, 1.0, 3.4, 1.6), (2.5, 2.6, 3.3, 3.0), (4.5, 2.0, 4.8, 2.9)]
    pieces = [thing(f"box {i}", (b[0], b[1], 0), (b[2], b[3], 0.5)) for i, b in enumerate(boxes)]
    seen = tracker(plain_room, standing, pieces, sensor_mounts.turtlebot2())
    seen.add_sweep(transform_from_planar(POSE), 0.0)
    differing = total = 0
    for obstacle in seen.outline().obstacles:
        expected = [not hidden(POSE[:2], sample, boxes) for sample in obstacle.samples_m()]
        differing += (obstacle.seen_samples("lidar") != np.array(expected)).sum()
        total += obstacle.sample_count
        assert not obstacle.seen_samples("camera").any()
    # At the edge of a shadow a centimetre may fall to either side.
    assert total > 2000
    assert differing <= 12


def test_each_sensor_has_its_heights(plain_room, standing):
    """Ahead of the robot are a low box, a bench over the LiDAR's plane, and a post."""
    pieces = [
        thing("low", (3.4, 2.5, 0.0), (3.6, 2.7, 0.2)),
        thing("bench", (3.4, 1.9, 0.4), (3.6, 2.2, 0.5)),
        thing("post", (3.4, 3.0, 0.0), (3.6, 3.1, 0.5)),
    ]
    seen = tracker(plain_room, standing, pieces, sensor_mounts.turtlebot2())
    seen.add_sweep(transform_from_planar(POSE), 0.0)
    seen.add_image(0, transform_from_planar(POSE), 0.0)
    fractions = {
        obstacle.name: (
            obstacle.seen_samples("lidar").mean(),
            obstacle.seen_samples("camera").mean(),
        )
        for obstacle in seen.outline().obstacles
    }
    for name in ("low", "bench"):
        assert fractions[name][0] == 0.0
        assert fractions[name][1] > 0.2
    assert min(fractions["post"]) > 0.2
    # Behind the robot.
    assert fractions["west wall"][0] == 1.0
    assert fractions["west wall"][1] == 0.0


def test_a_camera_sees_between_its_distances_and_borders(plain_room, standing):
    mounts = sensor_mounts.turtlebot2()
    seen = tracker(plain_room, standing, [], mounts)
    seen.add_image(0, transform_from_planar(POSE), 0.0)
    half = np.radians(29.2)
    checked = 0
    for obstacle in seen.outline().obstacles:
        bearing = np.arctan2(*(obstacle.samples_m() - POSE[:2] - 0.08).T[::-1])
        for visible, sample in zip(
            obstacle.seen_samples("camera"), obstacle.samples_m(), strict=True
        ):
            eye = POSE[:2] + 0.08 * np.array([np.cos(POSE[2]), np.sin(POSE[2])])
            off = np.arctan2(*(sample - eye)[::-1]) - POSE[2]
            off = abs((off + np.pi) % (2 * np.pi) - np.pi)
            # Rows beside the middle one are wider by the tilt.
            if off < half - 0.01:
                assert visible
                checked += 1
            elif off > half + 0.1:
                assert not visible
                checked += 1
        assert bearing.size == obstacle.sample_count
    assert checked > 1500
    near = tracker(plain_room, standing, [], mounts)
    near.add_image(0, transform_from_planar(np.array([5.6, 2.0, 0.0])), 0.0)
    assert not any(o.seen_samples("camera").any() for o in near.outline().obstacles)


def test_the_lidar_sees_a_pane_only_near_normal_incidence(plain_room, standing):
    pane = thing("pane", (4.0, 0.5, 0.0), (4.01, 3.5, 1.0), Material.GLASS)
    seen = tracker(plain_room, standing, [pane], sensor_mounts.turtlebot2())
    for number in (0, 1):
        seen.add_sweep(transform_from_planar(POSE), float(number))
        seen.add_image(0, transform_from_planar(POSE), float(number))
    (glass,) = [o for o in seen.outline().obstacles if o.name == "pane"]
    shown = glass.samples_m()[glass.seen_samples("lidar")]
    np.testing.assert_allclose(shown[:, 0], 4.0)
    reach = 2.5 * np.tan(0.14)
    assert shown[:, 1].min() == pytest.approx(POSE[1] - reach, abs=0.011)
    assert shown[:, 1].max() == pytest.approx(POSE[1] + reach, abs=0.011)
    assert not glass.seen_samples("camera").any()


def test_a_world_without_outlines_has_none_visible(plain_room, standing):
    room = plain_room([box((1, 1, 1), (2, 2, 2), Material.WOOD)])
    seen = VisibilityTracker(
        SimulationSetup(world=room, mounts=sensor_mounts.turtlebot2(), path=standing(*POSE), seed=1)
    )
    seen.add_sweep(transform_from_planar(POSE), 0.0)
    seen.add_image(0, transform_from_planar(POSE), 0.0)
    assert seen.outline().obstacles == ()
