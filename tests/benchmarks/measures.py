"""Every measure of alignment, noise and repair on recordings with truth, for both presets.

    python -m tests.benchmarks.measures

Uses the built-in sample, a simulated Robot@Home panorama, and the rooms below SCANLOOM_TEST_DATA
where that is set. The rooms' truths do not hold the mount: it is the one that their README states.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from fusion_core.evaluation.alignment import evaluate_alignment
from fusion_core.evaluation.noise import evaluate_noise
from fusion_core.evaluation.repair import evaluate_repair
from fusion_core.evaluation.tables import Row, alignment_table, noise_table, repair_table
from fusion_core.evaluation.truth import LeverArm, Truth, load_truth
from fusion_core.recordings.formats import open_recording
from fusion_core.simulation.scenes import write_scene
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.evaluate.evaluate import depth_images
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions

SAMPLE = Path(__file__).parents[2] / "samples" / "furnished_room.mcap"
ROOMS_MOUNT = LeverArm(
    forward_m=0.05, left_m=0.03, lidar_height_m=0.31, camera_height_m=0.92, pitch_rad=0.0
)
ROOMS = {"room_1": ("room_1", 0.0), "room_2": ("room_2.bag", 40.0), "room_3": ("room_3", 0.0)}


def recordings(work: Path) -> Iterator[tuple[str, Path, Truth]]:
    """Name, recording and truth of each."""
    data = os.environ.get("SCANLOOM_TEST_DATA")
    if data is None:
        print("SCANLOOM_TEST_DATA is not set: no rooms.")
    else:
        rooms = Path(data) / "rooms"
        for name, (file, clock_offset_ms) in ROOMS.items():
            truth = load_truth(
                rooms / f"{name}.truth.npz", lever_arm=ROOMS_MOUNT, clock_offset_ms=clock_offset_ms
            )
            yield name, rooms / file, truth
    yield "sample", SAMPLE, load_truth(truth_path(SAMPLE))
    panorama = work / "robot_at_home.mcap"
    write_scene("robot_at_home", panorama)
    yield "robot_at_home", panorama, load_truth(truth_path(panorama))


def show(title: str, rows: list[Row]) -> None:
    """Print a table with aligned columns."""
    print(f"\n{title}")
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for row in rows:
        print(
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        )


def main() -> None:
    """Fuse and measure."""
    with tempfile.TemporaryDirectory() as folder:
        known = list(recordings(Path(folder)))
        for preset in ("default", "published"):
            alignments, noises, repairs = {}, {}, {}
            for name, recording, truth in known:
                output = Path(folder) / preset / name
                fuse(recording, output, FuseOptions(preset=preset, maps=False, figures=False))
                alignments[name] = evaluate_alignment(output, truth)
                noises[name] = evaluate_noise(output, truth)
                with open_recording(recording) as opened:
                    repairs[name] = evaluate_repair(output, truth, depth_images(opened))
                print(f"{preset}: {name} done", file=sys.stderr)
            show(f"{preset}: frames with u within 2 samples", alignment_table(alignments))
            show(f"{preset}: noise", noise_table(noises))
            show(f"{preset}: repairs, median / 90th percentile / RMS in mm", repair_table(repairs))


if __name__ == "__main__":
    main()
