"""What one browser displays: the recording, the frame, the settings and the display options.

A view is frozen and validated: what a browser or a link sends becomes a view, or an error in one
line. A link holds a whole view; of the settings it holds those that differ from their preset.
"""

import base64
import binascii
import hashlib
import json
import math
import zlib
from collections.abc import Hashable, Iterable
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fusion_core.model.classes import NoiseClass
from fusion_core.model.errors import SettingsError
from fusion_core.settings import under_current_names
from fusion_core.workflows.fuse.settings import (
    PRESETS,
    ChainSettings,
    PresetName,
    settings_toml,
)
from scanloom.state.hand_pose import HandPose
from scanloom.state.review_choices import ReviewChoices
from scanloom.state.slam_choices import SlamChoices

PanelName = Literal["Recording", "Match", "Register", "Repair", "Review", "Map", "Calibrate"]
PANELS: tuple[PanelName, ...] = get_args(PanelName)
Scope = Literal["frame", "window", "recording"]
MapMode = Literal["Fuse", "SLAM"]
ColorScheme = Literal["auto", "light", "dark"]
CalibrationPictures = Literal["now", "before", "both"]
MAP_MODES: tuple[MapMode, ...] = get_args(MapMode)
Layer = Literal[
    "surface",
    "rows",
    "matched",
    "curve",
    "rays",
    "pairs",
    "classes",
    "repairs",
    "sensors",
    "labels",
    "floor",
    "map",
    "cloud",
    "keyframes",
    "loops",
]
# Unpacked size of a link; a view with every setting changed takes about a tenth of it.
_MAX_LINK_CHARACTERS = 65_536
# An error message names the refused field, whose name may come from a hostile link.
_MAX_FIELD_PATH_CHARACTERS = 80
# Beyond the samples of any curve and the rows of any image.
_MAX_OFFSET = 100_000.0
# Of a recording's name: Linux limits paths to as many bytes.
MAX_NAME_CHARACTERS = 4096
# An int32; browsers are sent integers of at most 64 bits.
_MAX_INDEX = 2**31 - 1
_INT64_LIMIT = 2**63
# Digits of the largest int64.
_INT64_DIGITS = 19

# Former names of fields, which older links still use: current name by former name.
_FORMER_FIELD_NAMES = {
    "number": "frame_index",
    "aligned": "alignment_settings",
    "scope": "field_scope",
    "picked": "picked_offset",
    "lock_picked": "lock_picked_offset",
    "draw": "draw_index",
    "classes": "visible_classes",
    "repaired": "show_repaired",
    "both": "show_raw_and_repaired",
    "beam": "selected_beam",
    "speed": "playback_speed",
    "loop": "loop_playback",
}


