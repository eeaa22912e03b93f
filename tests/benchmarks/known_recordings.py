"""Recordings with truth for benchmarks: the rooms below SCANLOOM_TEST_DATA where that is set, the
built-in sample, and simulated scenes."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.evaluation.truth import LeverArm, Truth, load_truth
from fusion_core.simulation.scenes import write_scene
from fusion_core.simulation.truth import truth_path

ROOMS = [f"room_{number}" for number in range(1, 10)]
SAMPLE = Path(__file__).parents[2] / "samples" / "furnished_room.mcap"
SCENES = {"panorama": "robot_at_home", "floor": "floor"}
# As the README of the rooms states it, where the truth does not hold the mount.
ROOMS_MOUNT = LeverArm(forward_m=0.05, left_m=0.03, lidar_height_m=0.31, camera_height_m=0.92)
CLOCK_OFFSET_MS = {"room_2": 40.0}
"""Late stamps, by the README of the rooms."""


@dataclass(frozen=True)
class Known:
    """A recording with its truth; ``mount`` where the truth lacks it."""

    name: str
    recording: Path
    truth: Path
    mount: LeverArm | None

    def load_truth(self) -> Truth:
        """With the mount and the clock that its file may lack."""
        late_ms = CLOCK_OFFSET_MS.get(self.name, 0.0)
        return load_truth(self.truth, lever_arm=self.mount, clock_offset_ms=late_ms)


def recordings(work: Path, wanted: list[str]) -> Iterator[Known]:
    """The recordings, in the order of the tables."""
    data = os.environ.get("SCANLOOM_TEST_DATA")
    rooms = sorted((Path(data) / "rooms").glob("room_*.truth.npz")) if data else []
    for truth in rooms:
        name = truth.name.removesuffix(".truth.npz")
        bag = truth.with_name(f"{name}.bag")
        recording = bag if bag.exists() else truth.with_name(name)
        if not wanted or name in wanted:
            yield Known(name, recording, truth, _mount_of(truth))
    if not wanted or "sample" in wanted:
        yield Known("sample", SAMPLE, truth_path(SAMPLE), None)
    for name, scene in SCENES.items():
        if wanted and name not in wanted:
            continue
        recording = work / f"{name}.mcap"
        if not recording.exists():
            write_scene(scene, recording)
        yield Known(name, recording, truth_path(recording), None)


def _mount_of(truth: Path) -> LeverArm:
    with np.load(truth) as arrays:
        if "cam_z" not in arrays:
            return ROOMS_MOUNT
        forward_m, left_m = map(float, arrays["cam_offset"])
        return LeverArm(
            forward_m=forward_m,
            left_m=left_m,
            lidar_height_m=float(arrays["lidar_z"]),
            camera_height_m=float(arrays["cam_z"]),
            pitch_rad=float(arrays["cam_pitch"]),
        )
