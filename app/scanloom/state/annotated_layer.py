"""The layer that a person labels in, among the other layers of the recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fusion_core.model.labels import CaptureLabels, Label
from fusion_core.workflows.labels.open_store import Author
from scanloom.state.frame_runs import FrameRuns
from scanloom.state.recording_labels import RecordingLabels
from scanloom.state.review_choices import ReviewChoices


@dataclass(frozen=True, slots=True, kw_only=True)
class AnnotatedLayer:
    """The layer ``name`` of ``labels``, in which ``annotator`` labels. What writes raises
    ScanLoomError where it cannot be written."""

    labels: RecordingLabels
    annotator: str
    name: str

    @property
    def others(self) -> tuple[str, ...]:
        """All other layers."""
        return tuple(layer for layer in self.labels.layers if layer != self.name)

    def gold(self, choices: ReviewChoices) -> str:
        """The layer of known answers; empty for none."""
        return choices.gold_layer if choices.gold_layer in self.others else ""

    def told(self, choices: ReviewChoices) -> tuple[str, ...]:
        """The other layers that the person may know of: all but that of known answers."""
        gold = self.gold(choices)
        return tuple(layer for layer in self.others if layer != gold)

    def words(self, layer: str, runs: FrameRuns, run: int) -> str:
        """What a layer says of a run, in words; empty for nothing."""
        image = self.labels.labels_of(layer, runs.capture(run)).as_image()
        own = runs.samples(run)
        codes, counts = np.unique(image[runs.row[own], runs.column[own]], return_counts=True)
        said = {Label(c).name.lower(): int(n) for c, n in zip(codes, counts, strict=True) if c >= 0}
        if len(codes) == 1:
            return "".join(said)
        return ", ".join(f"{name} {count}" for name, count in said.items())

    def write(self, labels: Sequence[CaptureLabels], settings_sha256: str, comment: str) -> None:
        """Label samples, as one action. ``settings_sha256``: of the settings that are displayed."""
        self.labels.label(self.name, labels, self._author(settings_sha256, comment))

    def majority(self, layers: Sequence[str], least_decisions: int) -> int:
        """How many samples ``adjudicate`` would label."""
        added = self.labels.majority(layers, self.name, least_decisions)
        return sum(labels.label.size for labels in added)

    def adjudicate(self, layers: Sequence[str], settings_sha256: str, least_decisions: int) -> int:
        """Label what has no label here as most of the layers say, where so many of them decided, in
        one action; how many samples."""
        comment = f"what most say of {', '.join(layers)}"
        author = replace(self._author(settings_sha256, comment), source="automatic")
        return self.labels.adjudicate(layers, self.name, author, least_decisions)

    def undo(self) -> bool:
        """Take back the person's last action; whether there was one."""
        return self.labels.undo(self.name, self.annotator)

    def redo(self) -> bool:
        """Do again what was taken back last; whether there was anything."""
        return self.labels.redo(self.name, self.annotator)

    def _author(self, settings_sha256: str, comment: str) -> Author:
        return Author(annotator=self.annotator, settings_sha256=settings_sha256, comment=comment)
