"""What answers mean as labels."""

from collections.abc import Iterable

import numpy as np

from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from scanloom.state.review_choices import Answer


def label_of_answer(answer: Answer, automatic: int) -> int | None:
    """The label that an answer gives to samples of an automatic class; None where it gives none:
    what is not good may be anything else."""
    match answer:
        case "accept":
            return automatic
        case "reject":
            return None if automatic == NoiseClass.GOOD else int(Label.GOOD)
        case "clear":
            return NO_LABEL
    return int(answer)


def united_by_capture(parts: Iterable[CaptureLabels]) -> list[CaptureLabels]:
    """Labels of each capture together; of a sample that is labelled twice, the last one."""
    by_capture: dict[Capture, list[CaptureLabels]] = {}
    for labels in parts:
        by_capture.setdefault(labels.capture, []).append(labels)
    return [
        CaptureLabels.of_samples(
            capture,
            np.concatenate([part.row for part in own]),
            np.concatenate([part.column for part in own]),
            np.concatenate([part.label for part in own]),
        )
        for capture, own in by_capture.items()
    ]
