"""Agreement of a recording's layers."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fusion_core.annotation.agreement import RESAMPLES, measure_agreement
from fusion_core.annotation.aligned_layers import align_layers
from fusion_core.model.progress import Progress
from fusion_core.workflows.labels.chosen_layers import chosen_layers
from fusion_core.workflows.labels.open_store import open_labels


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
        blocks = align_layers({name: store.labelled(name) for name in names})
        found = measure_agreement(blocks, resamples=resamples, seed=seed)
    return {"resamples": resamples, "seed": seed, **found.to_json()}
