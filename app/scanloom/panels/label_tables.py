"""Scores and agreement of layers of labels as HTML."""

import html
from collections.abc import Sequence

from fusion_core.model.classes import NoiseClass
from fusion_core.workflows.labels.compare_layers import Agreement, Estimate, PairAgreement
from fusion_core.workflows.labels.score_layer import AnswerScore
from scanloom.page.markup import name_html
from scanloom.panels.swatches import class_swatch
from scanloom.state.frame_runs import class_name
from scanloom.state.review_queue import QueueProgress

BOX = "<div style='padding:0.2em 0.6em 0.6em;font-size:0.85em;line-height:1.45'>"
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
            _class_html(class_name(one.noise_class)),
            [
                str(one.known),
                str(one.said),
                estimate_html(one.recall),
                estimate_html(one.precision),
            ],
        )
        for one in score.classes
    ]
    table = table_html(["Class", "known", "said", "recall", "precision"], rows)
    return (
        f"{BOX}<p><b>{name_html(layer)} against {name_html(known)}</b>: {runs.done} of "
        f"{runs.total} runs with a known answer are labelled. Of {score.samples} samples that both "
        f"labelled, {estimate_html(score.percent)} are right.</p>{table}{_INTERVALS}</div>"
    )


def agreement_html(agreement: Agreement) -> str:
    """Agreement of all layers, then of each pair; by class where that is unfolded."""
    overall = agreement.coefficients
    rows = [
        ("Pairs of labels that agree", [estimate_html(overall["percent"])]),
        ("Krippendorff's α", [estimate_html(overall["krippendorff_alpha"])]),
        ("Fleiss' κ", [estimate_html(overall["fleiss_kappa"])]),
    ]
    by_class = [
        (_class_html(name), [estimate_html(found["krippendorff_alpha"])])
        for name, found in agreement.by_class.items()
    ]
    by_layer = [
        (
            f"{name_html(name)}, with all others: κ",
            [estimate_html(layer.coefficients["cohen_kappa"])],
        )
        for name, layer in agreement.layers.items()
    ]
    inside = _details(
        "By class and by layer",
        table_html(["Class", "α"], by_class) + table_html(["", ""], by_layer),
    )
    return (
        f"{BOX}<p><b>{len(agreement.layers)} layers</b>, {agreement.captures} scans and images, "
        f"{agreement.complete_samples} samples that all decided on</p>"
        f"{table_html(['', ''], rows)}"
        f"{inside}"
        f"{''.join(_pair_html(pair) for pair in agreement.pairs)}{_INTERVALS}</div>"
    )


def _pair_html(pair: PairAgreement) -> str:
    found = pair.coefficients
    rows = [
        ("Labels that agree", [estimate_html(found["percent"])]),
        ("Cohen's κ", [estimate_html(found["cohen_kappa"])]),
        ("IoU of matched runs", [estimate_html(found["matched_iou"])]),
    ]
    by_class = [
        (_class_html(name), [estimate_html(own["cohen_kappa"]), estimate_html(own["matched_iou"])])
        for name, own in pair.by_class.items()
    ]
    confusion = [
        (_class_html(name), [str(count) for count in counts])
        for name, counts in zip(pair.by_class, pair.confusion.tolist(), strict=True)
    ]
    confused = table_html([name_html(pair.first), *pair.by_class], confusion)
    return (
        f"<p><b>{name_html(pair.first)} and {name_html(pair.second)}</b>: "
        f"{int(pair.confusion.sum())} samples that both decided on</p>{table_html(['', ''], rows)}"
        + _details(
            "By class",
            f"{table_html(['Class', 'κ', 'IoU'], by_class)}"
            f"<p>Samples by the class of {name_html(pair.first)} (rows) and of "
            f"{name_html(pair.second)} (columns)</p>{confused}",
        )
    )


def estimate_html(estimate: Estimate) -> str:
    """A value with its interval; why there is none as the title of a dash."""
    if estimate.value is None:
        return f'<span title="{html.escape(estimate.undefined)}">–</span>'
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:.2f}"
    return f"{estimate.value:.2f} {unbroken(f'({estimate.low:.2f}–{estimate.high:.2f})')}"


def unbroken(text: str) -> str:
    """Text of numbers in one line."""
    return f'<span style="white-space:nowrap">{text}</span>'


def _class_html(name: str) -> str:
    return f"{class_swatch(NoiseClass[name.upper()])} {name}"


def _details(summary: str, content: str) -> str:
    return f"<details><summary>{summary}</summary>{content}</details>"


def table_html(head: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> str:
    """``head``: empty names for none. ``rows``: the name and the cells of each, as HTML."""
    first, *others = head
    heads = _FIRST_HEAD.format(first) + "".join(_HEAD.format(name) for name in others)
    headline = f"<tr>{heads}</tr>" if any(head) else ""
    body = "".join(
        f"<tr>{_ROW_NAME.format(name)}{''.join(_CELL.format(cell) for cell in cells)}</tr>"
        for name, cells in rows
    )
    return f"{_TABLE}{headline}{body}</table>"
