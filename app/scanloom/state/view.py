"""What one person looks at: the recording, the frame, the settings and how all that is shown.

A view is frozen and validated: whatever a browser, a link or a stored page sends becomes a view, or
an error in one line. It goes whole into a link, the settings as what differs from their preset.
"""

import base64
import binascii
import json
import math
import zlib
from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import SettingsError
from fusion_core.settings import under_current_names
from fusion_core.workflows.fuse.presets import PRESETS, ChainSettings, PresetName
from scanloom.state.slam_choices import SlamChoices

PanelName = Literal["Recording", "Match", "Register", "Repair", "Map"]
PANELS: tuple[PanelName, ...] = get_args(PanelName)
Scope = Literal["frame", "window", "recording"]
MapMode = Literal["Fuse", "SLAM"]
MAP_MODES: tuple[MapMode, ...] = get_args(MapMode)
_MAX_TEXT = 65_536
# Of what a person is told about the place of a refused value, which a link may have named.
_MOST_WHERE = 80
# Far beyond the samples of any curve and the rows of any image.
_FAR = 100_000.0
# Of frames and of beams. What is shown of them goes to browsers as numbers of 64 bits.
_MOST_COUNTED = 2**31 - 1
_INT64 = 2**63
# An integer of more digits has more than 64 bits, whatever they are.
_INT64_DIGITS = 19


