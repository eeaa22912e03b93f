"""Layers side by side, and runs in them, against dictionaries and a flood fill."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion_core.annotation.aligned_layers import align_layers
from fusion_core.annotation.runs import number_runs
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.labels import NO_LABEL, Capture, CaptureLabels, Label
from tests.annotation.drawn_layers import CAPTURES, Samples, layers, samples_of


@given(st.lists(layers(), min_size=1, max_size=3), st.integers(1, 40))
def test_each_sample_stands_once_with_what_each_layer_says(
    drawn: list[list[CaptureLabels]], samples_per_block: int
) -> None:
    names = [f"layer {number}" for number in range(len(drawn))]
    found: list[Samples] = [{} for _ in drawn]
    order = []
    for block in align_layers(
        dict(zip(names, drawn, strict=True)), samples_per_block=samples_per_block
    ):
        assert block.layers == tuple(names)
        assert block.capture.size <= samples_per_block or len(block.captures) == 1
        for capture, samples in block:
            for row, column, codes in zip(
                block.row[samples].tolist(),
                block.column[samples].tolist(),
                block.codes[:, samples].T.tolist(),
                strict=True,
            ):
                order.append((capture, row, column))
                for own, code in zip(found, codes, strict=True):
                    if code != NO_LABEL:
                        own[order[-1]] = Label(code)
    assert found == [samples_of(layer) for layer in drawn]
    assert order == sorted(set().union(*found))


@given(layers())
def test_runs_are_what_a_flood_fill_finds(drawn: list[CaptureLabels]) -> None:
    for block in align_layers({"one": drawn}):
        codes = block.codes[0].astype(np.int64)
        within = (block.row + 2 * block.column + codes) % 5 != 0
        number = number_runs(block, codes, within)
        assert (number[~within] == -1).all()
        of_sample = {
            (capture, row, column): (code, run)
            for capture, row, column, code, run in zip(
                block.capture[within].tolist(),
                block.row[within].tolist(),
                block.column[within].tolist(),
                codes[within].tolist(),
                number[within].tolist(),
                strict=True,
            )
        }
        seen: set[tuple[int, int, int]] = set()
        expected = 0
        for start, (code, run) in of_sample.items():
            if start in seen:
                continue
            waiting = [start]
            while waiting:
                place = waiting.pop()
                if place in seen or of_sample.get(place, (None,))[0] != code:
                    continue
                seen.add(place)
                assert of_sample[place][1] == run == expected
                capture, row, column = place
                waiting += [(capture, row + step, column) for step in (-1, 1)]
                waiting += [(capture, row, column + step) for step in (-1, 1)]
            expected += 1


def label_one(capture: Capture) -> CaptureLabels:
    return CaptureLabels.of_samples(capture, np.zeros(1, int), np.zeros(1, int), Label.HOLE)


def test_one_message_has_one_size() -> None:
    wide = Capture("lidar", "/scan", 5, 0, 1, 99)
    with pytest.raises(ScanLoomError, match=r"/scan at 5 ns .* 1 x 5 and for 1 x 99"):
        list(align_layers({"a": [label_one(CAPTURES[4])], "b": [label_one(wide)]}))


def test_a_layer_out_of_order_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(ValueError, match="out of order"):
        list(align_layers({"a": [label_one(CAPTURES[1]), label_one(CAPTURES[0])]}))
