"""batch.parquet and report.html."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import quote

import pyarrow.parquet as pq
import pytest

from fusion_core.evaluation.fleet_quantities import FleetSettings
from fusion_core.exporting import palette
from fusion_core.exporting.small_multiples import (
    LINES_MAX,
    OUTLIER_COLOR,
    Chart,
    ChartLine,
    ChartPoint,
    chart_html,
)
from fusion_core.model.errors import ExportError
from fusion_core.workflows.batch import report as report_module
from fusion_core.workflows.batch import report_page
from fusion_core.workflows.batch.columns import COLUMNS
from fusion_core.workflows.batch.outcome import Outcome
from fusion_core.workflows.batch.report import REPORT_NAME, write_report
from fusion_core.workflows.batch.table_file import TABLE_NAME
from tests.workflows.batch.made_outcomes import DAY_NS, MONDAY_NS, failed, fleet, frame, fused

HOSTILE = "<script>alert(1)</script>\"'&`$title"


class Page(HTMLParser):
    """Tags with their attributes, and the text of the page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""
        self.scripts = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self.open and self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts += data
        else:
            self.text += data


def page_of(folder: Path) -> Page:
    return Page((folder / REPORT_NAME).read_text(encoding="utf-8"))


def outlier(folder: Path) -> Outcome:
    frames = [frame(n, MONDAY_NS + 20 * DAY_NS, lidar_hole=12, depth_hole=12) for n in range(5)]
    return fused(folder, "bumped", frames, yaw_rad=0.2, forward_m=0.05)


def test_the_table_has_each_recording_with_its_flags(tmp_path: Path) -> None:
    outcomes = [*fleet(tmp_path), outlier(tmp_path), failed("cut")]
    summary = write_report(tmp_path, outcomes)
    table = pq.read_table(tmp_path / TABLE_NAME)
    assert table.column_names == [column.name for column in COLUMNS]
    assert table["name"].to_pylist() == [outcome.name for outcome in outcomes]
    rows = {row["name"]: row for row in table.to_pylist()}
    assert rows["bumped"]["flags"] == ["mount moved"]
    (reason,) = rows["bumped"]["reasons"]
    assert re.fullmatch(
        r"mount yaw 11\.46 deg: the others have 6\.\d\d deg, most of them 6\.\d\d to 6\.\d\d deg; "
        r"z = \d+\.\d, flagged from \d+\.\d on\.",
        reason,
    )
    assert [name for name, row in rows.items() if row["flags"]] == ["bumped"]
    assert (rows["cut"]["state"], rows["cut"]["flags"]) == ("failed", [])
    assert (summary.recordings, summary.failed, summary.flagged) == (14, 1, ("bumped",))
    metadata = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    assert FleetSettings.model_validate(json.loads(metadata["fleet_settings"])) == FleetSettings()
    assert summary.notes == ()


def test_the_same_outcomes_have_the_same_bytes(tmp_path: Path) -> None:
    contents = []
    for name in ("a", "b"):
        folder = tmp_path / name
        write_report(folder, [*fleet(folder), failed("cut")])
        contents.append([(folder / file).read_bytes() for file in (TABLE_NAME, REPORT_NAME)])
    assert contents[0] == contents[1]
    assert str(tmp_path).encode() not in b"".join(contents[0])


def test_rows_are_read_in_blocks_of_any_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes = fleet(tmp_path)
    write_report(tmp_path, outcomes)
    whole = pq.read_table(tmp_path / TABLE_NAME)
    monkeypatch.setattr(report_module, "_BLOCK_ROWS", 5)
    write_report(tmp_path, outcomes)
    assert pq.read_table(tmp_path / TABLE_NAME).equals(whole)


def test_the_page_needs_nothing_else(tmp_path: Path) -> None:
    write_report(tmp_path, [*fleet(tmp_path), outlier(tmp_path)])
    page = page_of(tmp_path)
    assert not any("src" in attributes or "href" in attributes for _, attributes in page.tags)
    content = next(a["content"] for t, a in page.tags if t == "meta" and "http-equiv" in a)
    assert content is not None
    assert content.startswith("default-src 'none'")
    assert "http" not in page.text + page.scripts


def test_the_page_says_what_to_look_at_first_and_why(tmp_path: Path) -> None:
    outcomes = [failed("cut", "is cut off.", "Copy it again."), *fleet(tmp_path), outlier(tmp_path)]
    write_report(tmp_path, outcomes)
    text = page_of(tmp_path).text
    first, over_time = text.index("What to look at first"), text.index("Over time")
    section = text[first:over_time]
    for words in (
        "bumped",
        "mount moved",
        "mount yaw 11.46 deg",
        "scanloom view bumped.mcap",
        "cut",
        "is cut off.",
        "Copy it again.",
        "scanloom info cut.mcap --check",
    ):
        assert words in section
    assert section.index("mount moved") < section.index("is cut off.")


