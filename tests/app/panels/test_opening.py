"""The opening dialog on a real server, worked by a browser's messages."""

import html
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from scanloom.client_session import ClientSession
from scanloom.panels.opening import STORED_RECENT
from scanloom.server.workbench import ServeOptions, Workbench
from tests.app.viser_client import ViserClient, connect
from tests.patience import ENOUGH_S

HOSTILE = '<img src=x onerror="window.taken = 1"> ![a](b) \u202egpj.mcap'


@pytest.fixture(scope="module")
def root(small_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("shelf")
    (root / "inner").mkdir()
    whole = small_scene.read_bytes()
    for name in ("a.mcap", "b.mcap", HOSTILE, "inner/deep.mcap"):
        (root / name).write_bytes(whole)
    (root / "damaged.mcap").write_bytes(whole[:2_000])
    (root / "notes.txt").write_text("no recording")
    return root


@pytest.fixture(scope="module")
def workbench(
    small_scene: Path, root: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Workbench]:
    options = ServeOptions(
        recordings=[small_scene],
        roots=[root],
        port=0,
        output_root=tmp_path_factory.mktemp("out"),
    )
    with Workbench(options) as serving:
        yield serving


class Page:
    """A page whose dialog is open."""

    def __init__(self, workbench: Workbench, client: ViserClient) -> None:
        self.client = client
        self._workbench = workbench
        self.until(lambda: any(s.frame_view for s in workbench.sessions))
        self.client.press("open", "")
        self.says("All places")

    @property
    def session(self) -> ClientSession:
        (session,) = self._workbench.sessions
        return session

    @property
    def text(self) -> str:
        """The dialog's HTML."""
        contents = (str(w.props.get("content") or "") for w in list(self.client.widgets.values()))
        return "".join(text for text in contents if 'class="scanloom-open' in text)

    def until(self, condition: object) -> None:
        self.client.wait_until(condition)  # type: ignore[arg-type]

    def says(self, words: str) -> None:
        self.until(lambda: words in self.text)

    def token(self, name: str, kind: str) -> str:
        """Of a button of this kind in the row of a name."""
        shown = re.escape(html.escape(name))
        pattern = re.compile(
            rf'<li>(?:(?!</li>).)*?data-press="{kind}" data-value="([\d.]+)"(?:(?!</li>).)*?'
            rf">{shown}</bdi>",
            re.DOTALL,
        )
        self.until(lambda: pattern.search(self.text) is not None)
        found = pattern.search(self.text)
        assert found is not None
        return found.group(1)

    def enter(self, name: str) -> None:
        self.client.press("open-folder", self.token(name, "open-folder"))
        self.until(lambda: f'<b aria-current="page"><bdi title="{name}">' in self.text)

    def choose(self, name: str) -> None:
        self.client.press("open-file", self.token(name, "open-file"))

    def shows(self, name: str) -> None:
        self.until(
            lambda: (
                self.session.frame_view is not None
                and self.session.frame_view.view.recording == name
            )
        )


@pytest.fixture
def page(workbench: Workbench) -> Iterator[Page]:
    with connect(workbench.address, storage={}) as client:
        yield Page(workbench, client)
        session = workbench.sessions[0]
    while session in workbench.sessions:
        session.wait(0.05)


def test_a_folder_is_entered_and_a_recording_opened_and_remembered(
    page: Page, root: Path, small_scene: Path
) -> None:
    page.says("s · LiDAR, depth, colour, odometry · ")
    page.enter(root.name)
    page.says("1 other is no recording.")
    page.client.press("open-folder", page.token("inner", "open-file"))
    page.says('<b aria-current="page"><bdi title="inner">')
    page.choose("deep.mcap")
    page.shows("inner/deep.mcap")
    page.until(
        lambda: (
            json.loads(page.client.storage.get(STORED_RECENT, "[]"))
            == ["inner/deep.mcap", small_scene.name]
        )
    )
    # The dialog opens where it was, with the others on top.
    page.client.press("open", "")
    page.until(lambda: 'data-press="open-recent"' in page.text)


def test_a_damaged_file_is_listed_with_its_reason_and_cannot_be_pressed(
    page: Page, root: Path
) -> None:
    page.enter(root.name)
    page.says("is cut short or damaged")
    row = re.search(r"<li>(?:(?!</li>).)*damaged\.mcap(?:(?!</li>).)*</li>", page.text)
    assert row is not None
    assert "scanloom-bad" in row.group()
    assert "data-press" not in row.group()


def test_a_failed_open_leaves_everything_as_it_was(page: Page, root: Path) -> None:
    shutil.copyfile(root / "a.mcap", root / "soon gone.mcap")
    page.enter(root.name)
    token = page.token("soon gone.mcap", "open-file")
    page.session.change_setting("noise", "epsilon", 2.5)
    page.session.change(frame_index=3)
    before = page.session.view
    (root / "soon gone.mcap").write_bytes(b"")
    page.client.press("open-file", token)
    page.says("soon gone.mcap: is empty.")
    assert page.session.view == before
    assert page.session.frame_view is not None
    assert page.session.frame_view.view.recording == before.recording
    # Until it is dismissed.
    page.client.press("open-place", "1")
    page.until(lambda: page.token("a.mcap", "open-file"))
    assert "soon gone.mcap: is empty." in page.text
    page.client.press("open-dismiss", "")
    page.until(lambda: "soon gone.mcap: is empty." not in page.text)
    (root / "soon gone.mcap").unlink()


def test_hostile_names_are_text_and_open(page: Page, root: Path) -> None:
    page.enter(root.name)
    shown = HOSTILE.replace("\u202e", "\\u202e")
    page.choose(shown)
    page.shows(HOSTILE)
    assert "<img src=x" not in page.text
    assert "\u202e" not in page.text


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("open-file", "0.0"),
        ("open-file", "999.0"),
        ("open-file", ""),
        ("open-file", "../../etc/passwd"),
        ("open-file", "1.99999"),
        ("open-file", "1.²"),
        ("open-folder", "-1.-1"),
        ("open-place", "99"),
        ("open-place", "-1"),
        ("open-place", "²"),
        ("open-page", "sideways"),
        ("open-page", "next"),
        ("open-recent", "1.0"),
        ("upload-refused", "<script>"),
    ],
)
def test_other_presses_change_nothing(page: Page, small_scene: Path, name: str, value: str) -> None:
    before = page.session.view
    page.client.press(name, value)
    page.client.press("open-dismiss", "")
    assert page.session.wait(ENOUGH_S)
    assert page.session.view == before
    page.choose(small_scene.name)


@pytest.mark.parametrize(
    "stored",
    [
        "no JSON",
        "{}",
        "[1, 2]",
        json.dumps(["../../etc/passwd", "none.mcap", "x" * 9_000, "a\x00b", ""]),
        json.dumps(["<img src=x onerror=alert(1)>"] * 1_000),
    ],
)
def test_what_a_browser_has_kept_may_be_anything(workbench: Workbench, stored: str) -> None:
    storage = {STORED_RECENT: stored}
    with connect(workbench.address, storage=storage) as client:
        page = Page(workbench, client)
        page.until(lambda: storage[STORED_RECENT].startswith(f'["{page.session.view.recording}"'))
        assert 'data-press="open-recent"' not in page.text
        session = page.session
    while session in workbench.sessions:
        session.wait(0.05)
