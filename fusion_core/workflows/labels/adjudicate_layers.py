"""Disagreements of layers to decide on, and a layer of what most of them say."""

from collections.abc import Iterator, Sequence

from fusion_core.annotation.action import Action
from fusion_core.annotation.aligned_layers import AlignedLabels, align_layers
from fusion_core.annotation.disagreements import Disagreement, adjudicate, disagreements
from fusion_core.annotation.identity import Author
from fusion_core.annotation.layer_difference import differing_samples
from fusion_core.annotation.store import LabelStore
from fusion_core.model.labels import NO_LABEL, CaptureLabels


def disagreements_of(store: LabelStore, layers: Sequence[str]) -> Iterator[Disagreement]:
    """The runs that at least two of the layers decided on differently, in order."""
    return disagreements(_aligned(store, layers))


def majority_labels(
    store: LabelStore, layers: Sequence[str], into: str, *, least_decisions: int = 1
) -> list[CaptureLabels]:
    """What most of the layers say of samples that have no label in ``into``, as ``adjudicate`` has
    it: somebody may have decided a disagreement there."""
    settled = adjudicate(_aligned(store, layers), least_decisions=least_decisions)
    added: list[CaptureLabels] = []
    for change in differing_samples(store.labelled(into), settled):
        is_new = change.before.label == NO_LABEL
        if is_new.any():
            added.append(change.after.subset(is_new))
    return added


def adjudicate_layers(
    store: LabelStore,
    layers: Sequence[str],
    into: str,
    author: Author,
    *,
    least_decisions: int = 1,
) -> Action | None:
    """Add the ``majority_labels`` to ``into``, in one action. None where there is nothing to add.
    Raises as ``LabelStore.label``."""
    added = majority_labels(store, layers, into, least_decisions=least_decisions)
    return store.label(into, added, author)


def _aligned(store: LabelStore, layers: Sequence[str]) -> Iterator[AlignedLabels]:
    return align_layers({name: store.labelled(name) for name in layers})
