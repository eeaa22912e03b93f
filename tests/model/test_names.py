"""Names of files as text that every encoder takes."""

import json
import os

from hypothesis import given
from hypothesis import strategies as st

from fusion_core.model.errors import ScanLoomError
from fusion_core.model.names import escape_undecodable, escape_undecodable_values
from tests.hostile.names import NO_UTF8, SHOWN


@given(st.binary())
def test_any_name_can_be_written(name: bytes) -> None:
    shown = escape_undecodable(os.fsdecode(name))
    # What is no UTF-8 is shown as Python shows bytes; nothing is lost.
    assert shown.encode() == name.decode("utf-8", "backslashreplace").encode()


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_other_text_stays_as_it_is(text: str) -> None:
    assert escape_undecodable(text) == text


@given(st.text(st.characters(categories=["Cs", "Ll"])))
def test_any_text_of_python_can_be_written(text: str) -> None:
    escape_undecodable(text).encode()


def test_all_texts_of_a_result() -> None:
    result = {NO_UTF8: [NO_UTF8, 1, None, {"a": (NO_UTF8, 2.5)}]}
    assert escape_undecodable_values(result) == {SHOWN: [SHOWN, 1, None, {"a": [SHOWN, 2.5]}]}
    json.dumps(escape_undecodable_values(result), ensure_ascii=False).encode()


def test_an_error_can_be_written() -> None:
    error = ScanLoomError(f"{NO_UTF8} is wrong.", file=NO_UTF8, advice=f"See {NO_UTF8}.")
    assert str(error) == rf"{SHOWN}: {SHOWN} is wrong. See {SHOWN}."
    assert (error.problem, error.file, error.advice) == (
        f"{SHOWN} is wrong.",
        SHOWN,
        f"See {SHOWN}.",
    )
