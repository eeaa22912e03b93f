"""Relations check their arrays."""

from typing import Any

import numpy as np
import pytest

from fusion_core.model.relations import Relations

ONE: dict[str, Any] = {
    "first_stamps_ns": np.array([1]),
    "second_stamps_ns": np.array([2]),
    "T_first_second": np.eye(4)[np.newaxis],
}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"second_stamps_ns": np.array([2, 3])}, "stamps"),
        ({"first_stamps_ns": np.array([1.0])}, "stamps"),
        ({name: array[:0] for name, array in ONE.items()}, "N >= 1"),
        ({"T_first_second": np.eye(4)}, r"\(1, 4, 4\)"),
        ({"T_first_second": np.full((1, 4, 4), np.nan)}, "finite"),
    ],
)
def test_wrong_arrays_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Relations(**{name: array.copy() for name, array in (ONE | wrong).items()})


def test_they_cannot_be_changed() -> None:
    relations = Relations(**{name: array.copy() for name, array in ONE.items()})
    for array in (
        relations.first_stamps_ns,
        relations.second_stamps_ns,
        relations.T_first_second,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
