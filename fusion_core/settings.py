"""How a stage declares its settings: one frozen class beside the stage, each field with its unit,
range and one line of help. The same declaration feeds the command line, the settings file, the
sliders and the documentation.

Every number has a lower and an upper bound: settings come in links and files of strangers, and
whatever passes must take a bounded time and memory. Where it is a product of several settings that
makes the work, the class checks the product.
"""

import re
from collections.abc import Mapping
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator


class StageSettings(BaseModel):
    """Base of every stage's settings: frozen, and an unknown key is an error.

    A ``..._min...`` must be less than the ``..._max...`` of the same name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="after")
    def _ends_in_order(self) -> Self:
        for low, high in ends(type(self)):
            if getattr(self, low) >= getattr(self, high):
                raise ValueError(
                    f"{low} = {getattr(self, low):g} must be less than "
                    f"{high} = {getattr(self, high):g}"
                )
        return self


class SettingsGroup(StageSettings):
    """Several stages' settings under their names."""

    def stages(self) -> dict[str, StageSettings]:
        """Each stage's settings by name, for the settings file."""
        return {
            name: value
            for name in type(self).model_fields
            if isinstance(value := getattr(self, name), StageSettings)
        }


def setting(
    default: Any,
    help: str,
    *,
    unit: str = "",
    ge: float | None = None,
    le: float | None = None,
    gt: float | None = None,
    formerly: str = "",
) -> Any:
    """A field with its default, one line of help, unit and range.

    ``formerly``: the name that the field had in settings files and links of earlier versions.
    """
    text = f"{help} [{unit}]" if unit else help
    return Field(
        default,
        description=text,
        ge=ge,
        le=le,
        gt=gt,
        json_schema_extra={"unit": unit, "formerly": formerly},
    )


def under_current_names(
    settings_class: type[StageSettings], given: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, str]]:
    """``given`` with each key under the name it has today, and the keys that were renamed.

    The second value maps former names to current ones. A former name beside the current one is
    left as it is: an unknown key.
    """
    current = {
        str(extra["formerly"]): name
        for name, field in settings_class.model_fields.items()
        if isinstance(extra := field.json_schema_extra, dict) and extra.get("formerly")
    }
    renamed = {name: current[name] for name in given if name in current}
    renamed = {former: name for former, name in renamed.items() if name not in given}
    return {renamed.get(name, name): value for name, value in given.items()}, renamed


def ends(settings_class: type[StageSettings]) -> list[tuple[str, str]]:
    """The fields that are the two ends of one range, by their names: (..._min..., ..._max...)."""
    names = settings_class.model_fields
    return [
        (low, high)
        for low in names
        if (high := re.sub(r"(?<![a-z])min(?![a-z])", "max", low)) != low and high in names
    ]
