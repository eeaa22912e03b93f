"""Labels of samples, against dictionaries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label

IMAGE = Capture("depth", "/depth", 5, 0, 4, 6)
SCAN = Capture("lidar", "/scan", 5, 0, 1, 6)

samples = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 5), st.sampled_from(list(Label))), max_size=40
)


@given(samples)
def test_the_last_label_of_a_sample_counts(named: list[tuple[int, int, Label]]) -> None:
    row, column, label = np.array(named, dtype=np.int64).reshape(-1, 3).T
    labels = CaptureLabels.of_samples(IMAGE, row, column, label)
    found = dict(zip(zip(labels.row, labels.column, strict=True), labels.label, strict=True))
    assert found == {(row, column): label for row, column, label in named}


@given(samples)
def test_an_image_of_codes_gives_the_same_labels(named: list[tuple[int, int, Label]]) -> None:
    row, column, label = np.array(named, dtype=np.int64).reshape(-1, 3).T
    labels = CaptureLabels.of_samples(IMAGE, row, column, label)
    again = CaptureLabels.of_image(IMAGE, labels.as_image())
    for name in ("row", "column", "label"):
        np.testing.assert_array_equal(getattr(again, name), getattr(labels, name))


def test_one_code_stands_for_all_samples_and_a_subset_keeps_its_order() -> None:
    beams = np.array([4, 0, 2])
    labels = CaptureLabels.of_samples(SCAN, np.zeros(3, int), beams, Label.BURR)
    assert labels.column.tolist() == [0, 2, 4]
    assert labels.subset(labels.column > 0).column.tolist() == [2, 4]
    assert labels.as_image().tolist() == [[2, NO_LABEL, 2, NO_LABEL, 2, NO_LABEL]]


@pytest.mark.parametrize(
    ("row", "column", "label", "problem"),
    [
        ([0, 0], [1], [2], "alike"),
        ([4], [1], [2], "outside"),
        ([0], [-1], [2], "outside"),
        ([0], [1], [9], "code"),
        ([0, 0], [2, 1], [2, 2], "order"),
        ([0, 0], [1, 1], [2, 2], "order"),
    ],
)
def test_wrong_samples_are_refused(
    row: list[int], column: list[int], label: list[int], problem: str
) -> None:
    with pytest.raises(ValueError, match=problem):
        CaptureLabels(
            capture=IMAGE, row=np.array(row), column=np.array(column), label=np.array(label)
        )


@pytest.mark.parametrize("shape", [(0, 0, 6), (0, 1, 0), (-1, 1, 6), (0, 2, 6)])
def test_wrong_captures_are_refused(shape: tuple[int, int, int]) -> None:
    index, rows, columns = shape
    with pytest.raises(ValueError, match=r"capture|scan"):
        Capture("lidar", "/scan", 5, index, rows, columns)
