"""The settings of a run as TOML: one table for each stage, each key with its help beside it."""

import json
import logging
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import tomlkit
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from fusion_core.files.regular_file import read_regular
from fusion_core.model.errors import SettingsError
from fusion_core.settings import StageSettings, under_current_names

_log = logging.getLogger(__name__)
_PRESET_KEY = "preset"
_TOO_MUCH = "holds a number of thousands of digits, or is nested too deeply"
_LONGEST_SHOWN = 80
# All stages with their help take some 20 kB.
_MAX_BYTES = 1 << 20
_BOUND_NAMES = {"ge": "at least", "gt": "more than", "le": "at most", "lt": "less than"}


def dump_toml(stages: Mapping[str, StageSettings], preset: str) -> str:
    """Every setting of every stage, so that the file alone repeats the run."""
    document = tomlkit.document()
    document.add(_PRESET_KEY, tomlkit.item(preset))
    for stage, settings in stages.items():
        table = tomlkit.table()
        values = settings.model_dump(mode="json")
        for name, field in type(settings).model_fields.items():
            allowed = _describe_range(field)
            table.add(tomlkit.comment(f"{field.description}{f': {allowed}' if allowed else ''}"))
            if values[name] is None:
                # TOML has no null: a key that is left out takes its default.
                table.add(tomlkit.comment(f"{name} is not set"))
            else:
                table.add(name, tomlkit.item(values[name]))
        document.add(tomlkit.nl())
        document.add(stage, table)
    return tomlkit.dumps(document)


def read_preset(path: Path) -> str | None:
    """The preset that a settings file starts from, None where it names none."""
    preset = _read(path).get(_PRESET_KEY)
    if preset is not None and not isinstance(preset, str):
        raise SettingsError(f"preset must be text, got {_abbreviate(preset)}.", file=path)
    return preset


def load_toml(
    path: Path,
    stages: Mapping[str, type[StageSettings]],
    base: Mapping[str, StageSettings] | None = None,
) -> dict[str, StageSettings]:
    """The settings of every stage in ``stages``; what the file leaves out comes from ``base``.

    Without ``base``, or for a stage it lacks, the defaults are used. A key under its name of an
    earlier version is read, with a logged warning that gives the new name. Raises SettingsError,
    with the file, key, value and allowed range, for unknown stages and keys, wrong types and values
    out of range.
    """
    document = _read(path)
    document.pop(_PRESET_KEY, None)
    for stage, table in document.items():
        if stage not in stages:
            raise SettingsError(
                f"unknown stage {_abbreviate(stage)}.",
                file=path,
                advice=f"Stages: {', '.join(stages)}.",
            )
        if not isinstance(table, dict):
            raise SettingsError(f"{stage} must be a table, got {_abbreviate(table)}.", file=path)
    result = {}
    for stage, settings_class in stages.items():
        given, renamed = under_current_names(settings_class, document.get(stage, {}))
        for former, name in renamed.items():
            _log.warning("%s: %s.%s is now called %s.%s.", path, stage, former, stage, name)
        start = {} if base is None or stage not in base else base[stage].model_dump(mode="json")
        for name, value in given.items():
            if _to_json(value) is None:
                raise SettingsError(
                    f"{stage}.{name} = {_abbreviate(value)}: {_TOO_MUCH}.", file=path
                )
        # Strict validation of JSON accepts a list for a tuple and text for an enum member, but
        # not text for a number.
        text = json.dumps(start | given, default=str)
        try:
            result[stage] = settings_class.model_validate_json(text, strict=True)
        except ValidationError as error:
            raise _settings_error(path, stage, settings_class, given, error) from error
    return result


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_regular(path, _MAX_BYTES).decode())
    except OSError as error:
        raise SettingsError(f"cannot be read: {error.strerror}.", file=path) from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"is not TOML: {error}.", file=path) from error
    except ValueError as error:
        # Python refuses a decimal number of thousands of digits.
        raise SettingsError(f"{_TOO_MUCH}.", file=path) from error


def _to_json(value: object) -> str | None:
    """A value as JSON, None where its number is too long or its nesting too deep."""
    try:
        return json.dumps(value, default=str)
    except (ValueError, RecursionError):
        return None


def _abbreviate(value: object) -> str:
    """A value as text that fits a message of one line."""
    text = "..." if _to_json(value) is None else repr(value)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."


def first_problem(error: ValidationError) -> str:
    """The first problem, without the prefix that pydantic puts before our own messages."""
    return error.errors(include_url=False)[0]["msg"].removeprefix("Value error, ")


def _settings_error(
    path: Path,
    stage: str,
    settings_class: type[StageSettings],
    given: Mapping[str, Any],
    error: ValidationError,
) -> SettingsError:
    first = error.errors(include_url=False)[0]
    fields = settings_class.model_fields
    if not first["loc"]:
        return SettingsError(f"{stage}: {first_problem(error)}.", file=path)
    name = str(first["loc"][0])
    if first["type"] == "extra_forbidden":
        return SettingsError(
            f"unknown key {stage}.{name[:_LONGEST_SHOWN]}.",
            file=path,
            advice=f"Keys: {', '.join(fields)}.",
        )
    allowed = _describe_range(fields[name])
    return SettingsError(
        f"{stage}.{name} = {_abbreviate(given.get(name, first['input']))}: {first_problem(error)}.",
        file=path,
        advice=f"Allowed: {allowed}." if allowed else "",
    )


def _describe_range(field: FieldInfo) -> str:
    """The choices or the range of a field as text, empty where any value of its type is allowed."""
    if get_origin(field.annotation) is Literal:
        return " | ".join(str(choice) for choice in get_args(field.annotation))
    bounds = [
        f"{words} {bound}"
        for name, words in _BOUND_NAMES.items()
        for constraint in field.metadata
        if (bound := getattr(constraint, name, None)) is not None
    ]
    return ", ".join(bounds)
