"""Agreement of a recording's layers."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

from fusion_core.annotation.agreement import (
    RESAMPLES,
    Agreement,
    Estimate,
    PairAgreement,
    measure_agreement,
)
from fusion_core.annotation.aligned_layers import align_layers
from fusion_core.model.labels import CaptureLabels
from fusion_core.model.progress import Progress
from fusion_core.workflows.labels.chosen_layers import chosen_layers
from fusion_core.workflows.labels.open_store import open_labels

__all__ = [
    "Agreement",
    "Estimate",
    "LabelledLayers",
    "PairAgreement",
    "agreement_of",
    "compare_layers",
]


class LabelledLayers(Protocol):
    """What has labels in layers, as an open store has."""

    def labelled(self, layer: str) -> Iterator[CaptureLabels]:
        """All captures of a layer that have labels, in the order of Capture."""
        ...


def compare_layers(
    recording: Path,
    address: str | None,
    layers: Sequence[str],
    progress: Progress,
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> dict[str, Any]:
    """Agreement of the named layers, or of all, as JSON. Raises as ``measure_agreement``,
    ``open_labels`` and ``chosen_layers``."""
    with open_labels(recording, address, create=False, progress=progress) as store:
        names = chosen_layers(store, layers)
        found = agreement_of(store, names, resamples=resamples, seed=seed)
    return {"resamples": resamples, "seed": seed, **found.to_json()}


def agreement_of(
    source: LabelledLayers, layers: Sequence[str], *, resamples: int = RESAMPLES, seed: int = 0
) -> Agreement:
    """Agreement of some layers. Raises as ``measure_agreement``."""
    blocks = align_layers({name: source.labelled(name) for name in layers})
    return measure_agreement(blocks, resamples=resamples, seed=seed)
