"""The layers of a store that a command works on."""

from collections.abc import Sequence

from fusion_core.annotation.store import LabelStore
from fusion_core.model.errors import LabelStoreError


def chosen_layer(store: LabelStore, name: str | None) -> str:
    """The layer of this name, or without one the only layer.

    Raises LabelStoreError where there is none, or where several are to choose from.
    """
    if name is not None:
        return store.layer(name).name
    there = store.layers
    if len(there) == 1:
        return there[0]
    raise LabelStoreError(
        f"has {len(there)} layers." if there else "has no labels yet.",
        file=store.place,
        advice=f"Choose one by --layer: {', '.join(there)}." if there else "",
    )


def chosen_layers(store: LabelStore, names: Sequence[str]) -> tuple[str, ...]:
    """The layers of these names, each once, or without names all layers.

    Raises LabelStoreError where one is missing.
    """
    return tuple(dict.fromkeys(store.layer(name).name for name in names)) or store.layers
