"""Every measure of alignment, noise and repair on recordings with truth, for both presets.

    python -m tests.benchmarks.measures [NAME ...]

Uses the built-in sample, a simulated Robot@Home panorama, and the rooms below SCANLOOM_TEST_DATA
where that is set. Where a room's truth does not hold the mount, it is the one that their README
states. NAME: a recording of these, by default each.
"""

import sys
import tempfile
from pathlib import Path

from fusion_core.evaluation.alignment import evaluate_alignment
from fusion_core.evaluation.noise import evaluate_noise
from fusion_core.evaluation.repair import evaluate_repair
from fusion_core.evaluation.tables import Row, alignment_table, noise_table, repair_table
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.evaluate.evaluate import depth_images
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from tests.benchmarks.known_recordings import ROOMS, recordings

DEFAULT = [*ROOMS, "sample", "panorama"]


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
        every = list(recordings(Path(folder), sys.argv[1:] or DEFAULT))
        for preset in ("default", "published"):
            alignments, noises, repairs = {}, {}, {}
            for known in every:
                name, output = known.name, Path(folder) / preset / known.name
                truth = known.load_truth()
                options = FuseOptions(preset=preset, maps=False, figures=False)
                fuse(known.recording, output, options)
                alignments[name] = evaluate_alignment(output, truth)
                noises[name] = evaluate_noise(output, truth)
                with open_recording(known.recording) as opened:
                    repairs[name] = evaluate_repair(output, truth, depth_images(opened))
                print(f"{preset}: {name} done", file=sys.stderr)
            show(f"{preset}: frames with u within 2 samples", alignment_table(alignments))
            show(f"{preset}: noise", noise_table(noises))
            show(f"{preset}: repairs, median / 90th percentile / RMS in mm", repair_table(repairs))


if __name__ == "__main__":
    main()
