"""The command that a batch runs on each recording, parsed from the options behind ``--``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path, PurePosixPath
from typing import Any

import tyro

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.names import escape_undecodable
from fusion_core.model.progress import silent
from fusion_core.workflows.batch.items import BatchItem
from fusion_core.workflows.batch.outcome import BatchCommand
from fusion_core.workflows.batch.task import CallResult
from scanloom.commands.evaluate import (
    Evaluate,
    EvaluateAlignment,
    EvaluateLabels,
    EvaluateMap,
    EvaluateNoise,
    EvaluateOdometry,
    EvaluateRelations,
    EvaluateRepair,
    EvaluateTrajectory,
)
from scanloom.commands.fuse import Fuse
from scanloom.commands.info import Info
from scanloom.commands.map import Map
from scanloom.commands.options import PARSER_CONFIG, WrongUsage

_Parsed = (
    Info
    | Fuse
    | Map
    | EvaluateAlignment
    | EvaluateLabels
    | EvaluateMap
    | EvaluateNoise
    | EvaluateOdometry
    | EvaluateRelations
    | EvaluateRepair
    | EvaluateTrajectory
)
_RECORDING, _OUTPUT = "{recording}", "{output}"
_PLACEHOLDERS = ("recording", "name", "stem")
_NO_OPTIONS = {
    *("recording", "output", "json", "force", "overwrite", "home", "room", "subsession", "workers")
}


@dataclass(frozen=True, kw_only=True)
class CommandCall:
    """A command as it was parsed, with ``{recording}``, ``{name}`` and ``{stem}`` in its values.

    ``folder``: that relative paths start from.
    """

    command: BatchCommand
    parsed: _Parsed
    folder: Path

    @property
    def is_repeated(self) -> bool:
        """With --force; and with labels, which change without a file that changes."""
        return bool(getattr(self.parsed, "force", False) or getattr(self.parsed, "labels", None))

    def options(self) -> dict[str, Any]:
        """What determines the results, ready for JSON."""
        named = {"measure": type(self.parsed).__name__}
        return named | {
            field.name: escape_undecodable(str(getattr(self.parsed, field.name)))
            for field in fields(self.parsed)
            if field.name not in _NO_OPTIONS
        }

    def files(self, item: BatchItem) -> tuple[Path, ...]:
        """The paths among the options."""
        return tuple(
            self._path(value, item, Path(item.place))
            for field in fields(self.parsed)
            if isinstance(value := getattr(self.parsed, field.name), Path)
            and str(value) not in (_RECORDING, _OUTPUT)
        )

    def run(self, item: BatchItem, recording: Path, output: Path) -> CallResult:
        """Run the command. Raises ScanLoomError."""
        given: dict[str, Any] = {
            field.name: self._value(getattr(self.parsed, field.name), item, recording)
            for field in fields(self.parsed)
        }
        if "output" in given:
            given["output"] = output
        if "workers" in given:
            # The batch has a process for each core already.
            given["workers"] = 1
        if item.room is not None and not isinstance(self.parsed, Info | Fuse | Map):
            raise ScanLoomError(
                "is a room of a data set, which evaluate does not open.", file=recording
            )
        if item.room is not None:
            room = item.room
            given |= {"home": room.session, "room": room.room, "subsession": room.subsession}
        try:
            report = replace(self.parsed, **given).run(silent)
        except WrongUsage as error:
            raise ScanLoomError(f"{error}.", file=recording) from error
        damage = "is damaged, as the check found." if report.failed else None
        return CallResult(result=report.result, damage=damage)

    def _value(self, value: Any, item: BatchItem, recording: Path) -> Any:
        if isinstance(value, Path):
            return self._path(value, item, recording)
        if isinstance(value, str):
            return _filled(value, item, recording)
        return value

    def _path(self, value: Path, item: BatchItem, recording: Path) -> Path:
        return self.folder / _filled(str(value), item, recording)


def parse_call(command: BatchCommand, options: Sequence[str]) -> CommandCall:
    """The command with ``options``, which are those that it takes by itself.

    Raises WrongUsage; help, and wrong usage that the parser finds, leave by SystemExit.
    """
    parsed: _Parsed
    if command == "evaluate":
        parsed = _parse(Evaluate, command, options).measure
    elif command == "info":
        parsed = _parse(Info, command, [_RECORDING, *options])
    else:
        own_class: type[Fuse | Map] = Fuse if command == "fuse" else Map
        parsed = _parse(own_class, command, [_RECORDING, "-o", _OUTPUT, *options])
    given = {field.name: getattr(parsed, field.name) for field in fields(parsed)}
    _require_placeholders(command, [str(value) for value in given.values()])
    if isinstance(parsed, Info | Fuse | Map):
        parsed.require_usage()
        if parsed.home is not None:
            raise WrongUsage("a batch takes each room of a data set: leave --home and --room out")
        if given.get("workers") is not None:
            raise WrongUsage("a batch has one --workers, before the --: recordings are shared out")
        if given.get("output", Path(_OUTPUT)) != Path(_OUTPUT):
            raise WrongUsage(
                "a batch has one -o, before the --: each recording gets a folder there"
            )
    return CommandCall(command=command, parsed=parsed, folder=Path.cwd())


def _parse(own_class: type[Any], command: str, args: Sequence[str]) -> Any:
    prog = f"scanloom batch ... --run {command} --"
    return tyro.cli(own_class, prog=prog, args=args, config=PARSER_CONFIG)


def _require_placeholders(command: str, values: Sequence[str]) -> None:
    names = [name for value in values for name in re.findall(r"\{(\w*)\}", value)]
    for name in names:
        if name not in (*_PLACEHOLDERS, "output"):
            known = ", ".join(f"{{{each}}}" for each in _PLACEHOLDERS)
            raise WrongUsage(f"{{{name}}} stands for nothing: use {known}")
    if command == "evaluate" and not names:
        raise WrongUsage(
            "evaluate would do the same for each recording: use {recording}, {name} or {stem} in "
            "its options"
        )


def _filled(text: str, item: BatchItem, recording: Path) -> str:
    stem = PurePosixPath(item.place).stem if item.room is None else str(item.room)
    values = {"recording": str(recording), "name": item.name, "stem": stem}
    return re.sub(r"\{(\w*)\}", lambda match: values.get(match[1], match[0]), text)
