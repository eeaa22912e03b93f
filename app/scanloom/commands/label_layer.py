"""The options that name a layer of labels, and the layer that they name."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.options import WrongUsage

if TYPE_CHECKING:
    from fusion_core.model.labels import LabelLayer

LayerOption = Annotated[
    str | None,
    conf.arg(
        metavar="LAYER",
        help="A layer of labels, which overrule the automatic classes.",
        help_behavior_hint="",
    ),
]
LabelStoreOption = Annotated[
    str | None,
    conf.arg(
        metavar="ADDRESS",
        help="The store of the labels, a file or postgresql://USER@HOST/DATABASE (default: beside "
        "the recording).",
        help_behavior_hint="",
    ),
]


def require_layer(layer: str | None, store: str | None) -> None:
    """Raises WrongUsage for a store without a layer."""
    if layer is None and store is not None:
        raise WrongUsage("--label-store goes with --labels, which names a layer in it")


@contextmanager
def label_layer(
    recording: Path, layer: str | None, store: str | None, progress: Progress
) -> "Iterator[LabelLayer | None]":
    """The layer that the options name, as it is now; None for none.

    Raises WrongUsage for a store without a layer, and as ``open_labels``.
    """
    require_layer(layer, store)
    if layer is None:
        yield None
        return
    from fusion_core.workflows.labels.open_store import open_labels

    with open_labels(recording, store, create=False, progress=progress) as opened:
        yield opened.layer(layer)
