"""Whatever a recording is called, Markdown shows its name and nothing else."""

import re
import string

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.page.markup import escape_markdown, name_html


@given(st.text(alphabet=st.characters(blacklist_categories=("Cs",)), max_size=60))
def test_without_its_backslashes_it_is_the_text_on_one_line(text: str) -> None:
    assert re.sub(r"\\(.)", r"\1", escape_markdown(text)) == " ".join(text.split())


@pytest.mark.parametrize("sign", string.punctuation)
def test_no_sign_of_ascii_means_anything(sign: str) -> None:
    assert escape_markdown(f"a{sign}b") == f"a\\{sign}b"


def test_html_and_pictures_stay_text() -> None:
    hostile = "<img src=x onerror=alert(1)> ![a](b)\n\n# big"
    said = escape_markdown(hostile)
    assert not re.search(r"(?<!\\)[<>\[\]()!#]", said)
    assert "\n" not in said


def test_a_broken_name_is_the_same_text() -> None:
    name = "/camera/depth_raw/<img src=x onerror='a/b_c'>"
    broken = name_html(name, is_broken=True)
    assert broken.replace("<wbr>", "") == name_html(name)
    assert "/<wbr>camera/<wbr>depth_<wbr>raw" in broken
