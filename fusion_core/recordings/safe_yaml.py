"""Small YAML files from untrusted sources, read within bounds of size and depth."""

from math import isfinite
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

# Calibrations and map descriptions nest two or three levels.
_MAX_NESTING = 16


def load_yaml(text: str) -> Any:
    """The content of a YAML text. Raises ValueError, saying why, for what is not read.

    Aliases and deep nesting are refused: both could make a small file grow without bounds.
    """
    yaml = YAML(typ="safe", pure=True)
    try:
        # Events come without recursion and without following aliases.
        depth = 0
        for event in yaml.parse(text):
            if isinstance(event, AliasEvent):
                raise ValueError("it uses aliases")
            depth += isinstance(event, CollectionStartEvent)
            depth -= isinstance(event, CollectionEndEvent)
            if depth > _MAX_NESTING:
                raise ValueError("it is nested too deeply")
        return yaml.load(text)
    except YAMLError as error:
        problem = " ".join(str(error).split())
        raise ValueError(f"it is no YAML: {problem}") from error


def require_number(mapping: dict[Any, Any], key: str, default: float | None = None) -> float:
    """The finite number under a key. Raises ValueError for anything else."""
    value = mapping.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise ValueError(f"{key} is missing or no finite number")
    return float(value)
