"""The labels of one recording, as all browsers at this server share them."""

import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from fusion_core.model.labels import Capture, CaptureLabels, Label, LabelLayer
from fusion_core.model.progress import Progress, silent
from fusion_core.workflows.labels.adjudicate_layers import adjudicate_layers, majority_labels
from fusion_core.workflows.labels.open_store import Action, Author, LabelStore, open_labels

OnChange = Callable[[str, Sequence[Capture]], None]
"""Called with a layer and the captures whose labels have changed in it."""


class RecordingLabels:
    """Opens the store when it is first needed, and tells all who listen of each action.

    What other servers or commands write to the same store is taken in by ``take_in_others``.
    Thread-safe.
    """

    def __init__(
        self, recording: Path, address: str | None = None, folder: Path | None = None
    ) -> None:
        """``folder``: of the store, made with it."""
        self._recording, self._address, self._folder = recording, address, folder
        self._lock = threading.RLock()
        self._store: LabelStore | None = None
        self._head = 0
        self._listeners: list[OnChange] = []

    def open(self, progress: Progress = silent, *, create: bool = True) -> None:
        """Open the store, made if it is missing and ``create``. Raises ScanLoomError for one that
        cannot be used."""
        with self._lock:
            if self._store is None:
                if create and self._folder is not None:
                    self._folder.mkdir(parents=True, exist_ok=True)
                self._store = open_labels(
                    self._recording, self._address, create=create, progress=progress
                )
                self._head = self._store.head()

    def listen(self, on_change: OnChange) -> None:
        """Call ``on_change`` after each action, in the thread of whoever acted."""
        with self._lock:
            if on_change not in self._listeners:
                self._listeners.append(on_change)

    def remove_listener(self, on_change: OnChange) -> None:
        """Call it no longer."""
        with self._lock:
            if on_change in self._listeners:
                self._listeners.remove(on_change)

    @property
    def layers(self) -> tuple[str, ...]:
        """The names of the layers."""
        return self._opened.layers

    @property
    def known_layers(self) -> tuple[str, ...]:
        """The names of the layers; none while the store is not open."""
        with self._lock:
            store = self._store
        return () if store is None else store.layers

    def layer(self, name: str) -> LabelLayer:
        """A layer as it is now. Raises ScanLoomError where there is none of this name, or no
        store."""
        self.open(create=False)
        return self._opened.layer(name)

    def labels_of(self, layer: str, capture: Capture) -> CaptureLabels:
        """The labels in force in one capture."""
        return self._opened.labels_of(layer, capture)

    def labelled(self, layer: str) -> Iterator[CaptureLabels]:
        """All captures of a layer that have labels."""
        return self._opened.labelled(layer)

    def counts(self, layer: str) -> dict[Label, int]:
        """How many samples have each label."""
        return self._opened.counts(layer)

    def label(self, layer: str, labels: Sequence[CaptureLabels], author: Author) -> bool:
        """Write one action; whether it has changed anything. Raises ScanLoomError where it cannot
        be written."""
        return self._told(self._opened.label(layer, labels, author))

    def majority(
        self, layers: Sequence[str], into: str, least_decisions: int
    ) -> list[CaptureLabels]:
        """What ``adjudicate`` would add."""
        return majority_labels(self._opened, layers, into, least_decisions=least_decisions)

    def adjudicate(
        self, layers: Sequence[str], into: str, author: Author, least_decisions: int
    ) -> int:
        """Add what most of the layers say to ``into``, in one action; how many labels. Raises
        ScanLoomError where it cannot be written."""
        action = adjudicate_layers(
            self._opened, layers, into, author, least_decisions=least_decisions
        )
        return action.samples if action is not None and self._told(action) else 0

    def undo(self, layer: str, annotator: str) -> bool:
        """Take back the annotator's last action; whether there was one."""
        return self._told(self._opened.undo(layer, annotator))

    def redo(self, layer: str, annotator: str) -> bool:
        """Do again what was taken back last; whether there was anything."""
        return self._told(self._opened.redo(layer, annotator))

    def take_in_others(self) -> None:
        """Tell of what others have written to the store since."""
        with self._lock:
            if self._store is None or self._store.head() <= self._head:
                return
            actions = list(self._store.actions(after=self._head))
        for action in actions:
            self._told(action)

    def close(self) -> None:
        """Close the store."""
        with self._lock:
            store, self._store = self._store, None
            self._listeners.clear()
        if store is not None:
            store.close()

    @property
    def _opened(self) -> LabelStore:
        with self._lock:
            assert self._store is not None, "it was opened"
            return self._store

    def _told(self, action: Action | None) -> bool:
        if action is None:
            return False
        with self._lock:
            self._head = max(self._head, action.id)
            listeners = list(self._listeners)
        for listener in listeners:
            listener(action.layer, action.captures)
        return True
