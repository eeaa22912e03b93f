"""Errors of two runs' repairs at the samples that both repair."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fusion_core.evaluation.associated_truth import associate_truth
from fusion_core.evaluation.fuse_folder import open_fuse_folder, read_samples
from fusion_core.evaluation.repair_errors import was_repaired
from fusion_core.evaluation.truth import Truth
from fusion_core.model.classes import NoiseClass

# Both errors count as at least this: of a thousandth of a millimetre the logarithm says nothing.
LEAST_ERROR_M = 1e-3


@dataclass(frozen=True)
class PairedRepairs:
    """``log_ratio``: mean logarithm of the second run's error over the first's, ``sd`` its standard
    error over frames; ``median_m``: of both runs; ``count``: samples that both repair."""

    count: int
    median_m: tuple[float, float]
    log_ratio: float
    sd: float

    def line(self) -> str:
        first, second = (1e3 * one for one in self.median_m)
        return (
            f"{self.count} that both repair: median {first:.2f} and {second:.2f} mm, "
            f"mean ln of the ratio {self.log_ratio:+.4f} +- {self.sd:.4f}"
        )


def pair_repairs(first: Path, second: Path, truth: Truth) -> dict[str, PairedRepairs]:
    """Those of the LiDAR's ranges by image and beam, and of depths by image and pixel."""
    errors = [_errors_m(output, truth) for output in (first, second)]
    return {sensor: _pair(*(own[sensor] for own in errors)) for sensor in ("lidar", "depth")}


def _pair(
    first: dict[tuple[int, ...], float], second: dict[tuple[int, ...], float]
) -> PairedRepairs:
    common = sorted(first.keys() & second.keys())
    if not common:
        # The runs' curves cross other holes.
        return PairedRepairs(count=0, median_m=(np.nan, np.nan), log_ratio=np.nan, sd=np.nan)
    pairs = np.array([(first[key], second[key]) for key in common])
    log_ratio = np.diff(np.log(np.maximum(pairs, LEAST_ERROR_M)), axis=1)[:, 0]
    mean = float(log_ratio.mean())
    # What is repaired in one frame has its errors in common.
    _, frame = np.unique([key[0] for key in common], return_inverse=True)
    sums = np.bincount(frame, weights=log_ratio - mean)
    return PairedRepairs(
        count=len(common),
        median_m=tuple(np.median(pairs, axis=0)),
        log_ratio=mean,
        sd=float(np.sqrt(np.sum(sums**2)) / len(common)),
    )


def _errors_m(output: Path, truth: Truth) -> dict[str, dict[tuple[int, ...], float]]:
    folder = open_fuse_folder(output)
    associated = associate_truth(truth, folder)
    errors: dict[str, dict[tuple[int, ...], float]] = {"lidar": {}, "depth": {}}
    for samples in read_samples(folder):
        scan, beam = associated.scan_index(samples.scan_stamp_ns), samples.lidar_beam
        repaired_m = samples.lidar_repaired_m
        chosen = truth.kind[scan, beam] != NoiseClass.GOOD
        chosen &= was_repaired(samples.lidar_source, repaired_m)
        error_m = np.abs(repaired_m - truth.range_m[scan, beam])
        keys = zip(samples.stamp_ns[chosen], beam[chosen], strict=True)
        errors["lidar"].update(zip(keys, error_m[chosen], strict=True))
        paired = samples.paired
        stamp_ns, camera = samples.stamp_ns[paired], samples.camera[paired]
        image = associated.image_index(camera, stamp_ns)
        pixel = image, samples.depth_row[paired], samples.depth_column[paired]
        repaired_m = samples.depth_repaired_m[paired]
        for code, own in enumerate(associated.cameras):
            chosen = (camera == code) & was_repaired(samples.depth_source[paired], repaired_m)
            chosen[chosen] &= own.truth.kind[tuple(one[chosen] for one in pixel)] != NoiseClass.GOOD
            mine = tuple(one[chosen] for one in pixel)
            error_m = np.abs(repaired_m[chosen] - own.truth.depth_m(*mine))
            keys = zip(stamp_ns[chosen], camera[chosen], *mine, strict=True)
            errors["depth"].update(zip(keys, error_m, strict=True))
    return {
        sensor: {key: error_m for key, error_m in own.items() if np.isfinite(error_m)}
        for sensor, own in errors.items()
    }
