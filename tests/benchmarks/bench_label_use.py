"""What labels are worth: repairs and maps with and without them, and thresholds fitted on them.

    python -m tests.benchmarks.bench_label_use [--output DIR] [NAME …]

The labels are the truth's, on every beam and pixel, or on those of every fourth scan and image. By
default room_3 and room_4 below SCANLOOM_TEST_DATA where that is set, and the built-in sample.

Repairs: median, 90th percentile and mean of the absolute error over what was repaired of what is a
hole or a burr in truth, the fraction of the true holes that were filled, of the filled samples
those more than 0.3 m behind the surface, and how many samples that are good in truth were changed.
Maps: cells that are free or occupied and are not so in truth, from the recorded true poses; and of
``map --scan repaired`` from the same poses, against the outlines of the world where there are any,
the detection rate of what the sensors could see, the false obstacle cells, and these per m2 mapped.

Suggestions: for each threshold the value fitted on half of the scans with its 95 % interval, and
the scores on the other half: of the value in use, of the fitted one, and of the best one there.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fusion_core.evaluation.associated_truth import associate_truth
from fusion_core.evaluation.fuse_folder import open_fuse_folder, read_samples
from fusion_core.evaluation.pairs import true_pairs
from fusion_core.evaluation.repair import evaluate_repair
from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import Capture, CaptureLabels, LabelLayer
from fusion_core.recordings.formats import open_recording
from fusion_core.workflows.evaluate.evaluate import map_cells, ros_map
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.fuse import fuse
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import PRESETS
from fusion_core.workflows.labels.labelled_frames import labelled_frames
from fusion_core.workflows.labels.measures import measure_classes
from fusion_core.workflows.labels.suggestions import suggest_thresholds
from fusion_core.workflows.map.build_map import build_map
from fusion_core.workflows.map.options import MapOptions
from tests.benchmarks.known_recordings import Known, recordings
from tests.benchmarks.truth_layer import TruthLayer

NAMES = ["room_3", "room_4", "sample"]
POSE_TOPICS = {"room_3": "/ground_truth", "room_4": "/ground_truth", "sample": "/ground_truth"}


class EveryFourth:
    """A layer's labels of about every fourth capture."""

    def __init__(self, layer: TruthLayer) -> None:
        self._layer = layer
        self.name = f"{layer.name}, every fourth"

    @property
    def sha256(self) -> str:
        return f"{self._layer.sha256}/4"

    def labels_of(self, capture: Capture) -> CaptureLabels:
        labels = self._layer.labels_of(capture)
        chosen = capture.stamp_ns // 100_000_000 % 4 == 0
        return labels.subset(np.full(labels.row.size, chosen))


def _row(*cells: object) -> str:
    return "".join(f"{cell!s:>13}" for cell in cells)


def _repair_lines(known: Known, layers: dict[str, LabelLayer | None], work: Path) -> Iterator[str]:
    for name, layer in layers.items():
        folder = work / known.name / name.replace(" ", "_")
        options = FuseOptions(figures=False, pose_topic=POSE_TOPICS.get(known.name), labels=layer)
        fuse(known.recording, folder, options)
        report = evaluate_repair(folder, known.load_truth())
        harmed = _good_samples_changed(known, folder)
        for sensor, errors in (("lidar", report.lidar), ("depth", report.depth)):
            entries = errors.to_json()
            error_mm = 1000.0 * np.abs(errors.error_m)
            cells = [
                f"{value:.1f}" for value in (*np.percentile(error_mm, [50, 90]), error_mm.mean())
            ]
            filled, behind = entries["holes_filled"], entries["by_source"]["all"]["behind_surface"]
            cells += ["-" if value is None else f"{100 * value:.2f}" for value in (filled, behind)]
            yield _row(known.name, name, sensor, errors.error_m.size, *cells, harmed[sensor])
        found = map_cells(folder / "map_fused.yaml", known.truth)
        keys = ("free", "false_free", "occupied", "false_occupied")
        yield _row(known.name, name, "map", *(found[key] for key in keys))
        world = known.recording.with_suffix(".world.json")
        if world.exists():
            yield _row(known.name, name, "map repaired", *_outline_cells(known, layer, world, work))


