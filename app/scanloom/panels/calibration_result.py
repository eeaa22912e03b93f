"""What a calibration has found, as HTML: the verdict first, then how sure each number is."""

import html

import numpy as np

from fusion_core.model.extrinsics import POSE_PARAMETER_WORDS, ExtrinsicsEstimate
from fusion_core.model.names import printable


def result_html(estimate: ExtrinsicsEstimate, agreement: str) -> str:
    """``agreement``: of the sensors before and now, plain text."""
    head = "A pose was found"
    if estimate.T_guess is not None:
        head = "A better pose was found" if estimate.improved else "The guess is kept"
    parts = [
        f"<h3>{head}</h3>",
        _paragraph(estimate.verdict),
        _paragraph(agreement),
        _deviations(estimate),
    ]
    if estimate.basin is not None:
        parts.append(
            _paragraph(f"Of disturbed starts {estimate.basin:.0%} come back to this pose.")
        )
    if estimate.notes:
        notes = "".join(_paragraph(note) for note in estimate.notes)
        parts.append(f"<details><summary>Notes</summary>{notes}</details>")
    return f'<div class="scanloom-result">{"".join(parts)}</div>'


def _deviations(estimate: ExtrinsicsEstimate) -> str:
    """One standard deviation of each number, or that it is not observable."""
    rows = "".join(
        f"<tr><td>{html.escape(words)}</td><td>{_deviation(name, sd)}</td></tr>"
        for (name, words), sd in zip(POSE_PARAMETER_WORDS.items(), estimate.sd, strict=True)
    )
    return f"<table><caption>How sure (one standard deviation)</caption>{rows}</table>"


def _deviation(name: str, sd: float | None) -> str:
    if sd is None:
        return "<b>not observable</b>"
    return f"± {np.rad2deg(sd):.3f}°" if name.endswith("_rad") else f"± {1000.0 * sd:.1f} mm"


def _paragraph(text: str) -> str:
    return f"<p>{html.escape(printable(text))}</p>" if text else ""
