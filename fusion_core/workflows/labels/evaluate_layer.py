"""``scanloom evaluate labels``: a recording's classes against a layer, and better thresholds."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import LabelLayer
from fusion_core.model.progress import Progress, silent
from fusion_core.workflows.fuse.align import align_recording
from fusion_core.workflows.fuse.cached_chain import CachedChain
from fusion_core.workflows.fuse.frame_reader import FrameReader
from fusion_core.workflows.fuse.session import FuseOptions, open_session
from fusion_core.workflows.fuse.settings import chain_settings
from fusion_core.workflows.labels.labelled_frames import LabelledFrame, labelled_frames
from fusion_core.workflows.labels.measures import measure_classes, recall_by_labels
from fusion_core.workflows.labels.suggestions import suggest_thresholds
from fusion_core.workflows.source import open_source


def evaluate_layer(
    recording: Path,
    layer: LabelLayer,
    options: FuseOptions,
    *,
    suggest: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Precision and recall of the automatic classes, the recalls over epsilon and, if asked for,
    suggestions, all against the labels of a layer.

    Of ``options``: the preset, the settings file, the seed and the topics. Raises ScanLoomError
    where no frame of the recording has a label, and as ``fuse``.
    """
    _, settings = chain_settings(options.preset, options.settings_file, options.seed)
    with open_source(recording, options.room) as opened:
        session = open_session(opened, options, settings)
        alignment = align_recording(session, progress)
        session = alignment.on_rig(session)
        chain = CachedChain(session, FrameReader(session), alignment)

        def frames() -> Iterator[LabelledFrame]:
            return labelled_frames(chain, settings, layer, progress=progress)

        if next(frames(), None) is None:
            raise ScanLoomError(
                f"the layer {layer.name} has no label on a frame that can be matched.",
                file=recording,
                advice="Label beams or pixels of it, or name another layer.",
            )
        result: dict[str, Any] = {
            "layer": layer.name,
            "classes": measure_classes(frames(), chain.alignment, settings).to_json(),
            "over_epsilon": recall_by_labels(frames()).to_json(),
        }
        if suggest:
            result["suggestions"] = {
                own.setting: None if own.fit is None else own.fit.to_json()
                for own in suggest_thresholds(frames(), chain.alignment, settings)
            }
    return result
