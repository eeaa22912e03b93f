"""``LabelStore``: the journal of one recording's labels. Nothing in it is ever lost.

Each action is one transaction, on disk when the call returns. The state is the replay of the
journal. SQLite in a file of its own, or PostgreSQL for a team.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Self

from sqlalchemy import select

from fusion_core.annotation import schema
from fusion_core.annotation.action import Action, CaptureChange
from fusion_core.annotation.address import open_database
from fusion_core.annotation.database import Database
from fusion_core.annotation.identity import Author, RecordingIdentity, checked_name
from fusion_core.annotation.input_cache import remember_digests
from fusion_core.annotation.journal import (
    append_inverse,
    append_labels,
    changes_of_action,
    newest_action,
    stream_actions,
)
from fusion_core.annotation.labels_in_force import (
    all_labels,
    count_between,
    count_codes,
    labels_of_capture,
)
from fusion_core.annotation.layer_view import LayerView
from fusion_core.annotation.undo_stacks import StackTops, find_tops
from fusion_core.files.file_state import FileState
from fusion_core.model.errors import LabelStoreError
from fusion_core.model.labels import Capture, CaptureLabels, Label


class LabelStore:
    """Labels in layers, by annotators. Threads may share it; other programs may have it open too.

    What writes raises ExportError where the store cannot be written (a full disk, a read-only
    folder, locked for 30 s, a database that is down), with nothing of the action done;
    SettingsError for names that cannot be kept. What reads a layer that does not exist finds no
    labels, but for ``layer``. Everything raises LabelStoreError where the store is damaged.
    """

    def __init__(self, database: Database) -> None:
        """Of an open database; ``open`` is the usual way."""
        self._database = database
        self._counts: dict[str, tuple[int, Counter[int]]] = {}
        self._counts_lock = Lock()

    @classmethod
    def open(cls, address: Path | str, recording: RecordingIdentity, *, create: bool) -> Self:
        """Open the store at a path, or at ``postgresql://USER@HOST/DATABASE``.

        A missing store is made where ``create``. Where the file or folder is read-only the store
        can be read, and writing says why not. Raises LabelStoreError where it is missing, damaged,
        foreign, of a newer schema or of another recording, and leaves it untouched; ExportError
        where it cannot be made or reached; SettingsError for an address of another kind.
        """
        return cls(open_database(address, recording, create=create))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the database. A second call does nothing."""
        self._database.close()

    @property
    def place(self) -> str:
        """Where the store is, without a password."""
        return self._database.place

    @property
    def read_only_because(self) -> str:
        """Why nothing can be written, "" where it can."""
        return self._database.read_only_because

    @property
    def recording(self) -> RecordingIdentity:
        """The recording that the labels belong to."""
        store = schema.store.c
        with self._database.reading() as connection:
            own = connection.execute(select(store.recording_name, store.recording_sha256)).one()
            return RecordingIdentity(own.recording_name, own.recording_sha256)

    @property
    def layers(self) -> tuple[str, ...]:
        """All layers by name; one whose labels were all taken back is among them."""
        with self._database.reading() as connection:
            name = schema.layer.c.name
            return tuple(connection.execute(select(name).order_by(name)).scalars())

    def label(self, layer: str, labels: Sequence[CaptureLabels], author: Author) -> Action | None:
        """Label samples of any number of captures, as one action; NO_LABEL takes a label away.

        Of a sample that is given twice the last label counts. None, and nothing in the journal,
        where all are labelled so already.
        """
        name = checked_name(layer, "a layer")
        with self._database.writing() as connection:
            return append_labels(connection, name, labels, author)

    def undo(self, layer: str, annotator: str) -> Action | None:
        """Take back the annotator's last action in a layer that is not taken back yet.

        None where there is none. Raises LabelStoreError, and does nothing, where one of its labels
        was changed by somebody else since: theirs is never overwritten unseen.
        """
        name, person = checked_name(layer, "a layer"), checked_name(annotator, "an annotator")
        with self._database.writing() as connection:
            return append_inverse(connection, name, "undo", person)

    def redo(self, layer: str, annotator: str) -> Action | None:
        """Take back the annotator's last undo in a layer, unless they have labelled since. Returns
        and raises as ``undo``."""
        name, person = checked_name(layer, "a layer"), checked_name(annotator, "an annotator")
        with self._database.writing() as connection:
            return append_inverse(connection, name, "redo", person)

    def tops(self, layer: str, annotator: str) -> StackTops:
        """Which actions ``undo`` and ``redo`` would take back; None where there is none."""
        name, person = checked_name(layer, "a layer"), checked_name(annotator, "an annotator")
        with self._database.reading() as connection:
            return find_tops(connection, name, person)

    def labels_of(self, layer: str, capture: Capture) -> CaptureLabels:
        """The labels of one capture; no samples where it has none."""
        with self._database.reading() as connection:
            return labels_of_capture(connection, checked_name(layer, "a layer"), capture, None)

    def labelled(self, layer: str) -> Iterator[CaptureLabels]:
        """All captures with labels, in the order of Capture, streamed from one state of the
        journal."""
        with self._database.reading() as connection:
            yield from all_labels(connection, checked_name(layer, "a layer"), None)

    def counts(self, layer: str) -> dict[Label, int]:
        """How many samples have each label. The first call counts all, later ones what is new."""
        name = checked_name(layer, "a layer")
        with self._counts_lock, self._database.reading() as connection:
            head = newest_action(connection)
            if name in self._counts:
                counted_to, counts = self._counts[name]
                counts.update(count_between(connection, name, counted_to, head))
            else:
                counts = count_codes(connection, name)
            self._counts[name] = head, counts
            return {label: counts[label] for label in Label}

    def head(self) -> int:
        """The newest action's number, 0 where there is none: where it moved, somebody has acted."""
        with self._database.reading() as connection:
            return newest_action(connection)

    def actions(self, layer: str | None = None, after: int = 0) -> Iterator[Action]:
        """The actions with numbers above ``after``, in order, streamed; of one layer, or of all."""
        with self._database.reading() as connection:
            name = None if layer is None else checked_name(layer, "a layer")
            yield from stream_actions(connection, name, after)

    def changes_of(self, action_id: int) -> tuple[CaptureChange, ...]:
        """What an action changed, by captures; nothing where there is no such action."""
        with self._database.reading() as connection:
            return changes_of_action(connection, action_id)

    def layer(self, name: str) -> LayerView:
        """A layer as it is now, for a run: what is labelled later does not enter it.

        Raises LabelStoreError where there is none of this name.
        """
        name = checked_name(name, "a layer")
        if name not in (there := self.layers):
            raise LabelStoreError(
                f"has no layer {name}.",
                file=self.place,
                advice=f"There is {', '.join(there)}." if there else "It has no labels yet.",
            )
        return LayerView(self._database, name, self.head())

    def remember_digests(self, digests: Mapping[FileState, str]) -> None:
        """Keep digests of the recording's files for the next opening, if the store can be
        written."""
        if not self.read_only_because:
            remember_digests(self._database, digests)