def _outline_cells(
    known: Known, layer: LabelLayer | None, world: Path, work: Path
) -> Iterator[str]:
    folder = work / known.name / f"map {'none' if layer is None else layer.name}"
    options = MapOptions(
        scan="repaired", slam="none", pose_topic=POSE_TOPICS[known.name], labels=layer
    )
    build_map(known.recording, folder, options)
    found = ros_map(folder / "map_repaired.yaml", world, align=False)
    yield f"{found['visible']['rate']:.4f}"
    yield str(found["false_cells"])
    yield f"{found['false_cells_per_m2']:.2f}"


def _good_samples_changed(known: Known, folder: Path) -> dict[str, int]:
    """By sensor: samples that are good in truth, and have another value than the raw one."""
    opened = open_fuse_folder(folder)
    associated = associate_truth(known.load_truth(), opened)
    changed = {"lidar": 0, "depth": 0}
    for samples in read_samples(opened):
        scan = associated.scan_index(samples.scan_stamp_ns)
        good = associated.truth.kind[scan, samples.lidar_beam] == NoiseClass.GOOD
        changed["lidar"] += int((good & (samples.lidar_repaired_m != samples.lidar_raw_m)).sum())
        good = true_pairs(samples, associated).depth_true == NoiseClass.GOOD
        differs = samples.depth_repaired_m != samples.depth_raw_m
        changed["depth"] += int((good & differs[samples.paired]).sum())
    return changed


def _suggestion_lines(known: Known, layer: LabelLayer) -> Iterator[str]:
    settings = PRESETS["default"]
    with open_recording(known.recording) as recording:
        session = open_session(recording, FuseOptions(), settings)
        chain = CachedChain(session, FrameReader(session), align_recording(session))

        def frames():
            return labelled_frames(chain, settings, layer)

        measures = measure_classes(frames(), chain.alignment, settings).to_json()
        for side, entries in measures.items():
            for noise, own in entries["classes"].items():
                cells = [
                    "-" if own[key] is None else f"{own[key]:.3f}"
                    for key in ("precision", "recall")
                ]
                yield _row(known.name, side, noise, *cells, own["labelled"], own["automatic"])
        start_s = time.perf_counter()
        found = suggest_thresholds(frames(), chain.alignment, settings)
        yield _row(known.name, "suggested in", f"{time.perf_counter() - start_s:.1f} s")
        for suggestion in found:
            fit = suggestion.fit
            if fit is None:
                yield _row(known.name, suggestion.setting, "the labels do not tell")
                continue
            yield _row(
                known.name,
                suggestion.setting[:12],
                f"{fit.current:.3g}",
                f"{fit.value:.3g}",
                f"{fit.low:.3g}..{fit.high:.3g}",
                f"{fit.score_of_current:.4f}",
                f"{fit.score_of_value:.4f}",
                f"{fit.score_of_best:.4f}",
                f"{fit.best:.3g}",
            )


def main() -> None:
    """Fuse, measure and suggest."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--output", type=Path, metavar="DIR")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = asked.output or Path(temporary)
        known_ones = list(recordings(work, asked.names or NAMES))
        print(
            _row(
                "recording",
                "labels",
                "what",
                "repaired",
                "median mm",
                "p90 mm",
                "mean mm",
                "filled %",
                "behind %",
                "good changed",
            )
        )
        print(_row("", "", "map", "free", "false free", "occupied", "false occ."))
        for known in known_ones:
            truth = TruthLayer(known.load_truth())
            layers: dict[str, LabelLayer | None] = {
                "none": None,
                "a fourth": EveryFourth(truth),
                "all": truth,
            }
            for line in _repair_lines(known, layers, work):
                print(line, flush=True)
        print(
            "\n"
            + _row("recording", "side", "class", "precision", "recall", "labelled", "automatic")
        )
        print(
            _row(
                "",
                "setting",
                "in use",
                "fitted",
                "interval",
                "in use",
                "fitted",
                "best there",
                "its value",
            )
        )
        for known in known_ones:
            for line in _suggestion_lines(known, TruthLayer(known.load_truth())):
                print(line, flush=True)


if __name__ == "__main__":
    main()
