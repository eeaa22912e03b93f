"""The workbench's server: a guarded viser server with a session for each browser."""

import io
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import viser
from viser.infra import WebsockClientConnection

from fusion_core.model.errors import ExportError, ScanLoomError
from fusion_core.workflows.fuse.session import FuseOptions
from scanloom.client_session import STORED_VIEW, ClientSession
from scanloom.page import browser_storage as storage
from scanloom.page.layout import FIRST_WINDOW_PX, page_sizes
from scanloom.panels.registry import add_panels
from scanloom.plots.text import text_width
from scanloom.resources import SAMPLE_FRAME, sample_path
from scanloom.server.connections import Connections
from scanloom.server.error_log import ErrorLog, error_summary, websockets_logger
from scanloom.server.listening import free_port
from scanloom.server.message_filter import (
    MAX_MESSAGE_BYTES,
    disable_share_tunnel,
    restrict_gui_updates,
)
from scanloom.server.pages import LINK_KEY, prepare_start_page
from scanloom.server.security import Guard, guard_for, guarded
from scanloom.server.sending import send_without_fail
from scanloom.server.upload_socket import UPLOAD_PATH, receive_upload
from scanloom.state.library import Library
from scanloom.state.uploads import DEFAULT_LIMIT_BYTES
from scanloom.state.view import View, view_of_link

# The alignment waits no longer for a browser that draws slowly, or not at all.
_DRAWN_WITHIN_S = 3.0
# The end of the server waits no longer for a session that is being opened or closed.
_END_TIMEOUT_S = 15.0
# Of the scene, as a share of a surface's own brightness times pi; set by eye, so that a box's sides
# are told apart and none is black.
_AMBIENT_LIGHT = 1.5


@dataclass(frozen=True, kw_only=True)
class ServeOptions:
    """Where the workbench listens, and what it may open."""

    recordings: Sequence[Path] = ()
    roots: Sequence[Path] = ()
    host: str = "127.0.0.1"
    port: int = 8080
    output_root: Path = Path("out")
    virtual_row: int | None = None
    upload_limit_bytes: int = DEFAULT_LIMIT_BYTES
    label_address: str | None = None
    extrinsics_file: Path | None = None


