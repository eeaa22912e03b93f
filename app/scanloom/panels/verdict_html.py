"""A verdict as HTML: the sentence, a bar of the classes' shares, and their counts."""

import html

from fusion_core.model.classes import NoiseClass
from scanloom.resources import palette
from scanloom.scene.verdict import Verdict

_NAMES: dict[NoiseClass, str] = {
    NoiseClass.GOOD: "agree",
    NoiseClass.HOLE: "missing (hole)",
    NoiseClass.BURR: "wrong (burr)",
    NoiseClass.CONFLICT: "two surfaces (conflict)",
}
_MEANINGS: dict[NoiseClass, str] = {
    NoiseClass.GOOD: "Beams: LiDAR and camera see the same surface within the tolerance ε",
    NoiseClass.HOLE: "Beams that returned no range",
    NoiseClass.BURR: "Beams whose range lies on no surface",
    NoiseClass.CONFLICT: "Beams that see a surface where the camera sees another one",
}
# The marks of the classes, as in the pictures: dot, ring, cross, diamond.
_SHAPES: dict[NoiseClass, str] = {
    NoiseClass.GOOD: '<circle cx="7" cy="7" r="4.5" fill="{color}"/>',
    NoiseClass.HOLE: '<circle cx="7" cy="7" r="4.5" fill="none" stroke="{color}" '
    'stroke-width="2.5"/>',
    NoiseClass.BURR: '<path d="M2.5 2.5l9 9m0-9l-9 9" stroke="{color}" stroke-width="2.8"/>',
    NoiseClass.CONFLICT: '<path d="M7 1.5L12.5 7 7 12.5 1.5 7z" fill="{color}"/>',
}


def verdict_html(verdict: Verdict) -> str:
    """The verdict as a block of HTML."""
    parts = [f"<h2>{html.escape(verdict.sentence)}</h2>"]
    if verdict.counts is not None:
        parts.append(_bar(verdict.counts) + _counts(verdict.counts))
    if verdict.detail:
        parts.append(f"<p>{html.escape(verdict.detail)}</p>")
    return f'<div class="scanloom-verdict">{"".join(parts)}</div>'


def class_shape(noise: NoiseClass) -> str:
    """A class's mark as a small SVG."""
    shape = _SHAPES[noise].format(color=_color(noise))
    return f'<svg width="14" height="14" aria-hidden="true">{shape}</svg>'


def _bar(counts: dict[NoiseClass, int]) -> str:
    total = max(sum(counts.values()), 1)
    parts = "".join(
        f'<i style="width:{100.0 * counts[noise] / total:.2f}%;background:{_color(noise)}"></i>'
        for noise in NoiseClass
    )
    return f'<div class="scanloom-shares" aria-hidden="true">{parts}</div>'


def _counts(counts: dict[NoiseClass, int]) -> str:
    rows = "".join(
        f'<div title="{html.escape(_MEANINGS[noise])}">{class_shape(noise)}'
        f"<span>{_NAMES[noise]}</span><b>{counts[noise]}</b></div>"
        for noise in NoiseClass
    )
    return f'<div class="scanloom-counts">{rows}</div>'


def _color(noise: NoiseClass) -> str:
    return palette()[noise.name.lower()]
