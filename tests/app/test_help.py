"""Every panel has its help, with a formula that reads aloud and shows on any background."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from scanloom.panels.widgets.help import help_text, keys_text
from scanloom.resources import static_path
from scanloom.state.view import PANELS, PanelName
from tests.pictures.formulas import FORMULAS, svg_of

SVG = "{http://www.w3.org/2000/svg}"


def words_of(text: str) -> list[str]:
    """The words that people read."""
    return re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL).split()


def formula_of(text: str) -> ET.Element:
    """The one formula of a help text."""
    (found,) = re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)
    return ET.fromstring(found)


@pytest.mark.parametrize("panel", PANELS)
def test_every_panel_has_its_help(panel: PanelName) -> None:
    text = help_text(panel)
    assert 120 <= len(words_of(text)) <= 200
    for part in ("What you see", "What the controls do", "What to look for", "In the paper"):
        assert text.count(f"###### {part}\n") == 1
    assert re.search(r"Xu 2024, (eq|Fig|§)", text)


@pytest.mark.parametrize("panel", PANELS)
def test_the_formula_reads_aloud_and_takes_the_texts_colour(panel: PanelName) -> None:
    svg = formula_of(help_text(panel))
    assert svg.tag == f"{SVG}svg"
    assert svg.get("role") == "img"
    assert svg.get("aria-label") == FORMULAS[panel.lower()].words
    assert svg.get("fill") == "currentColor"
    assert {element.tag for element in svg.iter()} == {f"{SVG}svg", f"{SVG}path"}
    # Wider than the panel it would be drawn smaller than the text.
    assert float(svg.attrib["width"].removesuffix("em")) < 22.0


@pytest.mark.parametrize("panel", PANELS)
def test_the_formula_is_the_one_of_the_script(panel: PanelName) -> None:
    drawn = ET.fromstring(svg_of(FORMULAS[panel.lower()]))
    kept = formula_of(help_text(panel))
    # Other versions of the font may move an outline's points, not the outlines.
    for element, other in zip(drawn.iter(f"{SVG}path"), kept.iter(f"{SVG}path"), strict=True):
        assert element.attrib["d"].count("M") == other.attrib["d"].count("M")


@pytest.mark.parametrize("text", [*(help_text(panel) for panel in PANELS), keys_text()])
def test_help_loads_nothing_and_runs_nothing(text: str) -> None:
    without_names = text.replace('xmlns="http://www.w3.org/2000/svg"', "")
    for wrong in ("http:", "https:", "//", "<script", "<a", "href", "src=", "onload", "!["):
        assert wrong not in without_names, wrong
    assert not re.search(r"\]\(", text)


def test_no_file_of_the_help_is_left_over() -> None:
    names = {panel.lower() for panel in PANELS}
    files = {path.name for path in static_path("help").iterdir()}
    assert files == {f"{name}.{kind}" for name in names for kind in ("md", "svg")} | {"keys.md"}
    assert FORMULAS.keys() == names


@pytest.mark.parametrize(
    "key",
    [
        "Space",
        "PageUp, PageDown",
        "K, J",
        "Home, End",
        "M",
        "N, Shift + N",
        "Alt + 1",
        "Ctrl + Z",
        "Ctrl + Shift + Z",
        "P",
        "L",
        "H",
        "Esc",
        "Ctrl + K",
    ],
)
def test_the_keys_are_listed(key: str) -> None:
    assert re.search(rf"^\| {re.escape(key)}[ ,]", keys_text(), flags=re.MULTILINE)


def test_the_logo_is_a_picture_of_its_own() -> None:
    logo: Path = static_path("logo.svg")
    svg = ET.fromstring(logo.read_text(encoding="utf-8"))
    assert svg.get("aria-label") == "ScanLoom"
    assert svg.get("viewBox") == "0 0 64 64"
    assert logo.stat().st_size < 4096
    links = [value for part in svg.iter() for name, value in part.attrib.items() if "href" in name]
    assert links
    assert all(link.startswith("#") for link in links)
