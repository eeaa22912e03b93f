"""``scanloom labels``: what people say of beams and pixels, from and to files, and in figures."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro import conf

from fusion_core.model.progress import Progress
from fusion_core.model.seeds import SEED_MAX
from scanloom.commands.label_reports import (
    agreement_lines,
    export_lines,
    import_lines,
    log_lines,
    merge_lines,
    statistics_lines,
)
from scanloom.commands.options import Flag, JsonFlag, RecordingArgument, require_integer
from scanloom.commands.reports import Report

FormatName = Literal["csv", "jsonl", "parquet", "coco", "png", "semantic-kitti"]

_RESAMPLES_MAX = 1_000_000
_ACTIONS_MAX = 1_000_000_000

LayerOption = Annotated[str | None, conf.arg(metavar="LAYER", help_behavior_hint="")]
LayersOption = Annotated[
    conf.UseAppendAction[tuple[str, ...]], conf.arg(metavar="LAYER", help_behavior_hint="")
]


@dataclass(frozen=True, kw_only=True)
class _OfRecording:
    recording: RecordingArgument
    """The recording that the labels are of."""
    labels: Annotated[
        str | None,
        conf.arg(aliases=["--label-store"], metavar="ADDRESS", help_behavior_hint=""),
    ] = None
    """The label store: a file, or postgresql://USER@HOST/DATABASE (default: beside the
    recording)."""
    json: JsonFlag = False


@dataclass(frozen=True, kw_only=True)
class ExportLabels(_OfRecording):
    """Write a layer as a file or folder: csv, jsonl and parquet hold all labels, coco and png those
    of depth images, semantic-kitti those of scans."""

    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="PATH")]
    """The file or folder to write."""
    layer: LayerOption = None
    """The layer (default: the only one)."""
    format: Annotated[FormatName | None, conf.arg(help_behavior_hint="")] = None
    """Its format (default: by the suffix .csv, .jsonl, .parquet or .json)."""
    overwrite: Flag = False
    """Replace an existing file, or write into a folder that holds other files."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.labels.export_labels import ExportOptions, export_labels

        options = ExportOptions(
            address=self.labels, layer=self.layer, format=self.format, overwrite=self.overwrite
        )
        result = export_labels(self.recording, self.output, options, progress)
        return Report(result=result, lines=export_lines(result))


@dataclass(frozen=True, kw_only=True)
class ImportLabels(_OfRecording):
    """Bring in what export has written of the same recording, as one action. Exit code 1, and
    nothing done, if the layer would lose or change a label, unless --replace."""

    file: Annotated[conf.Positional[Path], conf.arg(metavar="FILE")]
    """The file or folder of labels."""
    layer: LayerOption = None
    """The layer to label (default: that of the file)."""
    annotator: Annotated[str, conf.arg(metavar="NAME")] = "import"
    """Who imports, and may undo it in the workbench."""
    replace: Flag = False
    """Make the layer as the file, also where labels change or are taken away; the journal keeps
    them."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.labels.import_labels import ImportOptions, import_labels

        options = ImportOptions(
            address=self.labels, layer=self.layer, annotator=self.annotator, replace=self.replace
        )
        result = import_labels(self.recording, self.file, options, progress)
        return Report(result=result, lines=import_lines(result), failed=not result["done"])


@dataclass(frozen=True, kw_only=True)
class MergeLabels(_OfRecording):
    """Bring in the layers of another label store of the same recording, each under its name. Exit
    code 1, and nothing done, if a label would change, unless --replace."""

    other: Annotated[conf.Positional[str], conf.arg(metavar="OTHER")]
    """The other store: a file, or postgresql://USER@HOST/DATABASE."""
    layer: LayersOption = ()
    """A layer to merge (default: all)."""
    annotator: Annotated[str, conf.arg(metavar="NAME")] = "import"
    """Who merges, and may undo it in the workbench."""
    replace: Flag = False
    """Where both stores label a sample, take the other one's label; the journal keeps both."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.labels.merge_stores import MergeOptions, merge_stores

        options = MergeOptions(
            address=self.labels, layers=self.layer, annotator=self.annotator, replace=self.replace
        )
        result = merge_stores(self.recording, self.other, options, progress)
        return Report(result=result, lines=merge_lines(result), failed=not result["done"])


@dataclass(frozen=True, kw_only=True)
class Agreement(_OfRecording):
    """How far layers agree: percent, Cohen's and Fleiss' kappa, Krippendorff's alpha, runs, and the
    confusion of classes, with 95 % intervals."""

    layer: LayersOption = ()
    """A layer to compare (default: all)."""
    resamples: Annotated[int, conf.arg(metavar="N")] = 1000
    """Draws of captures, from which the intervals come."""
    seed: int = 0
    """Seed of these draws."""

    def run(self, progress: Progress) -> Report:
        require_integer("--resamples", self.resamples, _RESAMPLES_MAX, least=1)
        require_integer("--seed", self.seed, SEED_MAX)
        from fusion_core.workflows.labels.compare_layers import compare_layers

        result = compare_layers(
            self.recording,
            self.labels,
            self.layer,
            progress,
            resamples=self.resamples,
            seed=self.seed,
        )
        return Report(result=result, lines=agreement_lines(result))


@dataclass(frozen=True, kw_only=True)
class LabelLog(_OfRecording):
    """The last actions in the journal, newest last."""

    layer: LayerOption = None
    """The layer (default: all)."""
    last: Annotated[int, conf.arg(metavar="N")] = 20
    """How many."""

    def run(self, progress: Progress) -> Report:
        require_integer("--last", self.last, _ACTIONS_MAX, least=1)
        from fusion_core.workflows.labels.read_journal import last_actions

        result = last_actions(self.recording, self.labels, self.layer, self.last, progress)
        return Report(result=result, lines=log_lines(result))


@dataclass(frozen=True, kw_only=True)
class LabelStatistics(_OfRecording):
    """Labels by layer and class, and what each annotator did, at which rate."""

    def run(self, progress: Progress) -> Report:
        from fusion_core.workflows.labels.read_journal import label_statistics

        result = label_statistics(self.recording, self.labels, progress)
        return Report(result=result, lines=statistics_lines(result))


@dataclass(frozen=True, kw_only=True)
class Labels:
    """Export, import, merge and compare what people say of single beams and pixels."""

    action: conf.OmitSubcommandPrefixes[
        Annotated[ExportLabels, conf.subcommand("export")]
        | Annotated[ImportLabels, conf.subcommand("import")]
        | Annotated[MergeLabels, conf.subcommand("merge")]
        | Annotated[Agreement, conf.subcommand("agreement")]
        | Annotated[LabelLog, conf.subcommand("log")]
        | Annotated[LabelStatistics, conf.subcommand("stats")]
    ]
