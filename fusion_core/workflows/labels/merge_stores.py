"""The layers of another store of the same recording."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fusion_core.annotation.action import CaptureChange
from fusion_core.annotation.address import parse_address
from fusion_core.annotation.identity import Author
from fusion_core.annotation.layer_difference import DifferenceCounts, differing_samples
from fusion_core.annotation.store import LabelStore
from fusion_core.files.inputs import real_path
from fusion_core.model.errors import LabelStoreError
from fusion_core.model.labels import NO_LABEL
from fusion_core.model.progress import Progress
from fusion_core.workflows.labels.chosen_layers import chosen_layers
from fusion_core.workflows.labels.import_labels import IMPORTER
from fusion_core.workflows.labels.open_store import open_labels


@dataclass(frozen=True, slots=True, kw_only=True)
class MergeOptions:
    """``address``: of the store that is merged into, as ``open_labels`` has it. ``layers``: of the
    other store, all if empty. ``annotator``: who merges, and may undo it. ``replace``: where both
    stores label a sample, the other one's label counts."""

    address: str | None = None
    layers: tuple[str, ...] = ()
    annotator: str = IMPORTER
    replace: bool = False


def merge_stores(
    recording: Path, other: str, options: MergeOptions, progress: Progress
) -> dict[str, Any]:
    """Bring in another store's layers under their names, each as one action, and report each
    layer's difference and ``done``, as JSON.

    Labels that only our layer has stay. Where a sample has another label in the other store,
    nothing is done for any layer, unless ``replace``. Who labelled what there stays in that store's
    journal. Raises LabelStoreError where that is this store or of another recording, and as
    ``open_labels`` and ``LabelStore.label``.
    """
    with open_labels(recording, options.address, create=True, progress=progress) as store:
        place = parse_address(other)
        if isinstance(place, Path) and real_path(place) == real_path(Path(store.place)):
            raise LabelStoreError("cannot be merged with itself.", file=store.place)
        with LabelStore.open(other, store.recording, create=False) as incoming:
            merged = {
                name: _without_losses(store, incoming, name)
                for name in chosen_layers(incoming, options.layers)
            }
        differences = {name: DifferenceCounts.of(changes) for name, changes in merged.items()}
        done = options.replace or not any(found.altered for found in differences.values())
        if done:
            comment = f"merged from {incoming.place}"
            author = Author(options.annotator, "imported", comment=comment)
            for name, changes in merged.items():
                store.label(name, [change.after for change in changes], author)
        return {
            "from": incoming.place,
            "store": store.place,
            "done": done,
            "layers": {name: found.to_json() for name, found in differences.items()},
        }


def _without_losses(store: LabelStore, incoming: LabelStore, layer: str) -> list[CaptureChange]:
    """What the other store's layer adds to ours and gives otherwise."""
    found = []
    for change in differing_samples(store.labelled(layer), incoming.labelled(layer)):
        kept = change.after.label != NO_LABEL
        if kept.any():
            found.append(
                CaptureChange(before=change.before.subset(kept), after=change.after.subset(kept))
            )
    return found
