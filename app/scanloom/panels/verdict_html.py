"""A verdict as HTML: the sentence, a bar of the classes' shares, and their counts."""

import html
import re

from fusion_core.model.classes import NoiseClass
from scanloom.panels.swatches import class_swatch, css_color
from scanloom.plots.palette import class_color
from scanloom.scene.frame_summary import PairCounts
from scanloom.scene.verdict import Verdict

_NAMES: dict[NoiseClass, str] = {
    NoiseClass.GOOD: "agree",
    NoiseClass.HOLE: "missing (hole)",
    NoiseClass.BURR: "wrong (burr)",
    NoiseClass.CONFLICT: "two surfaces (conflict)",
}
_MEANINGS: dict[NoiseClass, str] = {
    NoiseClass.GOOD: "Beam and pixel see the same surface within the tolerance ε",
    NoiseClass.HOLE: "The beam returned no range, or its pixel has no depth",
    NoiseClass.BURR: "The beam's range, or its pixel's depth, lies on no surface",
    NoiseClass.CONFLICT: "The beam sees one surface, its pixel another",
}
# A line does not end between a number and its unit.
_BEFORE_UNIT = re.compile(r"(?<=\d) (?=(?:ms|s|min|h|mm|cm|m|px)\b)")


def verdict_html(verdict: Verdict) -> str:
    """The verdict as a block of HTML."""
    sentence = _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", verdict.sentence)
    parts = [f"<h2>{html.escape(sentence)}</h2>"]
    if verdict.counts is not None:
        parts.append(_bar(verdict.counts) + _counts(verdict.counts))
    if verdict.detail:
        parts.append(f"<p>{html.escape(verdict.detail)}</p>")
    return f'<div class="scanloom-verdict">{"".join(parts)}</div>'


def _bar(counts: PairCounts) -> str:
    total = max(counts.total, 1)
    parts = "".join(
        f'<i style="width:{100.0 * counts.by_class[noise] / total:.2f}%;'
        f'background:{css_color(class_color(noise))}"></i>'
        for noise in NoiseClass
    )
    return f'<div class="scanloom-shares" aria-hidden="true">{parts}</div>'


def _counts(counts: PairCounts) -> str:
    rows = "".join(
        f'<div title="{html.escape(_MEANINGS[noise])}">{class_swatch(noise)}'
        f"<span>{_NAMES[noise]}</span><b>{counts.by_class[noise]}</b></div>"
        for noise in NoiseClass
    )
    return f'<div class="scanloom-counts">{rows}</div>'
