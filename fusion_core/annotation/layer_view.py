"""A layer as it was after one action: later labels do not change what a long run reads."""

import hashlib
from functools import cached_property

from fusion_core.annotation.database import Database
from fusion_core.annotation.labels_in_force import all_labels, labels_of_capture
from fusion_core.model.labels import Capture, CaptureLabels


class LayerView:
    """A LabelLayer. ``upto``: the number of the newest action that counts."""

    def __init__(self, database: Database, name: str, upto: int) -> None:
        self._database = database
        self.name = name
        self.upto = upto

    @cached_property
    def sha256(self) -> str:
        """Digest of all labels in the order of captures, rows and columns, whatever the actions
        that led there. The first call reads them all."""
        digest = hashlib.sha256()
        with self._database.reading() as connection:
            for labels in all_labels(connection, self.name, self.upto):
                # The number of samples keeps the parts apart.
                digest.update(f"{labels.capture!r} {len(labels.row)}\\n".encode())
                for array in (labels.row, labels.column, labels.label):
                    digest.update(array.astype("<i8").tobytes())
        return digest.hexdigest()

    def labels_of(self, capture: Capture) -> CaptureLabels:
        """The labels of one capture; no samples where it has none."""
        with self._database.reading() as connection:
            return labels_of_capture(connection, self.name, capture, self.upto)
