"""How a stage declares its settings: one frozen class beside the stage, each field with its unit,
range and one line of help. The same declaration feeds the command line, the settings file, the
sliders and the documentation.
"""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class StageSettings(BaseModel):
    """Base of every stage's settings: frozen, and an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


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
) -> Any:
    """A field with its default, one line of help, unit and range."""
    text = f"{help} [{unit}]" if unit else help
    return Field(default, description=text, ge=ge, le=le, gt=gt, json_schema_extra={"unit": unit})
