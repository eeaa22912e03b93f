"""Which returns other scans confirm: against loops, on walls in closed form, at any motion."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fusion_core.mapping.confirmation import PlacedScan, confirmed_fraction
from fusion_core.model.sensors import LaserScan

BEAMS = 240
STEP_RAD = np.deg2rad(1.0)
FIRST_RAD = np.deg2rad(-120.0)


def placed(pose, ranges_m, *, clockwise=False):
    """A scan of 240 degrees; clockwise scanners begin on the left."""
    sign = -1.0 if clockwise else 1.0
    return PlacedScan(
        pose=np.array(pose, dtype=np.float64),
        scan=LaserScan(
            stamp_ns=0,
            received_ns=None,
            frame_id="lidar",
            angle_min_rad=sign * FIRST_RAD,
            angle_increment_rad=sign * STEP_RAD,
            range_min_m=0.05,
            range_max_m=30.0,
            ranges_m=np.array(ranges_m, dtype=np.float64),
        ),
    )


def in_round_room(pose, radius_m=4.0, *, clockwise=False):
    """Exact ranges in a round room about the origin."""
    x, y, yaw = pose
    sign = -1.0 if clockwise else 1.0
    azimuth = yaw + sign * (FIRST_RAD + STEP_RAD * np.arange(BEAMS))
    along = x * np.cos(azimuth) + y * np.sin(azimuth)
    ranges_m = -along + np.sqrt(along**2 - (x * x + y * y) + radius_m**2)
    return placed(pose, ranges_m, clockwise=clockwise)


POSES = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-4.0, 4.0))


@given(POSES, POSES, st.booleans(), st.booleans())
@settings(max_examples=60)
def test_in_a_round_room_every_return_in_both_views_is_confirmed(one, other, left, right):
    """Whatever the motion and the direction of the scanners; the spots are 9 cm wide."""
    first, second = (
        in_round_room(one, clockwise=left),
        in_round_room(other, clockwise=right),
    )
    fraction = confirmed_fraction(first, [second], np.full(BEAMS, 0.1))
    angles = first.scan.angles_rad + first.pose[2]
    ends = first.pose[:2] + first.scan.ranges_m[:, None] * np.stack(
        [np.cos(angles), np.sin(angles)], axis=1
    )
    ahead = np.arctan2(ends[:, 1] - other[1], ends[:, 0] - other[0]) - other[2]
    off_rad = np.abs(np.angle(np.exp(1j * ahead)))
    # Beyond the last beam's half width there is no beam.
    assert (fraction[off_rad < np.deg2rad(118.0)] == 1.0).all()
    assert (fraction[off_rad > np.deg2rad(122.0)] == 0.0).all()


@given(seed=st.integers(0, 10_000), count=st.integers(1, 3))
@settings(max_examples=20)
def test_the_fraction_equals_a_loop_over_returns_and_scans(seed, count):
    rng = np.random.default_rng(seed)

    def random_scan():
        ranges_m = rng.choice([1.0, 1.05, 2.0, np.nan], BEAMS)
        return placed(rng.normal(0.0, 0.02, 3), ranges_m)

    own, others = random_scan(), [random_scan() for _ in range(count)]
    tolerance_m = rng.uniform(0.02, 0.2, BEAMS)
    fraction = confirmed_fraction(own, others, tolerance_m)
    for i in range(0, BEAMS, 7):
        range_m, azimuth = own.scan.ranges_m[i], own.scan.angles_rad[i] + own.pose[2]
        if np.isnan(range_m):
            assert fraction[i] == 0.0
            continue
        end = own.pose[:2] + range_m * np.array([np.cos(azimuth), np.sin(azimuth)])
        looked = agreeing = 0
        for other in others:
            to_end = end - other.pose[:2]
            turned = np.arctan2(to_end[1], to_end[0]) - other.pose[2]
            off_rad = np.abs(np.angle(np.exp(1j * (other.scan.angles_rad - turned))))
            nearest = int(np.argmin(off_rad))
            if off_rad[nearest] > 0.5 * STEP_RAD:
                continue
            for beam in (nearest - 1, nearest, nearest + 1):
                if 0 <= beam < BEAMS:
                    looked += 1
                    off_m = abs(other.scan.ranges_m[beam] - np.linalg.norm(to_end))
                    agreeing += bool(off_m <= tolerance_m[i])
        assert fraction[i] == (agreeing / looked if looked else 0.0)


def test_a_return_that_is_in_one_scan_alone_is_not_confirmed():
    room = in_round_room((0.0, 0.0, 0.0))
    ranges_m = room.scan.ranges_m.copy()
    ranges_m[100], ranges_m[150] = 2.0, 6.0
    later = in_round_room((0.1, 0.05, 0.2))
    fraction = confirmed_fraction(
        placed((0.0, 0.0, 0.0), ranges_m), [later, later], np.full(BEAMS, 0.1)
    )
    assert fraction[100] == fraction[150] == 0.0
    assert np.delete(fraction, [100, 150])[20:-20].min() == 1.0
