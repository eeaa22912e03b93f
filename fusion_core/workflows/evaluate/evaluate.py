"""The measures of a result against the truth, a reference or relations, ready for JSON.

Where a truth has no mount of the camera, ``lever_arm_m`` gives its origin seen from the LiDAR's
(forward, left, up) and ``pitch_rad`` how far it looks down; ``clock_offset_ms`` is camera stamp -
LiDAR stamp of one instant. Values in the truth take precedence.

Each function raises ScanLoomError where a file is invalid or the two are of different recordings.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.alignment import evaluate_alignment
from fusion_core.evaluation.false_cells import evaluate_false_cells, true_views
from fusion_core.evaluation.fuse_folder import open_fuse_folder
from fusion_core.evaluation.map_measures import MapCells, evaluate_measures
from fusion_core.evaluation.map_outlines import evaluate_outlines
from fusion_core.evaluation.noise import evaluate_noise
from fusion_core.evaluation.recall_curve import recall_over_epsilon
from fusion_core.evaluation.relations import evaluate_relations
from fusion_core.evaluation.relative_pose import Step, StepUnit
from fusion_core.evaluation.repair import evaluate_repair
from fusion_core.evaluation.room_dimensions import DIMENSIONS, RoomSettings, measure_room
from fusion_core.evaluation.trajectories import MAX_GAP_S, Alignment, evaluate_trajectory
from fusion_core.evaluation.truth import LeverArm, Truth, load_truth
from fusion_core.exporting.manifest import require_intact
from fusion_core.exporting.settings_file import load_toml
from fusion_core.model.conventions import Float32Array
from fusion_core.model.errors import EvaluationFailed, SettingsError
from fusion_core.model.planar_poses import transform_planar_points
from fusion_core.model.recording import Recording
from fusion_core.model.sensors import DepthImage
from fusion_core.recordings.clouds.formats import read_cloud
from fusion_core.recordings.formats import open_recording
from fusion_core.recordings.relation_file import read_relations
from fusion_core.recordings.ros_map import read_ros_map
from fusion_core.recordings.tum_trajectory import read_tum_trajectory
from fusion_core.recordings.world_file import read_world
from fusion_core.workflows.evaluate.map_alignment import MapAlignment, align_map

# What the measures read of a folder that ``fuse`` has written.
_FUSE_RESULTS = ("alignment.json", "frames.csv", "samples.parquet")

EPSILON_OVER_E = np.linspace(0.2, 6.0, 30)
"""Fig. 6 of Xu 2024 shows [1, sqrt 2]; the rest shows what lies beside the band."""


def alignment(
    fuse_dir: Path,
    truth: Path,
    *,
    lever_arm_m: tuple[float, float, float] | None = None,
    pitch_rad: float = 0.0,
    clock_offset_ms: float | None = None,
) -> dict[str, Any]:
    """Offset of each frame, yaw of the mount and clock against the truth."""
    require_intact(fuse_dir, _FUSE_RESULTS, "fuse")
    known = _load_truth(truth, lever_arm_m, pitch_rad, clock_offset_ms)
    return evaluate_alignment(fuse_dir, known).to_json()


def noise(
    fuse_dir: Path,
    truth: Path,
    *,
    lever_arm_m: tuple[float, float, float] | None = None,
    pitch_rad: float = 0.0,
    clock_offset_ms: float | None = None,
) -> dict[str, Any]:
    """Recalls of good, noise and conflict pairs, and the curves of Fig. 6 (``over_epsilon``)."""
    require_intact(fuse_dir, _FUSE_RESULTS, "fuse")
    known = _load_truth(truth, lever_arm_m, pitch_rad, clock_offset_ms)
    curve = recall_over_epsilon(fuse_dir, known, EPSILON_OVER_E)
    return {**evaluate_noise(fuse_dir, known).to_json(), "over_epsilon": curve.to_json()}


def repair(
    fuse_dir: Path,
    truth: Path,
    *,
    lever_arm_m: tuple[float, float, float] | None = None,
    pitch_rad: float = 0.0,
    clock_offset_ms: float | None = None,
    recording: Path | None = None,
) -> dict[str, Any]:
    """Errors of repaired values against the truth and against plain interpolation.

    ``recording``, what was fused, adds the baselines that fill whole depth images.
    """
    require_intact(fuse_dir, _FUSE_RESULTS, "fuse")
    known = _load_truth(truth, lever_arm_m, pitch_rad, clock_offset_ms)
    if recording is None:
        return evaluate_repair(fuse_dir, known).to_json()
    with open_recording(recording) as opened:
        return evaluate_repair(fuse_dir, known, depth_images(opened)).to_json()


def trajectory(
    estimate: Path,
    reference: Path,
    *,
    alignment: Alignment = "se3",
    delta: float = 1.0,
    unit: StepUnit = "s",
    max_gap_s: float = MAX_GAP_S,
) -> dict[str, Any]:
    """Absolute and relative pose errors between two TUM files, by ``evaluate_trajectory``.

    ``delta`` and ``unit`` are the step of the relative errors.
    """
    step = Step(delta=delta, unit=unit)
    for file in (estimate, reference):
        require_intact(file.parent, (file.name,))
    own, true = read_tum_trajectory(estimate), read_tum_trajectory(reference)
    report = evaluate_trajectory(
        own.trajectory,
        true.trajectory,
        alignment=alignment,
        step=step,
        max_gap_s=max_gap_s,
    )
    return {**report.to_json(), "warnings": [*own.warnings, *true.warnings]}


def relations(trajectory: Path, relations: Path) -> dict[str, Any]:
    """Errors of a TUM file over relations, as Kümmerle and as Cartographer measure them."""
    require_intact(trajectory.parent, (trajectory.name,))
    own = read_tum_trajectory(trajectory)
    report = evaluate_relations(own.trajectory, read_relations(relations))
    return {**report.to_json(), "warnings": list(own.warnings)}


def ros_map(
    file: Path,
    world: Path,
    *,
    align: bool = True,
    pose: tuple[float, float, float] | None = None,
) -> dict[str, Any]:
    """Detection rate (10), line and angle errors (Table 4 of Li 2022) of a map.

    ``file`` is a map's YAML file, ``world`` the world file of its recording. ``pose``: (x, y, yaw)
    of the map's frame in the world; with ``align`` it is the initial guess, without it the pose
    that is used, the identity where it is None.
    """
    if pose is not None and not np.isfinite(pose).all():
        raise SettingsError(f"the pose must be finite, got {pose}.")
    require_intact(file.parent, (file.name, f"{file.stem}.pgm"))
    drawn, outline = read_ros_map(file), read_world(world)
    occupied_m, free_m = drawn.occupied_m(), drawn.free_m()
    pose_world_map = np.zeros(3) if pose is None else np.array(pose, dtype=np.float64)
    alignment: MapAlignment | None = None
    if align:
        alignment = align_map(occupied_m, outline, None if pose is None else pose_world_map)
        pose_world_map = alignment.pose_world_map
    cells = MapCells(
        occupied_m=transform_planar_points(pose_world_map, occupied_m),
        free_m=transform_planar_points(pose_world_map, free_m),
        resolution_m=drawn.resolution_m,
    )
    return {
        "resolution_m": drawn.resolution_m,
        "alignment": None if alignment is None else alignment.to_json(),
        **evaluate_outlines(cells, outline).to_json(),
        **evaluate_measures(cells, outline).to_json(),
    }


def room(
    cloud: Path,
    true_m: tuple[float, float, float] | None = None,
    settings_file: Path | None = None,
) -> dict[str, Any]:
    """Length, width and height of a box-shaped room from a cloud of it (Table 3 of Song 2022).

    ``true_m``: the same as they were measured otherwise, for the errors. ``settings_file``: TOML
    with a table ``room``.
    """
    settings = RoomSettings()
    if settings_file is not None:
        loaded = load_toml(settings_file, {"room": RoomSettings})["room"]
        assert isinstance(loaded, RoomSettings)
        settings = loaded
    if true_m is not None and not (np.isfinite(true_m).all() and min(true_m) > 0.0):
        raise SettingsError(f"the true dimensions must be positive, got {true_m}.")
    warnings: list[str] = []
    points = read_cloud(cloud, warnings)
    try:
        result = measure_room(points.xyz_m, settings).to_json()
    except EvaluationFailed as error:
        raise EvaluationFailed(error.problem, file=cloud, advice=error.advice) from error
    if true_m is not None:
        for name, true in zip(DIMENSIONS, true_m, strict=True):
            result[name] |= {"true_m": true, "error_m": result[name]["m"] - true}
    return {**result, "warnings": warnings}


def map_cells(
    file: Path, truth: Path, *, pose: tuple[float, float, float] | None = None
) -> dict[str, Any]:
    """Cells of a map of ``fuse`` that are free or occupied and are not so in truth.

    ``file`` is a map's YAML file in the folder that ``fuse`` wrote, ``truth`` the ground truth of
    its recording. ``pose`` (x, y, yaw) is where the map's frame lies in the truth's world; None is
    that world, as for a map of recorded true poses.
    """
    if pose is not None and not np.isfinite(pose).all():
        raise SettingsError(f"the pose must be finite, got {pose}.")
    require_intact(file.parent, (file.name, f"{file.stem}.pgm", "alignment.json"))
    drawn = read_ros_map(file)
    views = true_views(load_truth(truth), open_fuse_folder(file.parent))
    pose_world_map = np.zeros(3) if pose is None else np.array(pose, dtype=np.float64)
    cells = MapCells(
        occupied_m=transform_planar_points(pose_world_map, drawn.occupied_m()),
        free_m=transform_planar_points(pose_world_map, drawn.free_m()),
        resolution_m=drawn.resolution_m,
    )
    return {
        "resolution_m": drawn.resolution_m,
        **evaluate_false_cells(cells, views).to_json(),
    }


def depth_images(recording: Recording) -> Iterator[tuple[str, int, Float32Array]]:
    """Topic, stamp and stored image (m) of every depth image."""
    topics = [topic.name for topic in recording.topics if topic.role == "depth"]
    for message in recording.messages(topics):
        if isinstance(message.value, DepthImage):
            yield message.topic, message.stamp_ns, message.value.depth_m


def _load_truth(
    path: Path,
    lever_arm_m: tuple[float, float, float] | None,
    pitch_rad: float,
    clock_offset_ms: float | None,
) -> Truth:
    by_hand = (*(lever_arm_m or ()), pitch_rad, clock_offset_ms or 0.0)
    if not np.isfinite(by_hand).all():
        raise SettingsError(f"lever arm, pitch and clock offset must be finite, got {by_hand}.")
    lever_arm = None
    if lever_arm_m is not None:
        forward_m, left_m, up_m = lever_arm_m
        lever_arm = LeverArm(
            forward_m=forward_m,
            left_m=left_m,
            lidar_height_m=0.0,
            camera_height_m=up_m,
            pitch_rad=pitch_rad,
        )
    return load_truth(path, lever_arm=lever_arm, clock_offset_ms=clock_offset_ms)
