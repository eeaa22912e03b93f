"""The subcommands of ``scanloom``.

Each has a file of its own name, with its options as a dataclass and ``run``: options to one call of
a workflow to a report. Workflows are imported inside ``run``, so that ``--help`` is fast.
"""

from dataclasses import dataclass
from typing import Annotated

from tyro import conf

from scanloom.commands.batch import Batch
from scanloom.commands.calibrate import Calibrate
from scanloom.commands.convert import Convert
from scanloom.commands.evaluate import Evaluate
from scanloom.commands.fuse import Fuse
from scanloom.commands.info import Info
from scanloom.commands.labels import Labels
from scanloom.commands.map import Map
from scanloom.commands.sample import Sample
from scanloom.commands.view import View


@dataclass(frozen=True, kw_only=True)
class Scanloom:
    """Align a 2D LiDAR with the rows of a depth image, classify the noise, repair each sensor from
    the other, and build the fused map. `scanloom --version` prints the version.
    """

    command: conf.OmitSubcommandPrefixes[
        Annotated[View, conf.subcommand("view")]
        | Annotated[Info, conf.subcommand("info")]
        | Annotated[Convert, conf.subcommand("convert")]
        | Annotated[Fuse, conf.subcommand("fuse")]
        | Annotated[Map, conf.subcommand("map")]
        | Annotated[Calibrate, conf.subcommand("calibrate")]
        | Annotated[Evaluate, conf.subcommand("evaluate")]
        | Annotated[Batch, conf.subcommand("batch")]
        | Annotated[Labels, conf.subcommand("labels")]
        | Annotated[Sample, conf.subcommand("sample")]
    ]
