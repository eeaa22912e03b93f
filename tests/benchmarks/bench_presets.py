"""The two presets like for like: both alone, and both with the recording's mount.

    python -m tests.benchmarks.bench_presets [NAME …]

Alone, each frame is paired by the peak of its own field: nothing is known of the mount, nor of the
other frames' offset. With the mount, beams and pixels are paired along the projected curve of the
mount that the recording itself yields, and a frame's peak is searched near it; what remains of the
preset are its classes and repairs.
All four see the same recordings: the rooms below SCANLOOM_TEST_DATA, whose simulator is not this
project's. Pairs are counted over all rooms together; each way of pairing has pairs of its own.
"""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np

from fusion_core.evaluation.alignment import AlignmentReport, evaluate_alignment, pool_hits
from fusion_core.evaluation.noise import NoiseReport, evaluate_noise, pool_noise
from fusion_core.evaluation.repair import RepairReport, evaluate_repair, pool_repair
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions
from fusion_core.workflows.fuse.settings import PRESETS, ChainSettings, PresetName
from tests.benchmarks.known_recordings import ROOMS, Known, recordings

Report = tuple[AlignmentReport, NoiseReport, RepairReport]


def variants() -> Iterator[tuple[str, PresetName, ChainSettings]]:
    """The four columns."""
    for preset, settings in PRESETS.items():
        for title, pairing in (("alone", "frame"), ("with mount", "mount")):
            search = settings.search.model_copy(update={"use_prior": pairing == "mount"})
            changed = settings.model_copy(update={"pairing": pairing, "search": search})
            yield f"{preset}, {title}", preset, changed


def report(known: Known, preset: PresetName, settings: ChainSettings, folder: Path) -> Report:
    """Fuse one room with these settings, and compare with its truth."""
    with patch.dict(PRESETS, {preset: settings}):
        fuse(known.recording, folder, FuseOptions(preset=preset, maps=False, figures=False))
    truth = known.load_truth()
    return (
        evaluate_alignment(folder, truth),
        evaluate_noise(folder, truth),
        evaluate_repair(folder, truth),
    )


def cells(reports: list[Report]) -> list[str]:
    """A column of the table."""
    alignments, noises, repairs = zip(*reports, strict=True)
    noise, lidar = pool_noise(noises), pool_repair(repairs).lidar
    entries = lidar.to_json()
    behind = entries["by_source"]["all"]["behind_surface"]
    fractions = (
        pool_hits(alignments)["u"].fraction,
        noise.good_recall,
        noise.noise_recall,
        noise.attribution,
        noise.conflict_recall,
        noise.conflict_changed,
        entries["holes_filled"],
        behind,
    )
    own_m, linear_m = lidar.error_m, lidar.baseline_error_m["linear"]
    return [
        *("–" if value is None else f"{value:.3f}" for value in fractions),
        *(f"{_millimetres(own_m, q)} : {_millimetres(linear_m, q)}" for q in (50, 90)),
        "/".join(str(count) for count in _pairs(noise)),
    ]


def _pairs(noise: NoiseReport) -> tuple[int, int, int]:
    counts = noise.to_json()
    return counts["good_pairs"], counts["noise_pairs"], counts["conflict_pairs"]


def _millimetres(error_m: np.ndarray, percent: int) -> str:
    return f"{1000.0 * np.nanpercentile(error_m, percent):.0f}" if error_m.size else "–"


ROWS = (
    "frames whose u is within 2 samples",
    "ξ, good pairs labelled good",
    "η, noise pairs found",
    "attribution",
    "conflict pairs recognised",
    "conflict pairs changed",
    "LiDAR holes filled",
    "filled > 0.3 m behind the surface",
    "median error : linear, mm",
    "90th percentile : linear, mm",
    "pairs good/noise/conflict",
)


def main() -> None:
    """Fuse every room in four ways, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    asked = parser.parse_args()
    columns = {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        known = list(recordings(work, asked.names or ROOMS))
        if not known:
            parser.error("SCANLOOM_TEST_DATA is not set, or holds none of these rooms.")
        for title, preset, settings in variants():
            reports = [report(one, preset, settings, work / title / one.name) for one in known]
            columns[title] = cells(reports)
    print(f"{len(known)} recordings: {', '.join(one.name for one in known)}\n")
    print(f"{'':36}" + "".join(f"{title:>24}" for title in columns))
    for row, *values in zip(ROWS, *columns.values(), strict=True):
        print(f"{row:36}" + "".join(f"{value:>24}" for value in values))


if __name__ == "__main__":
    main()
