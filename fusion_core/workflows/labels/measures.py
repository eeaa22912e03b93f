"""A layer of labels in place of a truth: the classes against it, and Fig. 6 of Xu 2024."""

from collections.abc import Iterable

import numpy as np

from fusion_core.evaluation.label_measures import LabelMeasures, count_confusion
from fusion_core.evaluation.recall_curve import RecallCounter, RecallCurve
from fusion_core.model.labels import Label
from fusion_core.workflows.evaluate.evaluate import EPSILON_OVER_E
from fusion_core.workflows.fuse.align import RecordingAlignment
from fusion_core.workflows.fuse.frame import classify_match
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.labels.labelled_frames import LabelledFrame


def measure_classes(
    frames: Iterable[LabelledFrame], alignment: RecordingAlignment, settings: ChainSettings
) -> LabelMeasures:
    """Precision and recall of the automatic classes, for each class on both sides."""
    confusion = np.zeros((2, 4, 4), dtype=np.int64)
    for frame in frames:
        (classes,) = classify_match(frame.match, alignment, settings.time, [settings.noise])
        confusion[0] += count_confusion(frame.lidar, classes.lidar_class)
        confusion[1] += count_confusion(frame.depth, classes.depth_class)
    return LabelMeasures(confusion=confusion)


def recall_by_labels(frames: Iterable[LabelledFrame]) -> RecallCurve:
    """The recalls over epsilon, as ``recall_over_epsilon`` counts them.

    A good pair is labelled good on both sides; a noise pair has a value on both, and a burr on at
    least one.
    """
    counter = RecallCounter(EPSILON_OVER_E)
    for frame in frames:
        pairs, found = frame.match.correspondence, frame.match.registration
        has_both = np.isfinite(pairs.lidar_range_m) & np.isfinite(pairs.depth_m)
        mean_error_m = float("nan") if found is None else found.mean_error_m
        counter.add(
            pairs.residual_m,
            np.full(pairs.beam.size, mean_error_m),
            is_good=(frame.lidar == Label.GOOD) & (frame.depth == Label.GOOD),
            is_noise=has_both & ((frame.lidar == Label.BURR) | (frame.depth == Label.BURR)),
        )
    return counter.curve()
