"""What answers mean as labels."""

from fusion_core.model.classes import NoiseClass
from fusion_core.model.labels import NO_LABEL, Label
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
