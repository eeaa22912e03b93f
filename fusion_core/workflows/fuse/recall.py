"""Fig. 6 of Xu 2024 for an aligned recording with its truth, under the current settings."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

from fusion_core.evaluation.associated_truth import associate_truth
from fusion_core.evaluation.fuse_folder import open_fuse_folder
from fusion_core.evaluation.recall_curve import PAPER_BAND, RecallCurve, recall_over_epsilon
from fusion_core.evaluation.truth import Truth, load_truth
from fusion_core.exporting.tables import CsvTable, ParquetTable
from fusion_core.model.progress import Progress, silent
from fusion_core.simulation.truth import truth_path
from fusion_core.workflows.evaluate.evaluate import EPSILON_OVER_E
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.pairing import PairedImage
from fusion_core.workflows.fuse.settings import ChainSettings
from fusion_core.workflows.fuse.tables import (
    FRAME_COLUMNS,
    alignment_document,
    frame_row,
    sample_columns,
    sample_schema,
    unpaired_row,
)

__all__ = ["PAPER_BAND", "RecallCurve", "recall_of", "truth_beside"]


def truth_beside(recording: Path) -> Path | None:
    """The truth file beside a recording, under its name; None where there is none."""
    truth = truth_path(recording)
    return truth if truth.is_file() else None


def recall_of(
    chain: CachedChain,
    settings: ChainSettings,
    truth: Path,
    clock_offset_ms: float = 0.0,
    progress: Progress = silent,
) -> RecallCurve:
    """The recalls of a whole recording; they do not depend on the settings of the classes.

    Raises ScanLoomError where the truth is invalid, or of another recording.
    """
    known = load_truth(truth)
    with TemporaryDirectory(prefix="scanloom-") as name:
        folder = Path(name)
        _write_alignment(chain, folder, known)
        _write_frames(chain, settings, clock_offset_ms, folder, progress)
        return recall_over_epsilon(folder, known, EPSILON_OVER_E)


def _write_alignment(chain: CachedChain, folder: Path, known: Truth) -> None:
    session = chain.session
    document = alignment_document(
        chain.alignment, session.rig, "", virtual=session.virtual_row is not None, notes=[]
    )
    (folder / "alignment.json").write_text(json.dumps(document), encoding="utf-8")
    # Fails before any frame is read where the truth is of another recording.
    associate_truth(known, open_fuse_folder(folder))


def _write_frames(
    chain: CachedChain,
    settings: ChainSettings,
    clock_offset_ms: float,
    folder: Path,
    progress: Progress,
) -> None:
    """The tables of ``fuse`` that are compared with the truth."""
    rig = chain.session.rig
    with (
        CsvTable(folder / "frames.csv", FRAME_COLUMNS) as frames,
        ParquetTable(folder / "samples.parquet", sample_schema()) as samples,
    ):
        for done, entry in enumerate(chain.fuse_all(settings, clock_offset_ms)):
            progress(done, len(chain.frames), "comparing with the truth")
            if isinstance(entry, PairedImage):
                frames.append(unpaired_row(rig.cameras[entry.camera].topic, entry))
            else:
                topic = entry.match.pair.camera.topic
                frames.append(frame_row(topic, entry, chain.alignment, rig))
                samples.append(sample_columns(topic, entry, rig))
