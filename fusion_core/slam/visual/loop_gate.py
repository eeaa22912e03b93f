"""Whether a loop is one that the odometry can have drifted to.

Two rooms that look alike give a pose with many inliers, whichever of them it is. What tells them
apart is the path between the visits: a true loop is off by no more than its drift.
"""

from collections.abc import Sequence

import numpy as np

from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.geometry import invert_transform
from fusion_core.settings import StageSettings, setting
from fusion_core.slam.visual.drift import (
    GATE_CHI2,
    DriftSettings,
    drift_covariance,
    shortest_path,
    small_motion_between,
)
from fusion_core.slam.visual.relative_pose import RelativePose
from fusion_core.slam.visual.visual_map import VisualMap


class LostMotionSettings(StageSettings):
    """How far a camera can get while it is lost."""

    speed_max_m_per_s: float = setting(
        1.5, "Greatest speed of a lost camera", unit="m/s", ge=1e-3, le=1e3
    )
    margin_m: float = setting(1.0, "Added to the distance at this speed", unit="m", ge=0.0, le=1e3)


def loop_refusal(
    visual_map: VisualMap,
    pairs: Sequence[tuple[int, int]],
    first: int,
    second: int,
    found: RelativePose,
    drift: DriftSettings,
    lost: LostMotionSettings,
) -> str | None:
    """Why the map cannot be off by as much as a loop says; None where it can.

    ``pairs``: the keyframes that are connected. Where none lead from one to the other, tracking was
    lost between them, and the time bounds how far the camera can have gone.
    """
    T_map_camera = np.array([visual_map.pose_of(i) for i in range(len(visual_map.keyframes))])
    path = shortest_path(T_map_camera, pairs, first, second, drift)
    if path is None:
        return _refusal_over_loss(visual_map, pairs, first, second, found, lost)
    T_predicted = invert_transform(T_map_camera[first]) @ T_map_camera[second]
    off = small_motion_between(found.T_first_second, T_predicted)
    covariance = drift_covariance(T_map_camera[path], drift) + found.covariance
    chi2 = float(off @ np.linalg.solve(covariance, off))
    if chi2 <= GATE_CHI2:
        return None
    return (
        f"the loop is off by {np.linalg.norm(off[3:]):.2f} m and "
        f"{np.degrees(np.linalg.norm(off[:3])):.1f} deg, more than the odometry can have drifted "
        f"between the two (chi-square {chi2:.0f} above {GATE_CHI2:g})"
    )


def _refusal_over_loss(
    visual_map: VisualMap,
    pairs: Sequence[tuple[int, int]],
    first: int,
    second: int,
    found: RelativePose,
    lost: LostMotionSettings,
) -> str | None:
    """Bounds the way from the last keyframe before the loss to the first one after it."""
    members = _connected_to(second, pairs)
    after = min(members)
    before = after - 1
    if before < 0 or before not in _connected_to(first, pairs):
        return None
    T_second_after = invert_transform(visual_map.pose_of(second)) @ visual_map.pose_of(after)
    T_first_after = found.T_first_second @ T_second_after
    T_first_before = invert_transform(visual_map.pose_of(first)) @ visual_map.pose_of(before)
    away_m = distance_m(T_first_before, T_first_after)
    keyframes = visual_map.keyframes
    reach_m = lost_reach_m(keyframes[after].stamp_ns - keyframes[before].stamp_ns, lost)
    if away_m <= reach_m:
        return None
    return (
        f"the loop has the lost camera move {away_m:.2f} m, more than the {reach_m:.2f} m that its "
        "time allows"
    )


def lost_reach_m(duration_ns: int, lost: LostMotionSettings) -> float:
    """How far a camera can have moved in a time."""
    return lost.margin_m + lost.speed_max_m_per_s * abs(duration_ns) / NS_PER_S


def distance_m(T_a_b: FloatArray, T_a_c: FloatArray) -> float:
    """Between the origins of b and c."""
    return float(np.linalg.norm(T_a_b[:3, 3] - T_a_c[:3, 3]))


def _connected_to(node: int, pairs: Sequence[tuple[int, int]]) -> set[int]:
    neighbours: dict[int, list[int]] = {}
    for a, b in pairs:
        neighbours.setdefault(a, []).append(b)
        neighbours.setdefault(b, []).append(a)
    reached, waiting = {node}, [node]
    while waiting:
        for other in neighbours.get(waiting.pop(), []):
            if other not in reached:
                reached.add(other)
                waiting.append(other)
    return reached