class Workbench:
    """A server that listens from ``start`` to ``close``, or within a ``with`` block.

    Raises RecordingError, MissingStream, SettingsError and ExportError for a recording, an address
    or an output folder that cannot be used.

    viser's threads and event loop are shared by all browsers, so nothing may block them: sessions
    are opened and closed in threads of their own.
    """

    def __init__(self, options: ServeOptions) -> None:
        # Problems are reported before the server listens.
        _require_folder(options.output_root)
        self._port = free_port(options.host, options.port)
        recordings, first_frame = list(options.recordings), 0
        if not recordings:
            recordings, first_frame = [sample_path()], SAMPLE_FRAME
        self._library = Library(
            recordings,
            list(options.roots),
            options.upload_limit_bytes,
            label_address=options.label_address,
            label_folder=options.output_root / "labels",
            given=FuseOptions(extrinsics_file=options.extrinsics_file).given_extrinsics(),
        )
        self._first_view = View(
            recording=next(iter(self._library.named())),
            frame_index=first_frame,
            virtual_row=options.virtual_row,
        )
        self._library.open(self._first_view)
        self.guard: Guard = guard_for(options.host)
        self._options = options
        self._sessions: dict[int, ClientSession] = {}
        self._stored_views: WeakKeyDictionary[WebsockClientConnection, Future[storage.Answers]]
        self._stored_views = WeakKeyDictionary()
        self._lock = threading.Lock()
        self._is_closed = False
        # They open or close a session.
        self._threads: set[threading.Thread] = set()
        self._error_log = ErrorLog()
        self._connections = Connections(self._error_log)

    def start(self) -> None:
        """Start to listen."""
        options = self._options
        # viser prints a greeting, but stdout belongs to the command.
        serving = guarded(
            self.guard,
            {UPLOAD_PATH: partial(receive_upload, uploads=self._library.uploads)},
            create_connection=self._connections.create,
            max_size=MAX_MESSAGE_BYTES,
            logger=websockets_logger(self._error_log),
        )
        with serving, redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(
                host=options.host, port=self._port, label="ScanLoom", verbose=False
            )
        _log_server_errors(self._server, self._error_log)
        disable_share_tunnel(self._server)
        restrict_gui_updates(self._server.gui, _ignore_refusal)
        self._server.gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False, dark_mode=False
        )
        # A floating panel would cover the right part of the scene until the page is laid out, and
        # each change of its width draws the whole scene some times.
        self._server.gui.main_panel.dock_right()
        self._server.gui.main_panel.set_width(page_sizes(*FIRST_WINDOW_PX).right_px)
        scene = self._server.scene
        scene.set_up_direction("+z")
        # Nothing here mirrors its surroundings or casts a shadow, and until a browser has decoded
        # viser's photograph of a city it hides the scene behind 5 % opacity.
        scene.configure_environment_map(None)
        scene.configure_default_lights(cast_shadow=False)
        # Without that photograph, what the lights do not reach would be black.
        scene.add_light_ambient("/ambient_light", intensity=_AMBIENT_LIGHT)
        sockets = self._server._websock_server
        sockets.on_client_connect(send_without_fail)
        sockets.on_client_connect(self._request_stored_view)
        self._server.on_client_connect(self._on_connect)
        self._server.on_client_disconnect(self._on_disconnect)
        self._run_in_thread("prepare", _prepare)

    @property
    def address(self) -> str:
        """The URL to open in a browser, with the token where one is required."""
        host = self._server.get_host()
        name = f"[{host}]" if ":" in host else host
        token = "" if self.guard.token is None else f"/?token={self.guard.token}"
        return f"http://{name}:{self._server.get_port()}{token}"

    @property
    def sessions(self) -> list[ClientSession]:
        """The sessions of the connected browsers."""
        with self._lock:
            return list(self._sessions.values())

    def close(self) -> None:
        """Stop the server and close the recordings."""
        with self._lock:
            self._is_closed = True
            at_work = list(self._threads)
        # A page takes clicks before it is built whole: then its session closes itself.
        for thread in at_work:
            thread.join(_END_TIMEOUT_S)
        with self._lock:
            client_ids = list(self._sessions)
        for client_id in client_ids:
            self._close_session(client_id)
        with redirect_stdout(io.StringIO()):
            self._server.stop()
        self._library.close()

    def __enter__(self) -> "Workbench":
        self.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _request_stored_view(self, connection: WebsockClientConnection) -> None:
        """Request it at once: viser counts a browser as connected after its first picture only."""
        stored_view: Future[storage.Answers] = Future()
        self._stored_views[connection] = stored_view
        storage.request_from(connection, (LINK_KEY, STORED_VIEW), stored_view.set_result)

    async def _on_connect(self, client: viser.ClientHandle) -> None:
        """Open a session once the browser has sent its stored view."""
        restrict_gui_updates(client.gui, _ignore_refusal)

        def open_session(stored_view: Future[storage.Answers]) -> None:
            answers = stored_view.result()
            if answers[LINK_KEY] is not None:
                client.local_storage.remove_item(LINK_KEY)
            links = [link for key in (LINK_KEY, STORED_VIEW) if (link := answers[key]) is not None]
            self._run_in_thread("connect", self._open_session, client, links)

        connection = client._websock_connection
        if connection not in self._stored_views:
            # A page that was left open may connect while the server starts.
            self._request_stored_view(connection)
        self._stored_views[connection].add_done_callback(open_session)

    def _open_session(self, client: viser.ClientHandle, links: list[str]) -> None:
        try:
            self._start_session(client, links)
        except Exception as error:  # noqa: BLE001  # the browser may have disconnected meanwhile
            if client.client_id in self._server.get_clients():
                self._error_log.report(f"browser {client.client_id}", error_summary(error))

    def _start_session(self, client: viser.ClientHandle, links: list[str]) -> None:
        view, problem = self._view_for(links)
        session = ClientSession(
            client,
            self._library,
            view,
            after_drawing=lambda start: storage.call_when_taken_in(client, start, _DRAWN_WITHIN_S),
        )
        try:
            with session.building():
                add_panels(client, session, self._options.output_root)
        except Exception:
            session.close()
            raise
        with self._lock:
            self._sessions[client.client_id] = session
            is_closed = self._is_closed
        if is_closed or client.client_id not in self._server.get_clients():
            # It disconnected while its session was made.
            self._close_session(client.client_id)
            return
        if problem is not None:
            session.show_failure(problem)
        session.refresh()

    def _view_for(self, links: list[str]) -> tuple[View, ScanLoomError | None]:
        """The view of the first valid link, else the default; and the first link's problem."""
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

    async def _on_disconnect(self, client: viser.ClientHandle) -> None:
        self._run_in_thread("disconnect", self._close_session, client.client_id)

    def _run_in_thread(self, name: str, work: Callable[..., None], *args: Any) -> None:
        def run() -> None:
            try:
                work(*args)
            finally:
                with self._lock:
                    self._threads.discard(threading.current_thread())

        thread = threading.Thread(target=run, name=name, daemon=True)
        with self._lock:
            # One that is seen can be joined.
            self._threads.add(thread)
            thread.start()

    def _close_session(self, client_id: int) -> None:
        with self._lock:
            session = self._sessions.pop(client_id, None)
        if session is not None:
            session.close()


def _prepare() -> None:
    """What the first session would wait for, done while a browser starts."""
    prepare_start_page()
    # The first text on a picture imports matplotlib.
    text_width("0")


def _ignore_refusal(client_id: int, reason: str) -> None:
    """A refused value changes nothing. Typing passes through such values: no message."""


def _require_folder(output_root: Path) -> None:
    """Raises ExportError if the path exists and is no folder. (Exports create a missing one.)"""
    if (output_root.exists() or output_root.is_symlink()) and not output_root.is_dir():
        raise ExportError("is not a folder.", file=output_root, advice="Name another with -o.")


def _log_server_errors(server: viser.ViserServer, error_log: ErrorLog) -> None:
    """Log errors of the server's event loop and threads in one line, without a traceback."""
    loop = server.get_event_loop()

    def on_error(_: object, context: dict[str, Any]) -> None:
        error = context.get("exception")
        what = str(context.get("message", "failed"))
        error_log.report("server", f"{what}: {error_summary(error)}" if error else what)

    loop.call_soon_threadsafe(loop.set_exception_handler, on_error)
    pool: Any = server._thread_executor
    submit = pool.submit

    def submit_logged(work: Callable[..., Any], *args: Any) -> Any:
        def run() -> None:
            try:
                work(*args)
            except Exception as error:  # noqa: BLE001  # viser prints a traceback of it
                error_log.report("a widget's callback", error_summary(error))

        return submit(run)

    pool.submit = submit_logged