class View(BaseModel):
    """One browser's view of a recording. ``recording`` is its name in the library.

    ``settings`` are used for the displayed frame. The whole recording was aligned with
    ``alignment_settings``: moving a slider does not align it again.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    recording: str = Field(max_length=MAX_NAME_CHARACTERS)
    frame_index: int = Field(0, ge=0, le=_MAX_INDEX, description="Index of the frame, from 0")
    panel: PanelName = "Recording"
    preset: PresetName = "default"
    settings: ChainSettings = PRESETS["default"]
    alignment_settings: ChainSettings = PRESETS["default"]
    lidar_topic: str | None = Field(None, max_length=4096)
    depth_topics: tuple[str, ...] = Field((), max_length=64)
    virtual_row: int | None = Field(None, ge=0, le=100_000)
    extrinsics: HandPose | Literal["recording"] | None = Field(
        None,
        description="The camera's pose by hand; the recording's own; else that of the server's "
        "file, if it has one",
    )
    apply_clock_offset: bool = False
    field_scope: Scope = "frame"
    picked_offset: (
        tuple[
            Annotated[float, Field(ge=-_MAX_OFFSET, le=_MAX_OFFSET)],
            Annotated[float, Field(ge=0.0, le=_MAX_OFFSET)],
        ]
        | None
    ) = Field(None, description="Offset (u, v) picked by hand")
    lock_picked_offset: bool = False
    draw_index: int = Field(0, ge=0, le=99_999, description="Index of the RANSAC draw, from 0")
    visible_classes: frozenset[NoiseClass] = frozenset(NoiseClass)
    show_repaired: bool = Field(True, description="Show repaired values, else raw ones")
    show_raw_and_repaired: bool = Field(False, description="Show both depth images")
    selected_beam: int | None = Field(
        None, ge=0, le=_MAX_INDEX, description="Index of the beam in the scan"
    )
    row_step: int = Field(
        6, ge=1, le=60, description="Draw every n-th row of the depth image in 3D"
    )
    hidden_layers: frozenset[Layer] = Field(
        frozenset(), description="Layers of the 3D scene that are switched off"
    )
    playback_speed: float = Field(1.0, ge=0.1, le=8.0)
    loop_playback: bool = True
    color_scheme: ColorScheme = "auto"
    large_text: bool = Field(False, description="Large letters and lines, for a projector")
    map_mode: MapMode = "Fuse"
    slam: SlamChoices = SlamChoices()
    review: ReviewChoices = ReviewChoices()
    overlay_opacity: float = Field(
        0.85, ge=0.0, le=1.0, description="Opacity of the LiDAR's points over the image"
    )
    calibration_pictures: CalibrationPictures = "now"
    show_gizmo: bool = Field(True, description="Show the handles of the camera in 3D")
    label_layer: str = Field(
        "", max_length=80, description="Layer of labels that overrule the classes; empty for none"
    )

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
            raise SettingsError(
                validation_message(error), advice="The value before is kept."
            ) from error
        return self.model_copy(update={"settings": settings})

    def changed(self, **values: Any) -> "View":
        """The view with other values. Raises SettingsError for one that is refused."""
        try:
            return View.model_validate(dict(self) | values)
        except ValidationError as error:
            raise SettingsError(
                validation_message(error), advice="The value before is kept."
            ) from error

    def frame_after(self, frame_index: int, by: int, count: int) -> int:
        """The frame so many after one of ``count``: at most the last or first one, or around the
        ends if playback loops."""
        number = frame_index + by
        return number % count if self.loop_playback else min(max(number, 0), count - 1)

    def of_recording(self, name: str) -> "View":
        """The first frame of another recording, with the streams that it offers itself. Raises
        SettingsError for a name that is too long."""
        return self.changed(
            recording=name,
            frame_index=0,
            picked_offset=None,
            lidar_topic=None,
            depth_topics=(),
            virtual_row=None,
            selected_beam=None,
            extrinsics=None,
        )

    @property
    def opened_by(self) -> Hashable:
        """What a recording is opened with: its name, its streams, and how it is aligned."""
        return (
            self.recording,
            self.lidar_topic,
            self.depth_topics,
            self.virtual_row,
            self.extrinsics == "recording",
            self.alignment_settings.read_by("alignment"),
        )

    @property
    def hand_pose(self) -> HandPose | None:
        """The camera's pose by hand, None where it is not set by hand."""
        return self.extrinsics if isinstance(self.extrinsics, HandPose) else None

    @property
    def settings_sha256(self) -> str:
        """Digest of the settings of the displayed frame, as a run with them states it."""
        text = settings_toml(self.preset, self.settings)
        return hashlib.sha256(text.encode("utf-8")).hexdigest()

    def needs_alignment(self) -> bool:
        """Whether settings that the alignment depends on have changed since."""
        return self.settings.read_by("alignment") != self.alignment_settings.read_by("alignment")

    def preset_overrides(self, settings: ChainSettings | None = None) -> dict[str, dict[str, Any]]:
        """Settings that differ from the preset, by stage; those of the chain itself under ""."""
        mine = (self.settings if settings is None else settings).model_dump()
        base = PRESETS[self.preset].model_dump()
        overrides: dict[str, dict[str, Any]] = {}
        for stage, value in mine.items():
            if not isinstance(value, dict):
                if value != base[stage]:
                    overrides.setdefault("", {})[stage] = value
                continue
            other = {name: v for name, v in value.items() if v != base[stage][name]}
            if other:
                overrides[stage] = other
        return overrides

    def to_link(self) -> str:
        """The view as text for a URL."""
        values = self.model_dump(mode="json", exclude={"settings", "alignment_settings"})
        values["settings"] = self.preset_overrides()
        values["alignment_settings"] = self.preset_overrides(self.alignment_settings)
        # Sorted, so that equal views have equal links.
        for name in ("visible_classes", "hidden_layers"):
            values[name] = sorted(values[name])
        values["review"]["classes"] = sorted(values["review"]["classes"])
        packed = zlib.compress(json.dumps(values, sort_keys=True).encode(), 9)
        return base64.urlsafe_b64encode(packed).decode().rstrip("=")


