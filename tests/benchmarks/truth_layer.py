"""A layer that labels every beam and every pixel as the truth has them."""

import hashlib

import numpy as np

from fusion_core.evaluation.truth import Truth
from fusion_core.model.labels import Capture, CaptureLabels


class TruthLayer:
    """Good, hole and burr; the truth knows no conflict of a single sample."""

    name = "truth"

    def __init__(self, truth: Truth) -> None:
        self._file = truth.file
        self._scans = dict(zip(truth.scan_stamp_ns.tolist(), truth.kind, strict=True))
        self._images = {
            (camera.topic, stamp_ns): kind
            for camera in truth.cameras
            for stamp_ns, kind in zip(camera.stamp_ns.tolist(), camera.kind, strict=True)
        }
        self._is_alone = len(truth.cameras) == 1

    @property
    def sha256(self) -> str:
        return hashlib.sha256(self._file.read_bytes()).hexdigest()

    def labels_of(self, capture: Capture) -> CaptureLabels:
        codes = np.full((capture.rows, capture.columns), -1)
        if capture.sensor == "lidar":
            found = self._scans.get(capture.stamp_ns)
        else:
            found = self._images.get((capture.topic, capture.stamp_ns))
            if found is None and self._is_alone:
                # A truth of one camera need not name its topic.
                found = self._images.get((None, capture.stamp_ns))
        if found is not None:
            codes[:] = found
        return CaptureLabels.of_image(capture, codes)
