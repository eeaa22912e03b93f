"""The timeline's row of buttons and its line of text, as HTML."""

import html
from collections.abc import Sequence
from dataclasses import dataclass

from scanloom.page.bridge import press_attributes

PRESS = "timeline"
SPEEDS: tuple[tuple[str, float], ...] = (
    ("¼", 0.25),
    ("½", 0.5),
    ("1", 1.0),
    ("2", 2.0),
    ("4", 4.0),
)

# Outlines in a box of 16 by 16.
_ICONS = {
    "first": "M3 3v10M13 3L5 8l8 5z",
    "previous": "M11 3L4 8l7 5z",
    "play": "M4 2.5v11L13 8z",
    "pause": "M4 3h3v10H4zM9 3h3v10H9z",
    "next": "M5 3l7 5-7 5z",
    "last": "M13 3v10M3 3l8 5-8 5z",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RowState:
    """What the row shows. ``worst_missing``, ``conflict_missing``: why the button does nothing,
    empty where it works."""

    is_playing: bool
    speed: float
    worst_missing: str
    conflict_missing: str


def row_html(state: RowState) -> str:
    """Play, steps, worst frame, conflicts and speed."""
    play = ("pause", "Pause") if state.is_playing else ("play", "Play")
    steps = [
        _icon_button("first", "First frame", "Home"),
        _icon_button("previous", "Previous frame", "K"),
        _icon_button(play[0], play[1], "Space", value="play"),
        _icon_button("next", "Next frame", "J"),
        _icon_button("last", "Last frame", "End"),
    ]
    found = [
        _text_button("worst", "Worst frame", "Most noise (M)", state.worst_missing),
        _text_button(
            "previous_conflict", "‹", "Previous conflict (Shift + N)", state.conflict_missing
        ),
        _text_button("next_conflict", "Conflict ›", "Next conflict (N)", state.conflict_missing),
    ]
    speeds = [_speed_button(text, speed, is_chosen=speed == state.speed) for text, speed in SPEEDS]
    return (
        '<div class="scanloom-timeline">'
        f"{_group('Playback', steps)}{_group('Noise', found)}{_group('Speed', speeds)}</div>"
    )


_PAIRS = "A pair of beam and pixel counts by the worse of its two sides"


def line_html(text: str, details: str, aside: str) -> str:
    """The displayed frame's line, its ``details`` where letters leave room for them, and what goes
    on beside it; all are plain text."""
    return (
        f'<div class="scanloom-frame"><span title="{_PAIRS}">{html.escape(text)}'
        f'<span class="scanloom-details">{html.escape(details)}</span></span>'
        f"<span>{html.escape(aside)}</span></div>"
    )


def _group(label: str, buttons: Sequence[str]) -> str:
    return f'<span role="group" aria-label="{label}">{"".join(buttons)}</span>'


def _icon_button(icon: str, label: str, key: str, *, value: str = "") -> str:
    return (
        f'<button {press_attributes(PRESS, value or icon)} title="{label} ({key})" '
        f'aria-label="{label}"><svg viewBox="0 0 16 16" aria-hidden="true">'
        f'<path d="{_ICONS[icon]}"/></svg></button>'
    )


def _text_button(value: str, text: str, hint: str, missing: str) -> str:
    disabled = " disabled" if missing else ""
    title = html.escape(missing or hint)
    # A name of its own for those who do not see the sign.
    label = f' aria-label="{html.escape(hint)}"' if not text[0].isalpha() else ""
    return (
        f'<button {press_attributes(PRESS, value)} title="{title}"{label}{disabled}>{text}</button>'
    )


def _speed_button(text: str, speed: float, *, is_chosen: bool) -> str:
    attributes = press_attributes(PRESS, f"speed {speed:g}")
    pressed = str(is_chosen).lower()
    title = f"Play at {speed:g} times the recording's rate"
    return f'<button {attributes} aria-pressed="{pressed}" title="{title}">{text}×</button>'
