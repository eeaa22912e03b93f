"""The review panel's blocks as HTML: progress, the run that is asked about, the answers."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fusion_core.model.classes import NoiseClass
from scanloom.page.bridge import press_attributes
from scanloom.panels.frame_readout import frame_name
from scanloom.panels.swatches import class_swatch, swatch
from scanloom.plots.label_overlay import UNSURE_COLOR
from scanloom.scene.duration_text import duration_text
from scanloom.state.frame_runs import class_name

PRESS_ANSWER, PRESS_ACTION = "answer", "review"


@dataclass(frozen=True, slots=True, kw_only=True)
class ProgressText:
    """``done`` of ``total`` runs of the queue; ``counted`` of ``frames`` frames have their runs.
    ``a_minute``: answers, None where not known. ``layer``: which the answers go into."""

    done: int
    total: int
    counted: int
    frames: int
    a_minute: float | None
    layer: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RunText:
    """The run that is asked about. ``noise_class``: None where it is hidden. ``why``: sentences.
    ``elsewhere``: beams of it that another frame judges otherwise, by class. ``others``: the labels
    that other layers give it, by layer."""

    sensor: str
    first: int
    last: int
    samples: int
    frame_index: int
    noise_class: int | None
    confidence: float
    why: Sequence[str]
    elsewhere: Mapping[int, int]
    labelled: str
    others: Mapping[str, str]


def progress_html(text: ProgressText) -> str:
    """A bar, the counts, the rate and how long the rest takes."""
    percent = 100.0 * text.done / text.total if text.total else 0.0
    into = f"into <bdi>{html.escape(text.layer)}</bdi>"
    words = [f"<b>{text.done}</b> of {text.total} runs {into}"]
    if text.a_minute is not None:
        words.append(f"{text.a_minute:.0f} a minute")
        if text.done < text.total:
            words.append(f"{_minutes((text.total - text.done) / text.a_minute)} left")
    if text.counted < text.frames:
        words.append(f"{text.counted:,} of {text.frames:,} frames counted so far")
    return (
        '<div class="scanloom-review-progress">'
        f'<div class="scanloom-shares" aria-hidden="true"><i style="width:{percent:.1f}%;'
        f'background:#1c7ed6"></i></div><p>{" · ".join(words)}</p></div>'
    )


def run_html(text: RunText) -> str:
    """What is asked, what the automatic class is, and why."""
    what = "Beam" if text.sensor == "lidar" else "Pixel at beam"
    many = f"{what}s" if text.sensor == "lidar" else "Pixels at beams"
    name = f"{what} {text.first}" if text.samples == 1 else f"{many} {text.first}–{text.last}"
    parts = [f"<h3>{name} of {frame_name(text.frame_index)}</h3>"]
    if text.noise_class is None:
        parts.append("<p>What is it? The automatic class is hidden.</p>")
    else:
        mark = class_swatch(NoiseClass(text.noise_class))
        parts.append(
            f"<p class='scanloom-automatic'>{mark}<span>Automatic: "
            f"<b>{class_name(text.noise_class)}</b>, confidence {text.confidence:.2f}</span></p>"
        )
        for code, beams in sorted(text.elsewhere.items()):
            parts.append(
                f"<p>Another frame with this scan says {class_name(code)}: {beams} "
                f"{'beam' if beams == 1 else 'beams'}.</p>"
            )
        parts += [f"<p>{html.escape(sentence)}</p>" for sentence in text.why]
    if text.labelled:
        parts.append(f"<p><b>Your label: {html.escape(text.labelled)}</b></p>")
    for layer, label in text.others.items():
        parts.append(f"<p><bdi>{html.escape(layer)}</bdi>: {html.escape(label)}</p>")
    return f'<div class="scanloom-run">{"".join(parts)}</div>'


def answers_html(*, is_marked: bool, selected: tuple[int, int], is_blind: bool) -> str:
    """The answers with their keys, and what they are about."""
    rows = []
    if not is_marked and not is_blind:
        rows.append(
            [
                _answer("accept", "Yes, right", "Y"),
                _answer("reject", "No", "N"),
            ]
        )
    rows.append(
        [
            _answer(noise.name.lower(), noise.name.lower().capitalize(), str(noise + 1), noise)
            for noise in NoiseClass
        ]
    )
    rows.append([_answer("unsure", "Unsure", "U", "unsure"), _answer("clear", "No label", "0")])
    about = "The answer is about the run."
    if is_marked:
        beams, pixels = selected
        about = f"The answer is about what you have marked: {beams} beams, {pixels} pixels."
        rows[-1].append(_action("unmark", "Unmark", "V"))
    else:
        rows.append(
            [
                _action("previous", "‹ Previous", "K"),
                _action("next", "Next ›", "J"),
                _action("split", "Split", "X"),
            ]
        )
    lines = "".join(f'<div role="group">{"".join(row)}</div>' for row in rows)
    return (
        f'<div class="scanloom-answers"><p>{about}</p>{lines}'
        '<p class="scanloom-keys-off" role="status">Keys go to the text field now: click beside it '
        "or press Esc to answer by keys.</p></div>"
    )


def _answer(value: str, text: str, key: str, mark: NoiseClass | str | None = None) -> str:
    drawn = ""
    if isinstance(mark, NoiseClass):
        drawn = class_swatch(mark)
    elif mark is not None:
        drawn = swatch("square", UNSURE_COLOR)
    return (
        f'<button {press_attributes(PRESS_ANSWER, value)} title="Key {key}">'
        f"{drawn}{html.escape(text)}<kbd>{key}</kbd></button>"
    )


def _action(value: str, text: str, key: str) -> str:
    return (
        f'<button {press_attributes(PRESS_ACTION, value)} title="Key {key}">'
        f"{html.escape(text)}<kbd>{key}</kbd></button>"
    )


def _minutes(minutes: float) -> str:
    if minutes < 1.0:
        return "less than a minute"
    return duration_text(60.0 * round(minutes))
