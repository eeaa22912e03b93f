"""Loops of visual SLAM: closed, refused, and a lost camera found.

    OMP_NUM_THREADS=1 python -m tests.benchmarks.bench_visual_loops [CASE ...] [--seeds 1]

A camera of 320 x 240 pixels with the noise of a Kinect goes

* ``ring``: once round a corridor of 29 m and a little further, without loop closing and with it.
  The trajectory's error is the root mean square of the keyframes' places after rigid alignment; the
  gap is how far the last keyframe is from its true place relative to the first, which it has been
  near to before. Again with a fifth of the features (too few: it is lost in a corner and found
  again, so that no loop is left), with a lens that is 1 % longer than it is said to be, and with
  four times the noise of depth, and steps of depth as coarse. What chance adds to the steps between
  the ends no loop takes away: of a random walk closing at its ends leaves 0.58.
* ``course``: the same round a corridor of 101 m, as it is: long enough for drift to show.
* ``drift``: the same measures for a tracker that is imitated, without images, whose steps are all
  off by the same: 0.23 deg and 1 cm.
* ``rooms``: through a room, a corridor and a second room that is the same to the last pixel. A
  false loop joins keyframes of both; a true one those of one.
* ``lost``: twice round the ring; then the map of the first lap is asked where images of the second
  are, of which it knows nothing else. Images of another building must not be found.
* ``carried``: in the ring the lens is covered for 6 s while the camera is taken back by a quarter
  of the round; it must find itself in the same run.

CASE: by default each.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from fusion_core.model.conventions import NS_PER_S, FloatArray
from fusion_core.model.geometry import invert_transform
from fusion_core.model.rgbd_frame import RgbdFrame
from fusion_core.model.sensors import CameraIntrinsics
from fusion_core.slam.visual.features import FeatureExtractor, FeatureSettings
from fusion_core.slam.visual.frame_features import FrameFeatures
from fusion_core.slam.visual.loop_closing import LoopCloser, VisualLoopSettings
from fusion_core.slam.visual.observation_noise import ObservationNoise
from fusion_core.slam.visual.place_recognition import PlaceIndex
from fusion_core.slam.visual.relative_pose import RelativePoseSettings
from fusion_core.slam.visual.relocalisation import Relocalisation, relocalise
from fusion_core.slam.visual.visual_map import VisualMap
from fusion_core.slam.visual.visual_slam import VisualSlamResult, VisualSlamSettings, visual_slam
from tests.benchmarks.measures import show
from tests.benchmarks.visual_loop_worlds import (
    INTRINSICS,
    RATE_HZ,
    CameraRun,
    identical_rooms,
    ring_corridor,
    ring_path,
    rooms_path,
)
from tests.slam.visual import feature_world
from tests.slam.visual.feature_world import DriftingTracker, hall, round_trip

SIDE_M, WIDTH_M, STEP_M = 9.0, 1.8, 0.08
# Of ``course``, and how far it goes on after one round.
COURSE_SIDE_M, FURTHER_M = 27.0, 4.0
APART_M, ROOM_M = 6.0, 4.0
LENS_FACTOR = 1.01
_FOUND_WITHIN_M = 0.1


def main() -> None:
    cases: dict[str, Callable[[int], None]] = {
        "ring": _ring,
        "course": _course,
        "drift": _drift,
        "rooms": _rooms,
        "lost": _lost,
        "carried": _carried,
    }
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", choices=[*cases, []])
    parser.add_argument("--seeds", type=int, default=1)
    asked = parser.parse_args()
    for seed in range(1, asked.seeds + 1):
        for name in asked.cases or cases:
            cases[name](seed)


def _ring_run(seed: int, laps: float, side_m: float = SIDE_M) -> CameraRun:
    return CameraRun(
        ring_corridor(side_m, WIDTH_M, seed), ring_path(side_m, WIDTH_M, laps, STEP_M), seed
    )


def _ring(seed: int) -> None:
    run, title = _ring_run(seed, 1.15), f"Once round {4 * (SIDE_M - WIDTH_M):.0f} m, seed {seed}"
    _round(
        run,
        title,
        (
            ("as it is", 1.0, 1000),
            ("200 features", 1.0, 200),
            ("lens x 1.01", LENS_FACTOR, 1000),
        ),
    )
    _round(replace(run, noise=4.0), f"{title}, depth noise x 4", (("as it is", 1.0, 1000),))


def _course(seed: int) -> None:
    way_m = 4 * (COURSE_SIDE_M - WIDTH_M)
    _round(
        _ring_run(seed, 1.0 + FURTHER_M / way_m, COURSE_SIDE_M),
        f"Once round {way_m:.0f} m, seed {seed}",
        (("as it is", 1.0, 1000),),
    )


def _round(run: CameraRun, title: str, variants: Sequence[tuple[str, float, int]]) -> None:
    """Each variant: its name, the factor of the lens, its features."""
    frames = list(run.frames())
    rows = [_LOOP_COLUMNS]
    for name, factor, features in variants:
        told = replace(INTRINSICS, fx=INTRINSICS.fx / factor, fy=INTRINSICS.fy / factor)
        before, after = (_slam(frames, told, is_closed, features) for is_closed in (False, True))
        rows.append(
            _loop_row(
                name,
                *(_errors_m(*_keyframe_poses(run, result)) for result in (before, after)),
                after.visual_map,
            )
        )
    show(title, rows)


def _drift(seed: int) -> None:
    errors = []
    for is_closed in (False, True):
        tracker = DriftingTracker(hall(seed), seed, [0.0, 0.004, 0.0, 0.01, 0.0, 0.0])
        settings = VisualLoopSettings(loop_closing={"is_used": is_closed})
        closer = LoopCloser(tracker.map, feature_world.INTRINSICS, settings=settings)
        for pose in round_trip(count=60):
            closer.add(tracker.add(pose))
        closer.finish()
        kept = tracker.map.kept_keyframes
        truth = np.array([tracker.truth[keyframe.index] for keyframe in kept])
        errors.append(_errors_m(np.array([keyframe.T_map_camera for keyframe in kept]), truth))
    rows = [_LOOP_COLUMNS, _loop_row("imitated", *errors, tracker.map)]
    show(f"Drift that is injected, seed {seed}", rows)


_LOOP_COLUMNS = ("", "rms before", "after", "ratio", "gap before", "after", "ratio", "loops")


def _loop_row(
    name: str,
    before: tuple[float, float],
    after: tuple[float, float],
    visual_map: VisualMap,
) -> tuple[str, ...]:
    cells = [name]
    for was_m, is_m in zip(before, after, strict=True):
        cells += [f"{was_m:.3f} m", f"{is_m:.3f} m", f"{is_m / was_m:.2f}"]
    loops = [f"{loop.first}-{loop.second}" for loop in visual_map.loops]
    return (*cells, " ".join(loops))


def _rooms(seed: int) -> None:
    caster = identical_rooms(ROOM_M, APART_M, seed)
    run = CameraRun(caster, rooms_path(APART_M, STEP_M, np.deg2rad(4.0)), seed)
    result = _slam(list(run.frames()), INTRINSICS, True)
    keyframes = result.visual_map.keyframes
    x_m = np.array([run.T_world_camera[_frame_of(k.stamp_ns)][0, 3] for k in keyframes])
    joined = [(loop.first, loop.second) for loop in result.visual_map.loops]
    refused = [(loop.first, loop.second) for loop in result.refused_loops]
    is_false = {pair: abs(x_m[pair[0]] - x_m[pair[1]]) > 0.5 * APART_M for pair in joined + refused}
    rms, gap = _errors_m(*_keyframe_poses(run, result))
    show(
        f"Two identical rooms, seed {seed}",
        [
            ("", "joined", "refused"),
            *(
                (
                    name,
                    str(sum(is_false[pair] == of for pair in joined)),
                    str(sum(is_false[pair] == of for pair in refused)),
                )
                for name, of in (("true loops", False), ("false loops", True))
            ),
            ("error", f"{rms:.3f} m", f"gap {gap:.3f} m"),
        ],
    )
    for loop in result.refused_loops[-1:]:
        print(f"{loop.first}-{loop.second}, {loop.inliers} inliers: {loop.reason}")


def _lost(seed: int) -> None:
    run = _ring_run(seed, 2.0)
    count = len(run.T_world_camera) // 2
    result = _slam(run.frames(0, count), INTRINSICS, True)
    index = PlaceIndex()
    for keyframe in result.visual_map.keyframes:
        index.add(keyframe.index, keyframe.features.descriptors)
    rows = [("images of", "asked", "found", "median", "worst")]
    elsewhere = _ring_run(seed + 1000, 1.0)
    for name, other, first in (("the map", run, count), ("elsewhere", elsewhere, 0)):
        # Between the images that were mapped, to the side and turned.
        asked = other.moved(0.15, np.deg2rad(6.0))
        extract = FeatureExtractor(INTRINSICS, FeatureSettings()).extract
        errors = []
        numbers = range(first, first + count, 10)
        for number in numbers:
            frame = next(iter(asked.frames(number, number + 1)))
            found = _relocalised(result.visual_map, index, extract(frame))
            if isinstance(found, Relocalisation):
                T_world_map = run.T_world_camera[0]
                place_m = (T_world_map @ found.T_map_camera)[:3, 3]
                errors.append(float(np.linalg.norm(place_m - asked.T_world_camera[number][:3, 3])))
        near = sum(error < _FOUND_WITHIN_M for error in errors)
        median, worst = (
            (f"{v:.3f} m" for v in (np.median(errors), max(errors))) if errors else ("-", "-")
        )
        rows.append((name, str(len(numbers)), f"{len(errors)}, {near} within 0.1 m", median, worst))
    show(f"Started lost, seed {seed}", rows)


def _relocalised(
    visual_map: VisualMap, index: PlaceIndex, features: FrameFeatures
) -> Relocalisation | str:
    return relocalise(
        visual_map,
        index,
        features,
        INTRINSICS,
        ObservationNoise(),
        RelativePoseSettings(),
    )


def _carried(seed: int) -> None:
    run = _ring_run(seed, 0.75)
    count = len(run.T_world_camera)
    back = round(count / 3)
    covered = 6 * RATE_HZ
    path = [
        *run.T_world_camera,
        *np.repeat(run.T_world_camera[-1:], covered, axis=0),
        *run.T_world_camera[back : 2 * back],
    ]
    whole = CameraRun(run.caster, np.array(path), seed)
    frames = [
        replace(frame, gray=np.zeros_like(frame.gray), depth_m=np.full_like(frame.depth_m, np.nan))
        if count <= number < count + covered
        else frame
        for number, frame in enumerate(whole.frames())
    ]
    result = _slam(frames, INTRINSICS, True)
    after = count + covered
    found = np.flatnonzero(result.is_tracked[after:])
    errors = np.linalg.norm(
        (whole.T_world_camera[0] @ result.T_map_camera)[after:, :3, 3]
        - whole.T_world_camera[after:, :3, 3],
        axis=1,
    )
    waited = f"{found[0]} images" if found.size else "never"
    rms = float(np.sqrt(np.nanmean(errors**2))) if found.size else np.nan
    show(
        f"Covered for 6 s and carried back, seed {seed}",
        [
            ("images after", "with a pose", "first after", "rms", "worst"),
            (
                str(back),
                str(found.size),
                waited,
                f"{rms:.3f} m",
                f"{np.nanmax(errors):.3f} m" if found.size else "-",
            ),
        ],
    )
    for stretch in result.lost:
        print(f"lost: images {stretch.first} to {stretch.last}, {stretch.reason}")
    for jump in result.jumps:
        print(f"jump: {jump.step_m:.2f} m at {jump.first_stamp_ns / NS_PER_S:.2f} s")


def _slam(
    frames: Iterable[RgbdFrame],
    intrinsics: CameraIntrinsics,
    is_closed: bool,
    features_max: int = 1000,
) -> VisualSlamResult:
    settings = VisualSlamSettings(
        loop_closing={"is_used": is_closed}, features={"features_max": features_max}
    )
    return visual_slam(frames, intrinsics, settings)


def _frame_of(stamp_ns: int) -> int:
    return round(stamp_ns * RATE_HZ / NS_PER_S)


def _keyframe_poses(run: CameraRun, result: VisualSlamResult) -> tuple[FloatArray, FloatArray]:
    """(K, 4, 4) T_map_camera of the kept keyframes and their true T_world_camera."""
    kept = result.visual_map.kept_keyframes
    truth = run.T_world_camera[[_frame_of(keyframe.stamp_ns) for keyframe in kept]]
    return np.array([keyframe.T_map_camera for keyframe in kept]), truth


def _errors_m(T_map_camera: FloatArray, truth: FloatArray) -> tuple[float, float]:
    """Root mean square after rigid alignment, and the gap of the last where the first is true."""
    centred, true = (
        poses[:, :3, 3] - poses[:, :3, 3].mean(axis=0) for poses in (T_map_camera, truth)
    )
    R, _ = Rotation.align_vectors(true, centred)
    rms_m = float(np.sqrt(np.mean(np.sum((R.apply(centred) - true) ** 2, axis=1))))
    last = truth[0] @ invert_transform(T_map_camera[0]) @ T_map_camera[-1]
    return rms_m, float(np.linalg.norm(last[:3, 3] - truth[-1, :3, 3]))


if __name__ == "__main__":
    main()
