"""What the page's script tells the server, validated."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

PictureName = Literal["depth", "similarity", "profile", "time", "matches"]
PointKind = Literal["move", "drag", "leave", "click"]
ToolName = Literal["box", "brush"]

# Beyond any picture or screen.
_MAX_PX = 100_000.0
# The script keeps so many actions.
_MAX_ACTIONS = 8
# More than a script sends in one stroke.
_MAX_PLACES = 64
_Px = Annotated[float, Field(ge=-_MAX_PX, le=_MAX_PX)]
_Number = Annotated[int, Field(ge=0, le=2**53)]


class _Event(BaseModel):
    """Numbered in the order in which the page saw them."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    number: _Number


class Point(_Event):
    """The pointer on a picture, in the picture's pixels, whose centres are integers."""

    picture: PictureName
    kind: Literal["move", "drag", "leave"]
    x_px: _Px
    y_px: _Px


class Click(_Event):
    """A click on a picture, or where a drag over it has ended."""

    kind: Literal["click", "drag"]
    picture: PictureName
    x_px: _Px
    y_px: _Px


class Stroke(_Event):
    """What was drawn on a picture with a tool: two corners of a box, or the places that a brush has
    passed. ``is_added``: to what was drawn before."""

    kind: Literal["stroke"]
    picture: PictureName
    tool: ToolName
    places: tuple[tuple[_Px, _Px], ...] = Field(min_length=1, max_length=_MAX_PLACES)
    is_added: bool = False


class Press(_Event):
    """A press of a button that the server has put on the page; both texts are its own."""

    kind: Literal["press"]
    name: str = Field(max_length=40)
    value: str = Field(max_length=400)


class Screen(_Event):
    """The size of the page in CSS pixels, and whether the browser asks for dark."""

    kind: Literal["screen"]
    width_px: int = Field(ge=0, le=100_000)
    height_px: int = Field(ge=0, le=100_000)
    prefers_dark: bool


Action = Annotated[Click | Stroke | Press | Screen, Field(discriminator="kind")]


class PageEvents(BaseModel):
    """The latest actions, oldest first, and the latest place of the pointer."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    actions: tuple[Action, ...] = Field((), max_length=_MAX_ACTIONS)
    pointer: Point | None = None


def parse_events(text: str) -> PageEvents | None:
    """What the page's field holds, None for anything else."""
    try:
        return PageEvents.model_validate_json(text)
    except ValidationError:
        return None
