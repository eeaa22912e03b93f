"""Scores and agreement of layers of labels as HTML tables."""

import html
from collections.abc import Sequence

from fusion_core.workflows.labels.compare_layers import Estimate
from fusion_core.workflows.labels.score_layer import AnswerScore
from scanloom.page.markup import name_html
from scanloom.panels.swatches import class_swatch
from scanloom.state.frame_runs import class_name
from scanloom.state.review_queue import QueueProgress

_BOX = "<div style='padding:0.2em 0.6em 0.6em;font-size:0.85em;line-height:1.45'>"
_TABLE = "<table style='width:100%;border-collapse:collapse;font-variant-numeric:tabular-nums'>"
_CELL = "<td style='padding:0.05em 0 0.05em 0.6em;text-align:right'>{}</td>"
_HEAD = "<th scope='col' style='padding:0.05em 0 0.05em 0.6em;text-align:right'>{}</th>"
_FIRST_HEAD = "<th scope='col' style='text-align:left'>{}</th>"
_ROW_NAME = "<th scope='row' style='text-align:left;font-weight:normal'>{}</th>"
_INTERVALS = "<p>In parentheses: 95 % intervals, by drawing scans and images anew.</p>"


def score_html(score: AnswerScore, layer: str, known: str, runs: QueueProgress) -> str:
    """Recall and precision by class of ``layer`` against ``known``; ``runs`` of the queue have a
    known answer."""
    rows = [
        (
            f"{class_swatch(one.noise_class)} {class_name(one.noise_class)}",
            [
                str(one.known),
                str(one.said),
                estimate_html(one.recall),
                estimate_html(one.precision),
            ],
        )
        for one in score.classes
    ]
    table = _table(["Class", "known", "said", "recall", "precision"], rows)
    return (
        f"{_BOX}<p><b>{name_html(layer)} against {name_html(known)}</b>: {runs.done} of "
        f"{runs.total} runs with a known answer are labelled. Of {score.samples} samples that both "
        f"labelled, {estimate_html(score.percent)} are right.</p>{table}{_INTERVALS}</div>"
    )


def estimate_html(estimate: Estimate) -> str:
    """A value with its interval; why there is none as the title of a dash."""
    if estimate.value is None:
        return f'<span title="{html.escape(estimate.undefined)}">–</span>'
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:.2f}"
    return f"{estimate.value:.2f} ({estimate.low:.2f}–{estimate.high:.2f})"


def _table(head: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """``rows``: the name and the cells of each, as HTML."""
    first, *others = head
    heads = _FIRST_HEAD.format(first) + "".join(_HEAD.format(name) for name in others)
    body = "".join(
        f"<tr>{_ROW_NAME.format(name)}{''.join(_CELL.format(cell) for cell in cells)}</tr>"
        for name, cells in rows
    )
    return f"{_TABLE}<tr>{heads}</tr>{body}</table>"
