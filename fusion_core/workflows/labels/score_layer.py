"""A layer's recall and precision against another one of known answers."""

from fusion_core.annotation.aligned_layers import align_layers
from fusion_core.annotation.answer_scores import AnswerScore, ClassScore, score_answers
from fusion_core.workflows.labels.compare_layers import LabelledLayers

__all__ = ["AnswerScore", "ClassScore", "score_layer"]


def score_layer(source: LabelledLayers, layer: str, known: str) -> AnswerScore:
    """Score ``layer`` on the samples that it and ``known`` decided on. Raises as
    ``score_answers``."""
    return score_answers(
        align_layers({"known": source.labelled(known), "said": source.labelled(layer)})
    )
