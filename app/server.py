"""The workbench's server: a guarded viser server that gives every browser a desk of its own."""

import io
import socket
import threading
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import viser

from app.desk import STORED_VIEW, Desk
from app.panels.header import HeaderPanel
from app.panels.map import MapPanel
from app.panels.match import MatchPanel
from app.panels.recording import RecordingPanel
from app.panels.register import RegisterPanel
from app.panels.repair import RepairPanel
from app.panels.scene import ScenePanel
from app.panels.switch import PanelSwitch
from app.panels.timeline import TimelinePanel
from app.resources import sample_path
from app.security import LINK_KEY, Guard, guard_for, guarded
from app.state.library import Library
from app.state.view import View, view_of_link
from app.untrusted import only_values, without_sharing
from fusion_core.model.errors import ScanLoomError, SettingsError

# A browser answers from its own storage, late where it draws without a graphics card; one that does
# not starts afresh.
_STORAGE_TIMEOUT_S = 20.0
# The panels' pictures are then shown at nearly their own size, so that their letters can be read.
_PANEL_PX = 460.0


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Where the workbench listens, and what it may open."""

    recordings: Sequence[Path] = ()
    roots: Sequence[Path] = ()
    host: str = "127.0.0.1"
    port: int = 8080
    output_root: Path = Path("out")
    virtual_row: int | None = None


class Closable(Protocol):
    """A panel with work of its own."""

    def close(self) -> None: ...


class Workbench:
    """A server that listens from ``start`` to ``close``, or as long as a ``with`` block lasts.

    Raises RecordingError, MissingStream and SettingsError for what cannot be opened or listened on.
    """

    def __init__(self, options: ServeOptions) -> None:
        recordings = list(options.recordings) or [sample_path()]
        self._library = Library(recordings, list(options.roots))
        self._first_view = View(recording=self._library.names()[0], virtual_row=options.virtual_row)
        # What cannot be opened is told before anything listens.
        self._library.open(self._first_view)
        _require_address(options.host)
        self.guard: Guard = guard_for(options.host)
        self._options = options
        self._desks: dict[int, tuple[Desk, list[Closable]]] = {}
        self._lock = threading.Lock()

    def start(self) -> None:
        """Listen."""
        options = self._options
        # viser greets on stdout, which belongs to the command.
        with guarded(self.guard), redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(
                host=options.host, port=options.port, label="ScanLoom", verbose=False
            )
        without_sharing(self._server)
        only_values(self._server.gui, _leave)
        self._server.gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False, dark_mode=False
        )
        # Floating, the panel would cover what the scene shows at its right.
        self._server.gui.main_panel.dock_right()
        self._server.gui.main_panel.set_width(_PANEL_PX)
        self._server.scene.set_up_direction("+z")
        self._server.on_client_connect(self._welcome)
        self._server.on_client_disconnect(self._part)

    @property
    def address(self) -> str:
        """What to open in a browser, with the token where one is asked for."""
        host = self._server.get_host()
        name = f"[{host}]" if ":" in host else host
        token = "" if self.guard.token is None else f"/?token={self.guard.token}"
        return f"http://{name}:{self._server.get_port()}{token}"

    @property
    def desks(self) -> list[Desk]:
        """The desks of the browsers that are connected."""
        with self._lock:
            return [desk for desk, _ in self._desks.values()]

    def close(self) -> None:
        """Stop serving and free the files."""
        with self._lock:
            parting = list(self._desks)
        for client_id in parting:
            self._close_desk(client_id)
        with redirect_stdout(io.StringIO()):
            self._server.stop()
        self._library.close()

    def __enter__(self) -> "Workbench":
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _welcome(self, client: viser.ClientHandle) -> None:
        only_values(client.gui, _leave)
        view, problem = self._view_for(client)
        desk = Desk(client, self._library, view)
        closables = _furnish(desk, self._options.output_root)
        with self._lock:
            self._desks[client.client_id] = (desk, closables)
        if client.client_id not in self._server.get_clients():
            # It left while its desk was made.
            self._close_desk(client.client_id)
            return
        if problem is not None:
            desk.fail(problem)
        desk.refresh()

    def _view_for(self, client: viser.ClientHandle) -> tuple[View, ScanLoomError | None]:
        """The view of a link, else the browser's last one, else the first."""
        storage = client.local_storage
        problem: ScanLoomError | None = None
        for key in (LINK_KEY, STORED_VIEW):
            try:
                link = storage.get_item(key, timeout=_STORAGE_TIMEOUT_S)
            except (TimeoutError, RuntimeError):
                break
            if link is None:
                continue
            if key == LINK_KEY:
                storage.remove_item(key)
            try:
                view = view_of_link(link)
                self._library.open(view)
            except ScanLoomError as error:
                problem = problem or error
            else:
                return view, problem
        return self._first_view, problem

    def _part(self, client: viser.ClientHandle) -> None:
        self._close_desk(client.client_id)

    def _close_desk(self, client_id: int) -> None:
        with self._lock:
            parting = self._desks.pop(client_id, None)
        if parting is not None:
            desk, closables = parting
            for panel in closables:
                panel.close()
            desk.close()


def _leave(client_id: int, reason: str) -> None:
    """A refused value changes nothing; typing passes through such values, so nothing is said."""


def _require_address(host: str) -> None:
    """viser waits for ever for an address that cannot be had."""
    try:
        found = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)
        with socket.socket(found[0][0], socket.SOCK_STREAM) as probe:
            probe.bind(found[0][4][:2])
    except OSError as error:
        raise SettingsError(
            f"--host {host}: cannot be listened on ({error.strerror or error}).",
            advice="Name an address of this machine, such as 127.0.0.1.",
        ) from error


def _furnish(desk: Desk, output_root: Path) -> list[Closable]:
    """Put the panels on a desk, in the order from top to bottom; those that run end with it."""
    gui = desk.client.gui
    header = HeaderPanel(gui, desk)
    timeline = TimelinePanel(gui, desk)
    scene = ScenePanel(gui, desk)
    switch = PanelSwitch(gui, desk)
    with switch.folder("Recording"):
        recording = RecordingPanel(gui, desk)
    with switch.folder("Match"):
        match = MatchPanel(gui, desk, scene.take_heatmap)
    with switch.folder("Register"):
        register = RegisterPanel(gui, desk)
    with switch.folder("Repair"):
        repair = RepairPanel(gui, desk)
    with switch.folder("Map"):
        maps = MapPanel(gui, desk, output_root, scene.take_map)
    # The scene last: it shows what the other panels have just drawn.
    desk.panels = [header, timeline, switch, recording, match, register, repair, maps, scene]
    return [timeline, register, maps]
