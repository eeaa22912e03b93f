"""``scanloom batch``: a command over many recordings, on the cores of this machine or a cluster."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.options import (
    WORKERS_MAX,
    JsonFlag,
    SettingsOption,
    WrongUsage,
    require_in_range,
    require_integer,
)
from scanloom.commands.reports import Report

_MEMORY_MAX_GIB = 65_536.0
_CACHE_MIN_GIB, _CACHE_MAX_GIB = 0.001, 1_000_000.0


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Run info, fuse, map or evaluate over many recordings. Called again, it does only what failed
    or has changed."""

    recordings: Annotated[
        conf.Positional[tuple[str, ...]],
        conf.arg(metavar="RECORDINGS", help_behavior_hint=""),
    ] = ()
    """Recordings, folders that are searched for recordings, patterns, addresses such as
    s3://bucket/robot_1, or the root of a Robot@Home data set, each room of which is one."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results: of each recording runs/NAME, and outcomes/NAME.json; of all of
    them batch.parquet, a row for each, and report.html."""
    run_command: Annotated[Literal["info", "fuse", "map", "evaluate"], conf.arg(name="run")]
    """The command. Its own options follow --, as in `--run fuse -- --no-figures`; {recording},
    {name} and {stem} in their values stand for each recording's path, its NAME and its file's name
    without the suffix."""
    list: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """A text file with one recording a line, besides RECORDINGS."""
    scheduler: Annotated[str | None, conf.arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """A Dask scheduler that runs, such as tcp://10.0.0.5:8786, whose workers see DIR and the
    recordings under the same paths (default: workers of this machine)."""
    workers: Annotated[int | None, conf.arg(metavar="N", help_behavior_hint="")] = None
    """Worker processes of this machine (default: one a core)."""
    memory_gib: Annotated[float | None, conf.arg(metavar="GIB", help_behavior_hint="")] = None
    """Memory of a worker process of this machine, which is ended above it (default: all of the
    machine's, shared out)."""
    settings: SettingsOption = None
    """A TOML file whose table [fleet] says from when on a recording is flagged, such as
    angle_shift_min_deg = 0.2."""
    workbench: Annotated[str | None, conf.arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """The address of a workbench, such as http://127.0.0.1:8080: report.html then has links that
    open each recording in it."""
    cache: Annotated[Path | None, conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Where remote recordings are copied to while they are read (default: ~/.cache/scanloom)."""
    cache_gib: Annotated[float, conf.arg(metavar="GIB")] = 20.0
    """The most that these copies take on a machine."""
    command_options: conf.Suppress[tuple[str, ...]] = ()
    json: JsonFlag = False

    def run(self, progress: Progress) -> Report:
        require_integer("--workers", self.workers, WORKERS_MAX, least=1)
        require_in_range("--memory-gib", 0.01, _MEMORY_MAX_GIB, self.memory_gib)
        link = None if self.workbench is None else _link_to(self.workbench)
        require_in_range("--cache-gib", _CACHE_MIN_GIB, _CACHE_MAX_GIB, self.cache_gib)
        from scanloom.commands.batch_call import parse_call

        call = parse_call(self.run_command, self.command_options)
        from fusion_core.workflows.batch.batch import run_batch, stored_outcomes
        from fusion_core.workflows.batch.items import common_folder, find_items
        from fusion_core.workflows.batch.report import load_fleet_settings, write_report
        from fusion_core.workflows.batch.settings import BatchSettings

        fleet = load_fleet_settings(self.settings)
        items = find_items(self.recordings, self.list, self.output)
        settings = BatchSettings(
            workers=self.workers or 0,
            memory_gib=self.memory_gib or 0.0,
            cache_gib=self.cache_gib,
        )
        summary = run_batch(
            items,
            call,
            self.output,
            settings,
            scheduler=self.scheduler,
            cache_folder=self.cache,
            progress=progress,
        )
        report = write_report(
            self.output,
            stored_outcomes(self.output, items),
            settings=fleet,
            recordings=common_folder(items),
            link=link,
            progress=progress,
        )
        return Report(
            result={**summary.to_json(), **report.to_json()},
            lines=[*summary.lines(), *report.lines()],
            failed=bool(summary.failures),
        )


def _link_to(address: str) -> Callable[[str], str]:
    """The address of a recording's view in a workbench. Raises WrongUsage."""
    parts = urlsplit(address)
    if parts.scheme not in ("http", "https") or not parts.netloc:
        raise WrongUsage(f"--workbench {address}: give an address as http://127.0.0.1:8080")
    from scanloom.state.view import View

    base = f"{parts.scheme}://{parts.netloc}"
    return lambda recording: f"{base}/go?view={View(recording=recording).to_link()}"


def split_options(args: Sequence[str]) -> tuple[Sequence[str], tuple[str, ...]]:
    """The arguments of ``scanloom batch`` before ``--``, and those of its command behind it."""
    if not args or args[0] != "batch" or "--" not in args:
        return args, ()
    at = list(args).index("--")
    return args[:at], tuple(args[at + 1 :])