def test_names_are_text(tmp_path: Path) -> None:
    outcomes = [
        *fleet(tmp_path, robot="r"),
        fused(tmp_path, "flagged", [frame(0)], robot="r", yaw_rad=1.0),
        failed(HOSTILE, error=HOSTILE, advice=HOSTILE),
    ]
    values = {name: getattr(outcomes[1], name) for name in Outcome.__slots__}
    outcomes[1] = Outcome(**values | {"recording": HOSTILE, "warnings": (HOSTILE,)})
    write_report(tmp_path, outcomes)
    page = page_of(tmp_path)
    assert [tag for tag, _ in page.tags].count("script") == 1
    assert not any(name.startswith("on") for _, attrs in page.tags for name in attrs)
    assert page.text.count(HOSTILE) >= 5
    assert HOSTILE not in page.scripts


@pytest.mark.parametrize(
    ("recording", "command"),
    [
        ("a b.mcap", "scanloom view 'a b.mcap'"),
        ("-o.mcap", "scanloom view ./-o.mcap"),
        ("$(rm).mcap", "scanloom view '$(rm).mcap'"),
    ],
)
def test_commands_can_be_pasted(recording: str, command: str) -> None:
    assert report_page.view_command({"recording": recording, "state": "done"}) == command


def test_links_are_made_only_where_a_workbench_runs(tmp_path: Path) -> None:
    outcomes = [*fleet(tmp_path), failed("cut")]
    write_report(
        tmp_path, outcomes, link=lambda name: f"http://127.0.0.1:8080/go?view={quote(name)}"
    )
    links = [attrs["href"] for tag, attrs in page_of(tmp_path).tags if tag == "a"]
    assert links == [
        f"http://127.0.0.1:8080/go?view={outcome.recording}" for outcome in outcomes[:-1]
    ]


def test_too_few_recordings_are_not_compared_and_the_page_says_so(tmp_path: Path) -> None:
    summary = write_report(tmp_path, [*fleet(tmp_path, 5), outlier(tmp_path)])
    assert summary.flagged == ()
    note = "LiDAR 682 beams 240°, camera 320 × 240 58°: 6 recordings, nothing is compared"
    assert summary.notes[0].startswith(note)
    assert note in page_of(tmp_path).text


def test_an_empty_batch_has_a_page(tmp_path: Path) -> None:
    summary = write_report(tmp_path, [])
    assert summary.recordings == 0
    assert "Nothing stands out." in page_of(tmp_path).text
    assert pq.read_table(tmp_path / TABLE_NAME).num_rows == 0


def test_of_too_many_rows_the_page_shows_those_to_look_at_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_page, "ROWS_MAX", 4)
    write_report(tmp_path, [*fleet(tmp_path), failed("cut"), outlier(tmp_path)])
    page = page_of(tmp_path)
    states = [
        (attrs["data-state"], attrs["data-flags"])
        for tag, attrs in page.tags
        if tag == "tr" and "data-state" in attrs
    ]
    assert states == [("done", ""), ("done", ""), ("failed", ""), ("done", "mount moved")]
    assert "10 more recordings are in batch.parquet" in page.text


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises((ExportError, OSError)):
        write_report(tmp_path / "file", [])


def points(count: int, outlier: int | None = None) -> list[ChartPoint]:
    return [
        ChartPoint(x=float(n), y=float(n % 17), name=f"n{n}", value="1 m", is_outlier=n == outlier)
        for n in range(count)
    ]


def chart(*lines: ChartLine) -> str:
    ends = 0.0, max(point.x for line in lines for point in line.points)
    return chart_html(Chart(title="Mount <yaw>", x_ends=ends, x_labels=("a", "b"), lines=lines))


def test_an_outlier_differs_in_shape_and_colour() -> None:
    drawn = chart(ChartLine(number=0, points=points(10, outlier=3)))
    assert drawn.count("<circle") == 9
    (diamond,) = re.findall(r'<path class="outlier"[^>]*>', drawn)
    assert f'fill="{OUTLIER_COLOR}"' in diamond
    assert "<title>n3: 1 m, flagged</title>" in drawn
    assert "Mount &lt;yaw&gt;" in drawn


def test_of_very_many_points_the_outlier_and_the_ends_stay() -> None:
    drawn = chart(ChartLine(number=0, points=points(20_000, outlier=1777)))
    assert drawn.count("<circle") < 1000
    assert drawn.count('class="outlier"') == 1


def test_lines_beyond_those_that_can_be_told_apart_are_grey() -> None:
    drawn = chart(ChartLine(number=LINES_MAX, points=points(3)))
    assert 'stroke="currentColor"' in drawn


def luminance(color: str) -> float:
    """Relative luminance (WCAG 2.1)."""
    values = [int(color[n : n + 2], 16) / 255.0 for n in (1, 3, 5)]
    linear = [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in values]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("page", ["#ffffff", "#1b1d1f"])
@pytest.mark.parametrize(
    "color", [OUTLIER_COLOR, palette.DEPTH, palette.LIDAR, palette.GOOD, palette.CONFLICT]
)
def test_marks_stand_out_from_both_pages(page: str, color: str) -> None:
    low, high = sorted([luminance(page), luminance(color)])
    assert (high + 0.05) / (low + 0.05) >= 3.0
