"""The workbench's server: a guarded viser server that gives every browser a desk of its own."""

import io
import threading
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import viser

from fusion_core.model.errors import ExportError, ScanLoomError
from scanloom.client_session import STORED_VIEW, ClientSession
from scanloom.panels.header import HeaderPanel
from scanloom.panels.map import MapPanel
from scanloom.panels.match import MatchPanel
from scanloom.panels.recording import RecordingPanel
from scanloom.panels.register import RegisterPanel
from scanloom.panels.repair import RepairPanel
from scanloom.panels.scene import ScenePanel
from scanloom.panels.timeline import TimelinePanel
from scanloom.panels.widgets.panel_switch import PanelSwitch
from scanloom.resources import sample_path
from scanloom.server import browser_storage as storage
from scanloom.server.connections import Connections
from scanloom.server.error_log import ErrorLog, error_summary, websockets_logger
from scanloom.server.listening import free_port
from scanloom.server.message_filter import MOST_BYTES, disable_share_tunnel, restrict_gui_updates
from scanloom.server.security import LINK_KEY, Guard, guard_for, guarded
from scanloom.state.library import Library
from scanloom.state.view import View, view_of_link

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

    Raises RecordingError, MissingStream, SettingsError and ExportError for what cannot be opened,
    listened on or written to.

    viser's threads and its event loop are everybody's: nothing waits in them. What a browser takes
    to come and to go runs in threads of its own.
    """

    def __init__(self, options: ServeOptions) -> None:
        # What cannot be had is told before anything is opened, and that before anything listens.
        _require_folder(options.output_root)
        self._port = free_port(options.host, options.port)
        recordings = list(options.recordings) or [sample_path()]
        self._library = Library(recordings, list(options.roots))
        self._first_view = View(recording=self._library.names()[0], virtual_row=options.virtual_row)
        self._library.open(self._first_view)
        self.guard: Guard = guard_for(options.host)
        self._options = options
        self._sessions: dict[int, tuple[ClientSession, list[Closable]]] = {}
        self._lock = threading.Lock()
        self._is_closed = False
        self._error_log = ErrorLog()
        self._connections = Connections(self._error_log)

    def start(self) -> None:
        """Listen."""
        options = self._options
        # viser greets on stdout, which belongs to the command.
        serving = guarded(
            self.guard,
            create_connection=self._connections.make,
            max_size=MOST_BYTES,
            logger=websockets_logger(self._error_log),
        )
        with serving, redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(
                host=options.host, port=self._port, label="ScanLoom", verbose=False
            )
        _tell_in_one_line(self._server, self._error_log)
        disable_share_tunnel(self._server)
        restrict_gui_updates(self._server.gui, _leave)
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
    def sessions(self) -> list[ClientSession]:
        """The desks of the browsers that are connected."""
        with self._lock:
            return [session for session, _ in self._sessions.values()]

    def close(self) -> None:
        """Stop serving and free the files."""
        with self._lock:
            self._is_closed = True
            parting = list(self._sessions)
        for client_id in parting:
            self._close_session(client_id)
        with redirect_stdout(io.StringIO()):
            self._server.stop()
        self._library.close()

    def __enter__(self) -> "Workbench":
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    async def _welcome(self, client: viser.ClientHandle) -> None:
        """Give a browser its desk, once it has told what it keeps."""
        restrict_gui_updates(client.gui, _leave)

        def on_answer(answers: storage.Answers) -> None:
            if answers[LINK_KEY] is not None:
                client.local_storage.remove_item(LINK_KEY)
            links = [link for key in (LINK_KEY, STORED_VIEW) if (link := answers[key]) is not None]
            _in_own_thread("welcome", self._open_session, client, links)

        storage.ask(client, (LINK_KEY, STORED_VIEW), on_answer)

    def _open_session(self, client: viser.ClientHandle, links: list[str]) -> None:
        try:
            self._furnish(client, links)
        except Exception as error:  # noqa: BLE001  # it may have left meanwhile
            if client.client_id in self._server.get_clients():
                self._error_log.tell(f"browser {client.client_id}", error_summary(error))

    def _furnish(self, client: viser.ClientHandle, links: list[str]) -> None:
        view, problem = self._view_for(links)
        session = ClientSession(client, self._library, view)
        closables = _furnish(session, self._options.output_root)
        with self._lock:
            self._sessions[client.client_id] = (session, closables)
            is_closed = self._is_closed
        if is_closed or client.client_id not in self._server.get_clients():
            # It left while its desk was made.
            self._close_session(client.client_id)
            return
        if problem is not None:
            session.fail(problem)
        session.refresh()

    def _view_for(self, links: list[str]) -> tuple[View, ScanLoomError | None]:
        """The first of the links that can be followed, else the first view; and why not an earlier
        one."""
        problem: ScanLoomError | None = None
        for link in links:
            try:
                view = view_of_link(link)
                self._library.open(view)
            except ScanLoomError as error:
                problem = problem or error
            else:
                return view, problem
        return self._first_view, problem

    async def _part(self, client: viser.ClientHandle) -> None:
        _in_own_thread("parting", self._close_session, client.client_id)

    def _close_session(self, client_id: int) -> None:
        with self._lock:
            parting = self._sessions.pop(client_id, None)
        if parting is not None:
            session, closables = parting
            for panel in closables:
                panel.close()
            session.close()


def _leave(client_id: int, reason: str) -> None:
    """A refused value changes nothing; typing passes through such values, so nothing is said."""


def _in_own_thread(name: str, work: Callable[..., None], *args: Any) -> None:
    threading.Thread(target=work, args=args, name=name, daemon=True).start()


def _require_folder(output_root: Path) -> None:
    """Exports make the folder when they need it; what is no folder is told before anything is
    computed for it."""
    if (output_root.exists() or output_root.is_symlink()) and not output_root.is_dir():
        raise ExportError("is not a folder.", file=output_root, advice="Name another with -o.")


def _tell_in_one_line(server: viser.ViserServer, error_log: ErrorLog) -> None:
    """What fails in the server's own loop and threads is told without a traceback."""
    loop = server.get_event_loop()

    def on_error(_: object, context: dict[str, Any]) -> None:
        error = context.get("exception")
        what = str(context.get("message", "failed"))
        error_log.tell("server", f"{what}: {error_summary(error)}" if error else what)

    loop.call_soon_threadsafe(loop.set_exception_handler, on_error)
    pool: Any = server._thread_executor
    submit = pool.submit

    def submit_told(work: Callable[..., Any], *args: Any) -> Any:
        def told() -> None:
            try:
                work(*args)
            except Exception as error:  # noqa: BLE001  # viser prints a traceback of it
                error_log.tell("a widget's callback", error_summary(error))

        return submit(told)

    pool.submit = submit_told


def _furnish(session: ClientSession, output_root: Path) -> list[Closable]:
    """Put the panels on a desk, in the order from top to bottom; those that run end with it."""
    gui = session.client.gui
    header = HeaderPanel(gui, session)
    timeline = TimelinePanel(gui, session)
    scene = ScenePanel(gui, session)
    switch = PanelSwitch(gui, session)
    with switch.folder("Recording"):
        recording = RecordingPanel(gui, session)
    with switch.folder("Match"):
        match = MatchPanel(gui, session, scene.set_heatmap_source)
    with switch.folder("Register"):
        register = RegisterPanel(gui, session)
    with switch.folder("Repair"):
        repair = RepairPanel(gui, session)
    with switch.folder("Map"):
        maps = MapPanel(gui, session, output_root, scene.set_map)
    # The scene last: it shows what the other panels have just drawn.
    session.panels = [header, timeline, switch, recording, match, register, repair, maps, scene]
    return [timeline, register, maps]