def view_of_link(link: str) -> View:
    """Parse what ``to_link`` wrote, also with former names of fields and settings.

    Raises SettingsError for anything else, naming the field where one is at fault.
    """
    try:
        packed = base64.urlsafe_b64decode(link + "=" * (-len(link) % 4))
        unpacker = zlib.decompressobj()
        text = unpacker.decompress(packed, _MAX_LINK_CHARACTERS)
        if not unpacker.eof:
            raise ValueError("it is cut short or too long")
        values = json.loads(text, parse_int=_parse_int)
        _require_int64_range(values)
        for former, current in _FORMER_FIELD_NAMES.items():
            if former in values and current not in values:
                values[current] = values.pop(former)
        for name in ("settings", "alignment_settings"):
            values[name] = _chain_settings(values, name)
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
        reason = (
            validation_message(error)
            if isinstance(error, ValidationError)
            else "it is no link of a view"
        )
        raise _invalid_link(reason) from error


def _chain_settings(values: dict[str, Any], name: str) -> dict[str, Any]:
    """The settings of a link's preset, overridden by those that the link names."""
    if values["preset"] not in PRESETS:
        raise _invalid_link("preset: there is none of this name")
    chain = PRESETS[values["preset"]].model_dump()
    chain |= values[name].pop("", {})
    for stage, other in values[name].items():
        if not isinstance(chain.get(stage), dict) or not isinstance(other, dict):
            raise _invalid_link(f"{_field_path([name, stage])}: no stage has such settings")
        settings_class = type(getattr(PRESETS[values["preset"]], stage))
        chain[stage] = chain[stage] | under_current_names(settings_class, other)[0]
    return chain


def _parse_int(digits: str) -> float:
    """An integer in JSON; infinite beyond int64. (Python refuses to parse thousands of digits.)"""
    return int(digits) if len(digits.lstrip("-")) <= _INT64_DIGITS else math.inf


def _require_int64_range(value: object, where: tuple[object, ...] = ()) -> None:
    """Refuse NaN, infinities and numbers beyond int64."""
    if isinstance(value, dict):
        for name, inner in value.items():
            _require_int64_range(inner, (*where, name))
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            _require_int64_range(inner, (*where, index))
    elif isinstance(value, int | float) and not -_INT64_LIMIT <= value < _INT64_LIMIT:
        raise _invalid_link(f"{_field_path(where)}: it is no number of 64 bits")


def _invalid_link(reason: str) -> SettingsError:
    return SettingsError(f"the link cannot be followed: {reason}", advice="Copy it again, whole.")


def validation_message(error: ValidationError) -> str:
    """The first problem of a validation error, in one line."""
    first = error.errors()[0]
    where = _field_path(first["loc"])
    return f"{where}: {first['msg'].lower()}" if where else str(first["msg"]).lower()


def _field_path(parts: Iterable[object]) -> str:
    """The dotted name of a field, shortened and printable."""
    where = ".".join(str(part) for part in parts)[:_MAX_FIELD_PATH_CHARACTERS]
    return "".join(sign if sign.isprintable() else "?" for sign in where)
