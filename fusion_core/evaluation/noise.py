"""Classification of noise: recalls over pairs of a beam and a pixel (ξ and η of Xu 2024).

Holes are classified by their value and reported apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fusion_core.evaluation.associated_truth import associate_truth
from fusion_core.evaluation.fuse_folder import Samples, open_fuse_folder, read_samples
from fusion_core.evaluation.pairs import PairKind, true_pairs
from fusion_core.evaluation.truth import Truth
from fusion_core.model.classes import NoiseClass
from fusion_core.model.conventions import BoolArray, FloatArray, IntArray, read_only


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseReport:
    """Counts over pairs, from which every measure follows; the counts of recordings add up.

    ``pairs``: (5, 4, 4) pairs by kind in truth, class given to the beam, class given to the pixel.
    ``lidar_holes``, ``depth_holes``: true holes among the beams in view, and among the pixels that
    are paired with a beam.
    """

    pairs: IntArray
    conflicts_changed: int
    lidar_holes: int
    lidar_holes_labelled: int
    depth_holes: int
    depth_holes_labelled: int

    def __post_init__(self) -> None:
        if self.pairs.shape != (5, 4, 4):
            raise ValueError(f"pairs must be (5, 4, 4), got {self.pairs.shape}")
        read_only(self.pairs)

    @property
    def good_recall(self) -> float | None:
        """ξ of Xu 2024: good pairs labelled good on both sides / good pairs."""
        good = self.pairs[PairKind.GOOD]
        return _fraction(good[NoiseClass.GOOD, NoiseClass.GOOD], good.sum())

    @property
    def noise_recall(self) -> float | None:
        """η of Xu 2024: noise pairs labelled burr on either side / noise pairs."""
        return _fraction(self._noise_found, self.pairs[PairKind.LIDAR_BURR :].sum())

    @property
    def attribution(self) -> float | None:
        """Noise pairs whose burr labels name exactly the true sensors / noise pairs found."""
        burr = NoiseClass.BURR
        lidar, depth, both = self.pairs[PairKind.LIDAR_BURR :]
        right = (
            lidar[burr].sum()
            - lidar[burr, burr]
            + depth[:, burr].sum()
            - depth[burr, burr]
            + both[burr, burr]
        )
        return _fraction(right, self._noise_found)

    @property
    def conflict_recall(self) -> float | None:
        """Conflict pairs labelled conflict on both sides / conflict pairs."""
        conflict = self.pairs[PairKind.CONFLICT]
        return _fraction(conflict[NoiseClass.CONFLICT, NoiseClass.CONFLICT], conflict.sum())

    @property
    def conflict_recall_either(self) -> float | None:
        """Conflict pairs labelled conflict on at least one side / conflict pairs."""
        conflict = self.pairs[PairKind.CONFLICT]
        label = NoiseClass.CONFLICT
        found = conflict[label].sum() + conflict[:, label].sum() - conflict[label, label]
        return _fraction(found, conflict.sum())

    @property
    def conflict_changed(self) -> float | None:
        """Conflict pairs with another value than the raw one on either side / conflict pairs."""
        return _fraction(self.conflicts_changed, self.pairs[PairKind.CONFLICT].sum())

    @property
    def lidar_hole_recall(self) -> float | None:
        """Beams that are holes in truth and labelled so / holes among the beams in view."""
        return _fraction(self.lidar_holes_labelled, self.lidar_holes)

    @property
    def depth_hole_recall(self) -> float | None:
        """Pixels that are holes in truth and labelled so / holes among the paired pixels."""
        return _fraction(self.depth_holes_labelled, self.depth_holes)

    @property
    def _noise_found(self) -> int:
        noise = self.pairs[PairKind.LIDAR_BURR :].sum(axis=0)
        burr = NoiseClass.BURR
        return int(noise[burr].sum() + noise[:, burr].sum() - noise[burr, burr])

    def to_json(self) -> dict[str, Any]:
        """Fractions (None where there is nothing to count), and the counts behind them."""
        classes = [label.name.lower() for label in NoiseClass]
        return {
            "xi": self.good_recall,
            "eta": self.noise_recall,
            "attribution": self.attribution,
            "conflict_recall": self.conflict_recall,
            "conflict_recall_either": self.conflict_recall_either,
            "conflict_changed": self.conflict_changed,
            "lidar_hole_recall": self.lidar_hole_recall,
            "depth_hole_recall": self.depth_hole_recall,
            "good_pairs": int(self.pairs[PairKind.GOOD].sum()),
            "noise_pairs": int(self.pairs[PairKind.LIDAR_BURR :].sum()),
            "conflict_pairs": int(self.pairs[PairKind.CONFLICT].sum()),
            "lidar_holes": self.lidar_holes,
            "depth_holes": self.depth_holes,
            "labels": {
                kind.name.lower(): {
                    f"{lidar}/{depth}": int(self.pairs[kind, i, j])
                    for i, lidar in enumerate(classes)
                    for j, depth in enumerate(classes)
                    if self.pairs[kind, i, j]
                }
                for kind in PairKind
                if kind is not PairKind.OTHER
            },
        }


def evaluate_noise(fuse_dir: Path, truth: Truth) -> NoiseReport:
    """Compare the classes in ``fuse_dir`` with ``truth``.

    Raises ScanLoomError where a file is invalid, folder and truth are of different recordings, or
    the truth has no mount.
    """
    folder = open_fuse_folder(fuse_dir)
    associated = associate_truth(truth, folder)
    counts = np.zeros((5, 4, 4), dtype=np.int64)
    changed = 0
    holes = np.zeros((2, 2), dtype=np.int64)
    for samples in read_samples(folder):
        row = samples.paired
        pairs = true_pairs(samples, associated)
        kind = pairs.kind
        known = kind != PairKind.OTHER
        np.add.at(
            counts,
            (kind[known], samples.lidar_class[row][known], samples.depth_class[row][known]),
            1,
        )
        conflict = row[kind == PairKind.CONFLICT]
        changed += int(_is_changed(samples, conflict).sum())
        scan = associated.scan_index(samples.scan_stamp_ns)
        lidar_hole = truth.kind[scan, samples.lidar_beam] == NoiseClass.HOLE
        depth_hole = pairs.depth_true == NoiseClass.HOLE
        holes[0] += lidar_hole.sum(), (samples.lidar_class[lidar_hole] == NoiseClass.HOLE).sum()
        holes[1] += (
            depth_hole.sum(),
            (samples.depth_class[row][depth_hole] == NoiseClass.HOLE).sum(),
        )
    return NoiseReport(
        pairs=counts,
        conflicts_changed=changed,
        lidar_holes=int(holes[0, 0]),
        lidar_holes_labelled=int(holes[0, 1]),
        depth_holes=int(holes[1, 0]),
        depth_holes_labelled=int(holes[1, 1]),
    )


def pool_noise(reports: Sequence[NoiseReport]) -> NoiseReport:
    """One report over the pairs of several recordings."""
    return NoiseReport(
        pairs=np.sum([report.pairs for report in reports], axis=0, dtype=np.int64).reshape(5, 4, 4),
        conflicts_changed=sum(report.conflicts_changed for report in reports),
        lidar_holes=sum(report.lidar_holes for report in reports),
        lidar_holes_labelled=sum(report.lidar_holes_labelled for report in reports),
        depth_holes=sum(report.depth_holes for report in reports),
        depth_holes_labelled=sum(report.depth_holes_labelled for report in reports),
    )


def _is_changed(samples: Samples, row: IntArray) -> BoolArray:
    """Rows in which either sensor's value is not its raw one (missing equals missing)."""
    return _values_differ(samples.lidar_raw_m[row], samples.lidar_repaired_m[row]) | _values_differ(
        samples.depth_raw_m[row], samples.depth_repaired_m[row]
    )


def _values_differ(raw_m: FloatArray, repaired_m: FloatArray) -> BoolArray:
    differs: BoolArray = (raw_m != repaired_m) & ~(np.isnan(raw_m) & np.isnan(repaired_m))
    return differs


def _fraction(part: int | np.integer[Any], whole: int | np.integer[Any]) -> float | None:
    return float(part) / float(whole) if whole else None