class View(BaseModel):
    """One person's view of a recording. ``recording`` is its name in the library.

    ``settings`` are those of the frame that is shown, ``aligned`` those with which the whole
    recording was aligned: moving a slider does not align it again.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    recording: str = Field(max_length=4096)
    number: int = Field(0, ge=0, le=_MOST_COUNTED, description="Frame, counted from 0")
    panel: PanelName = "Recording"
    preset: PresetName = "default"
    settings: ChainSettings = PRESETS["default"]
    aligned: ChainSettings = PRESETS["default"]
    lidar_topic: str | None = Field(None, max_length=4096)
    depth_topics: tuple[str, ...] = Field((), max_length=64)
    virtual_row: int | None = Field(None, ge=0, le=100_000)
    apply_clock_offset: bool = False
    scope: Scope = "frame"
    picked: (
        tuple[Annotated[float, Field(ge=-_FAR, le=_FAR)], Annotated[float, Field(ge=0.0, le=_FAR)]]
        | None
    ) = Field(None, description="Offset (u, v) chosen by hand")
    lock_picked: bool = False
    draw: int = Field(0, ge=0, le=99_999, description="Draw of RANSAC, counted from 0")
    classes: frozenset[NoiseClass] = frozenset(NoiseClass)
    repaired: bool = Field(True, description="Show repaired values, else raw ones")
    both: bool = Field(True, description="Show raw and repaired depth images together")
    beam: int | None = Field(None, ge=0, le=_MOST_COUNTED, description="Beam that is looked at")
    row_step: int = Field(6, ge=1, le=60, description="Every so many rows of depth are drawn")
    speed: float = Field(1.0, ge=0.1, le=8.0)
    loop: bool = True
    map_mode: MapMode = "Fuse"
    slam: SlamChoices = SlamChoices()

    def with_setting(self, stage: str, name: str, value: Any) -> "View":
        """The view with one setting of one stage changed.

        Raises SettingsError, in one line, for a value that the stage refuses.
        """
        try:
            if stage == "":
                chain = self.settings.model_dump() | {name: value}
            else:
                chain = self.settings.model_dump()
                chain[stage] = chain[stage] | {name: value}
            settings = ChainSettings.model_validate(chain)
        except ValidationError as error:
            raise SettingsError(said(error), advice="The value before is kept.") from error
        return self.model_copy(update={"settings": settings})

    def changed(self, **values: Any) -> "View":
        """The view with other values. Raises SettingsError for one that is refused."""
        try:
            return View.model_validate(dict(self) | values)
        except ValidationError as error:
            raise SettingsError(said(error), advice="The value before is kept.") from error

    def needs_alignment(self) -> bool:
        """Whether settings that the alignment read were changed since."""
        stages = ("time", "sampling", "search", "mount", "pairing")
        return any(getattr(self.settings, s) != getattr(self.aligned, s) for s in stages)

    def differing(self, settings: ChainSettings | None = None) -> dict[str, dict[str, Any]]:
        """The settings that differ from the preset's, by stage; the chain's own under ""."""
        mine = (self.settings if settings is None else settings).model_dump()
        base = PRESETS[self.preset].model_dump()
        differing: dict[str, dict[str, Any]] = {}
        for stage, value in mine.items():
            if not isinstance(value, dict):
                if value != base[stage]:
                    differing.setdefault("", {})[stage] = value
                continue
            other = {name: v for name, v in value.items() if v != base[stage][name]}
            if other:
                differing[stage] = other
        return differing

    def to_link(self) -> str:
        """The view as text for a URL."""
        values = self.model_dump(mode="json", exclude={"settings", "aligned"})
        values["settings"] = self.differing()
        values["aligned"] = self.differing(self.aligned)
        # In a fixed order: the same view is the same link.
        values["classes"] = sorted(values["classes"])
        packed = zlib.compress(json.dumps(values, sort_keys=True).encode(), 9)
        return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def view_of_link(link: str) -> View:
    """The view that ``to_link`` wrote.

    Raises SettingsError for what is none, and names the value where one is at fault.
    """
    try:
        packed = base64.urlsafe_b64decode(link + "=" * (-len(link) % 4))
        unpacker = zlib.decompressobj()
        text = unpacker.decompress(packed, _MAX_TEXT)
        if not unpacker.eof:
            raise ValueError("it is cut short or too long")
        values = json.loads(text, parse_int=_int_of)
        _require_numbers(values)
        for name in ("settings", "aligned"):
            values[name] = _chain_of(values, name)
        return View.model_validate(values)
    except SettingsError:
        raise
    except (
        binascii.Error,
        zlib.error,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        RecursionError,
    ) as error:
        reason = said(error) if isinstance(error, ValidationError) else "it is no link of a view"
        raise _no_link(reason) from error


def _chain_of(values: dict[str, Any], name: str) -> dict[str, Any]:
    """All settings of a link's preset, and over them those that it names."""
    if values["preset"] not in PRESETS:
        raise _no_link("preset: there is none of this name")
    chain = PRESETS[values["preset"]].model_dump()
    chain |= values[name].pop("", {})
    for stage, other in values[name].items():
        if not isinstance(chain.get(stage), dict) or not isinstance(other, dict):
            raise _no_link(f"{_place([name, stage])}: no stage has such settings")
        settings_class = type(getattr(PRESETS[values["preset"]], stage))
        chain[stage] = chain[stage] | under_current_names(settings_class, other)[0]
    return chain


def _int_of(digits: str) -> float:
    """An integer of JSON. Python reads none of thousands of digits: too long ones are infinite."""
    return int(digits) if len(digits.lstrip("-")) <= _INT64_DIGITS else math.inf


def _require_numbers(value: object, where: tuple[object, ...] = ()) -> None:
    """Refuse numbers that are none, infinite, or larger than the integers of 64 bits."""
    if isinstance(value, dict):
        for name, inner in value.items():
            _require_numbers(inner, (*where, name))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            _require_numbers(inner, (*where, index))
    elif isinstance(value, int | float) and not -_INT64 <= value < _INT64:
        raise _no_link(f"{_place(where)}: it is no number of 64 bits")


def _no_link(reason: str) -> SettingsError:
    return SettingsError(f"the link cannot be followed: {reason}", advice="Copy it again, whole.")


def said(error: ValidationError) -> str:
    """A validation error in one line."""
    first = error.errors()[0]
    where = _place(first["loc"])
    return f"{where}: {first['msg'].lower()}" if where else str(first["msg"]).lower()


def _place(parts: Iterable[object]) -> str:
    """Where a value stands, in a few printable characters."""
    where = ".".join(str(part) for part in parts)[:_MOST_WHERE]
    return "".join(sign if sign.isprintable() else "?" for sign in where)
