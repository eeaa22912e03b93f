"""Layers of random labels, for property tests."""

from collections.abc import Iterable, Sequence

import numpy as np
from hypothesis import strategies as st

from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label

CAPTURES = (
    Capture("depth", "/a/depth", 5, 0, 3, 4),
    Capture("depth", "/a/depth", 7, 0, 3, 4),
    Capture("depth", "/b", 5, 0, 2, 2),
    Capture("lidar", "/scan", -1, 0, 1, 5),
    Capture("lidar", "/scan", 5, 0, 1, 5),
    Capture("lidar", "/scan", 5, 1, 1, 6),
)
"""In their order; two of them differ in the index alone."""

Samples = dict[tuple[Capture, int, int], Label]
"""A layer as a plain dictionary."""


def samples_of(layer: Iterable[CaptureLabels]) -> Samples:
    """The labels of a layer."""
    return {
        (labels.capture, row, column): Label(code)
        for labels in layer
        for row, column, code in zip(
            labels.row.tolist(), labels.column.tolist(), labels.label.tolist(), strict=True
        )
    }


@st.composite
def layers(
    draw: st.DrawFn,
    captures: Sequence[Capture] = CAPTURES,
    labels: Sequence[int] = (NO_LABEL, *Label),
) -> list[CaptureLabels]:
    """A layer: labels of some samples of some of the captures, in their order."""
    found = []
    for capture in captures:
        size = capture.rows * capture.columns
        codes = draw(
            st.one_of(
                st.just([NO_LABEL] * size),
                # Few values give long runs.
                st.lists(st.sampled_from([labels[0], labels[-1]]), min_size=size, max_size=size),
                st.lists(st.sampled_from(labels), min_size=size, max_size=size),
            )
        )
        image = np.array(codes).reshape(capture.rows, capture.columns)
        if (image != NO_LABEL).any():
            found.append(CaptureLabels.of_image(capture, image))
    return found
