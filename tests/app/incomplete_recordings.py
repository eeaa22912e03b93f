"""Recordings that lack a sensor: parts of a small scene, and a page that shows them."""

import html
import re
from collections.abc import Sequence
from pathlib import Path

from fusion_core.workflows.convert import ConvertOptions, convert
from scanloom.client_session import ClientSession
from scanloom.server.workbench import Workbench
from scanloom.state.view import PANELS, View
from tests.app.viser_client import ViserClient
from tests.patience import ENOUGH_S

TOPICS: dict[str, Sequence[str]] = {
    "lidar.mcap": ["/scan", "/odom", "/tf", "/tf_static"],
    "scans.mcap": ["/scan"],
    "depth.mcap": [
        "/camera/depth/image_raw",
        "/camera/depth/camera_info",
        "/camera/color/image_raw",
    ],
    "uncalibrated.mcap": ["/scan", "/camera/depth/image_raw"],
    "depth uncalibrated.mcap": ["/camera/depth/image_raw"],
    "odometry.mcap": ["/odom"],
    "color.mcap": ["/camera/color/image_raw"],
}


def write_parts(scene: Path, folder: Path) -> list[Path]:
    """Each part of a scene as a recording of its own, and one without a message."""
    paths = []
    for name, topics in TOPICS.items():
        paths.append(folder / name)
        convert(scene, paths[-1], ConvertOptions(topics=topics), lambda *_: None)
    return paths


class Reader:
    """Reads what one page says."""

    def __init__(self, workbench: Workbench, client: ViserClient) -> None:
        self._workbench, self._client = workbench, client
        client.wait_until(lambda: bool(workbench.sessions))
        self.wait()

    @property
    def session(self) -> ClientSession:
        """The page's session."""
        (session,) = self._workbench.sessions
        return session

    def show(self, **values: object) -> None:
        """Change the view, and wait until the page shows it."""
        self.session.change(**values)
        self.wait()

    def open(self, name: str, **values: object) -> None:
        """Open a recording as the page's own choice does."""
        self.show(**dict(View(recording=name)) | values)

    def wait(self) -> None:
        """Wait until the requested view is shown, and the alignment has ended if there is one."""

        def is_shown() -> bool:
            shown = self.session.frame_view
            wanted = self.session.view
            return (
                shown is not None
                and (shown.view.recording, shown.view.panel) == (wanted.recording, wanted.panel)
                and not shown.is_being_aligned
            )

        self._client.wait_until(is_shown)
        assert self.session.wait(ENOUGH_S)
        # The browser has read everything once it has the view that is sent last.
        link = self.session.view.to_link()
        self._client.wait_until(lambda: self._client.storage.get("view") == link)

    def html_with(self, sign: str) -> str:
        """The visible HTML that holds a sign."""
        widgets = self._client.widgets.values()
        found = [
            str(widget.props["content"])
            for widget in widgets
            if widget.props.get("visible") and sign in str(widget.props.get("content", ""))
        ]
        return found[-1] if found else ""

    @property
    def verdict(self) -> str:
        """The verdict's words."""
        return plain(self.html_with("scanloom-verdict"))

    @property
    def grey_steps(self) -> dict[str, str]:
        """The reason, as the hint says it, of each step that is grey."""
        steps = self.html_with("scanloom-steps")
        found: dict[str, str] = {}
        for attributes in re.findall(r"<button ([^>]*)>", steps):
            if 'aria-disabled="true"' in attributes:
                (name,) = re.findall(r'aria-label="([^"]*)"', attributes)
                (hint,) = re.findall(r'title="([^"]*)"', attributes)
                found[name] = html.unescape(hint)
        assert found.keys() <= set(PANELS)
        return found

    def notes(self) -> list[str]:
        """The notifications since the last call."""
        return [
            f"{one.message['props']['title']} {one.message['props']['body']}"
            for one in self._client.drain()
            if one.type == "NotificationShowMessage"
        ]


def plain(content: str) -> str:
    """The words of HTML, with a space between blocks."""
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", content)).split())
