"""The opening dialog: recordings of the allowed folders, recent ones, and uploads."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import viser

from fusion_core.model.errors import RecordingError, ScanLoomError
from scanloom.client_session import ClientSession
from scanloom.frame_view import FrameView, as_failure
from scanloom.jobs.latest_only_worker import LatestOnlyWorker
from scanloom.jobs.long_job import Cancelled
from scanloom.jobs.recording_opener import RecordingOpener
from scanloom.page.bridge import PageBridge, script_html
from scanloom.page.browser_storage import Answers, request_items
from scanloom.page_parts import Panel
from scanloom.panels.batch_html import batch_html
from scanloom.panels.batch_walk import BatchWalkPanel
from scanloom.panels.opening_html import (
    READING_HTML,
    OpeningRow,
    OpeningStatus,
    index_of,
    pages_html,
    places_html,
    recent_html,
    rows_html,
    status_html,
)
from scanloom.panels.opening_rows import BatchPage, BatchReader, folder_rows, place_rows
from scanloom.panels.opening_window import OpeningWindow
from scanloom.state.batch_list import BatchWalk, is_batch
from scanloom.state.folder_listing import FolderPage, FolderPlace
from scanloom.state.recent_names import parse_recent, with_recent
from scanloom.state.uploads import UploadListener, UploadProgress
from scanloom.state.view import View

# Key of the recent names in the browser's local storage.
STORED_RECENT = "recent"
_ALL_PLACES = "All places"
_MAX_FIND_CHARACTERS = 200
_REFUSED_DROPS = {
    "folder": "A folder cannot be uploaded: start scanloom view with --root and its folder.",
    "several": "Only one file can be uploaded at a time.",
    "unconnected": "The upload could not begin: the server did not answer. Try again.",
}


class OpeningDialog(Panel, UploadListener):
    """Chooses another recording. What is displayed stays until the other one is open."""

    def __init__(
        self,
        client: viser.ClientHandle,
        bridge: PageBridge,
        session: ClientSession,
        walk: BatchWalkPanel,
    ) -> None:
        self._client, self._gui, self._session = client, client.gui, session
        self._library = session.library
        self._uploads = self._library.uploads.new_session(self)
        self._opener = RecordingOpener(
            self._library, self._on_opened, self._on_failed, self._on_dropped
        )
        self._lock = threading.RLock()
        self._window: OpeningWindow | None = None
        # None for the list of places.
        self._place: FolderPlace | None = None
        self._starts: list[int] = []
        self._page: FolderPage | None = None
        self._rows: list[OpeningRow] = []
        self._batches = BatchReader(self._library)
        self._batch_page: BatchPage | None = None
        self._walk = walk
        walk.set_opener(self._open_recording)
        self._is_reading = False
        self._recent: list[str] = []
        # Of the rows: a press on a row of a former list is ignored.
        self._serial = 0
        self._status: OpeningStatus | None = None
        self._shown_recording: str | None = None
        self._worker = LatestOnlyWorker(
            "opening dialog", self._read_place, lambda error: self._fail(str(error))
        )
        ticket = self._uploads.ticket if self._library.uploads.limit_bytes else ""
        place = f'<div hidden data-upload="{ticket}"></div>' if ticket else ""
        self._gui.add_html(script_html("opening.js") + place)
        bridge.add_key("Open a recording", "O", self.open)
        answers: dict[str, Callable[[str], None]] = {
            "open": lambda _: self.open(),
            "open-close": lambda _: self.close_window(),
            "open-cancel": lambda _: self._cancel(),
            "open-dismiss": lambda _: self._set_status(None),
            "open-place": self._go_up_to,
            "open-folder": self._enter,
            "open-file": self._choose,
            "open-recent": self._choose_recent,
            "open-page": self._turn_page,
            "batch-sort": self._sort,
            "upload-refused": lambda reason: self._fail(_REFUSED_DROPS.get(reason, "")),
        }
        for name, answer in answers.items():
            bridge.on_press(name, answer)

    def show(self, frame_view: FrameView) -> None:
        """Have the browser remember the recording."""
        name = frame_view.view.recording
        if name == self._shown_recording:
            return
        self._shown_recording = name
        if self._library.uploads.path(name) is None:

            def remember(answers: Answers) -> None:
                stored = with_recent(parse_recent(answers[STORED_RECENT]), name)
                self._client.local_storage.set_item(STORED_RECENT, stored)

            request_items(self._client, (STORED_RECENT,), remember)

    def close(self) -> None:
        """End the work, and delete the uploads."""
        with self._lock:
            self._window = None
        self._worker.close()
        self._opener.cancel()
        self._library.details.release(self)
        self._uploads.close()

    def open(self) -> None:
        """Open the dialog where it was last."""
        with self._lock:
            if self._window is None:
                self._window = OpeningWindow(
                    self._gui, self._library.uploads.limit_bytes, self._find
                )
                self._window.set_find(self._place)
                self._read_again()

        def on_answer(answers: Answers) -> None:
            # The event loop, which calls this, must not wait for the page.
            threading.Thread(
                target=self._on_recent, args=(answers,), name="recent", daemon=True
            ).start()

        request_items(self._client, (STORED_RECENT,), on_answer)

    def close_window(self) -> None:
        """Close the dialog, and give up what it was about to open."""
        self._cancel()
        with self._lock:
            window, self._window = self._window, None
            self._status = None
            self._library.details.release(self)
        if window is not None:
            window.close()

    # Where one is

    def _enter(self, token: str) -> None:
        row = self._row_of(token)
        if row is None or not row.can_enter or row.path is None:
            return
        root = next((r for r in self._library.roots if row.path.is_relative_to(r)), None)
        if root is not None:
            # A link may lead to a folder inside another root.
            own = self._place.root if self._place is not None else row.path
            root = own if row.path.is_relative_to(own) and own in self._library.roots else root
            self._go_to(FolderPlace(root=root, folder=row.path))

    def _go_up_to(self, depth: str) -> None:
        with self._lock:
            place = self._place
        if place is None or not depth.isdecimal() or len(depth) > 3:
            return
        if depth == "0":
            self._go_to(None)
            return
        parts = place.folder.relative_to(place.root).parts
        self._go_to(
            FolderPlace(root=place.root, folder=place.root.joinpath(*parts[: int(depth) - 1]))
        )

    def _find(self, text: str) -> None:
        with self._lock:
            place = self._place
        if place is not None and text != place.find:
            self._go_to(replace(place, find=text[:_MAX_FIND_CHARACTERS], start=0))

    def _turn_page(self, direction: str) -> None:
        with self._lock:
            place, page = self._place, self._page
            if place is None or page is None:
                return
            if direction == "next" and page.next_start is not None:
                self._starts.append(place.start)
                self._go_to(replace(place, start=page.next_start), keep_starts=True)
            elif direction == "previous" and self._starts:
                self._go_to(replace(place, start=self._starts.pop()), keep_starts=True)

    def _go_to(self, place: FolderPlace | None, *, keep_starts: bool = False) -> None:
        with self._lock:
            self._place = place
            if not keep_starts:
                self._starts.clear()
            if self._window is not None:
                self._window.set_find(place)
            self._read_again()

    def _read_again(self) -> None:
        self._page, self._rows, self._is_reading = None, [], True
        self._serial += 1
        self._render()
        self._worker.submit(_Reading(self._place))

    def _read_place(self, reading: "_Reading", is_newest: Callable[[], bool]) -> None:
        place = reading.place

        def check() -> None:
            if not is_newest():
                raise Cancelled

        page, batch_page = None, None
        if place is None:
            rows = self._places()
        elif is_batch(place.folder):
            page, rows, batch_page = self._batches.read(place)
        else:
            page, rows = folder_rows(self._library, place, check)
        check()
        with self._lock:
            if self._window is None:
                return
            self._page, self._rows, self._is_reading = page, rows, False
            self._batch_page = batch_page
            self._serial += 1
            self._render()
        wanted = [row.path for row in rows if row.is_recording and row.path is not None]
        self._library.details.request(self, wanted, self._render)

    def _places(self) -> list[OpeningRow]:
        """Uploads, the recordings given at the start, and the roots."""
        uploads = {name: self._uploads.path(name) for name in self._uploads.names()}
        found = {**uploads, **self._library.named()}
        labels = ((name, self._label(name), path) for name, path in found.items())
        return place_rows(self._library, labels)

    def _sort(self, column: str) -> None:
        with self._lock:
            place = self._place
            self._batches.sort(column)
        if place is not None:
            self._go_to(replace(place, start=0))

    # What is chosen

    def _choose(self, token: str) -> None:
        with self._lock:
            index = index_of(token, self._serial, len(self._rows))
            name = None if index is None else self._rows[index].name
            page, place = self._batch_page, self._place
        if index is None or name is None:
            return
        if page is not None and place is not None:
            self._walk.begin(BatchWalk(page.batch, page.numbers, place.start + index), name)
        self._open_recording(name)

    def _choose_recent(self, token: str) -> None:
        with self._lock:
            index = index_of(token, self._serial, len(self._recent))
            name = None if index is None else self._recent[index]
        if name is not None:
            self._open_recording(name)

    def _row_of(self, token: str) -> OpeningRow | None:
        with self._lock:
            index = index_of(token, self._serial, len(self._rows))
            return None if index is None else self._rows[index]

    def _open_recording(self, name: str) -> None:
        try:
            view = self._session.view.of_recording(name)
        except ScanLoomError as error:
            self._fail(str(error))
            return
        self._set_status(OpeningStatus(kind="opening", text=f"Opening {self._label(name)} …"))
        self._opener.open(view)

    def _label(self, name: str) -> str:
        return self._uploads.label(name) or name

    def _cancel(self) -> None:
        self._opener.cancel()
        self._uploads.cancel()
        self._set_status(None)

    def _on_opened(self, view: View) -> None:
        self._session.show_recording(view.recording)
        self.close_window()

    def _on_failed(self, view: View, error: Exception) -> None:
        label = self._label(view.recording)
        self._uploads.discard(view.recording)
        failure = as_failure(error)
        self._fail(f"{label}: {failure.problem} {failure.advice}")

    def _on_dropped(self, view: View) -> None:
        self._uploads.discard(view.recording)

    # Uploads

    def on_progress(self, progress: UploadProgress) -> None:
        """Show how much has arrived."""
        percent = 100.0 * progress.received_bytes / progress.total_bytes
        text = f"Uploading {progress.name}: {percent:.0f} %"
        with self._lock:
            is_news = self._status is None or self._status.text != text
        if is_news:
            self._set_status(OpeningStatus(kind="uploading", text=text, percent=percent))

    def on_refused(self, error: Exception) -> None:
        """Say why."""
        self._fail(str(as_failure(error)))

    def on_complete(self, name: str) -> None:
        """Open it; it is deleted if it cannot be opened."""
        self._open_recording(name)

    # What is shown

    def _on_recent(self, answers: Answers) -> None:
        names = parse_recent(answers[STORED_RECENT])
        known = [name for name in names if self._is_known(name)]
        with self._lock:
            self._recent = [name for name in known if name != self._session.view.recording]
            self._render()

    def _is_known(self, name: str) -> bool:
        try:
            self._library.path(name)
        except RecordingError:
            return False
        return True

    def _fail(self, text: str) -> None:
        if text:
            self._set_status(OpeningStatus(kind="failed", text=text))

    def _set_status(self, status: OpeningStatus | None) -> None:
        """Show it in the dialog, which is opened if need be."""
        with self._lock:
            self._status = status
            is_closed = self._window is None
            self._render()
        if status is not None and is_closed:
            self.open()

    def _render(self) -> None:
        with self._lock:
            if self._window is None:
                return
            place, page = self._place, self._page
            parts = [_ALL_PLACES]
            below = READING_HTML if self._is_reading else ""
            if place is not None:
                parts += [
                    self._library.root_label(place.root),
                    *place.folder.relative_to(place.root).parts,
                ]
                if page is not None:
                    below = pages_html(place.start, page)
            details = [
                self._library.details.get(row.path)
                if row.is_recording and row.path is not None
                else None
                for row in self._rows
            ]
            if self._batch_page is not None and not self._is_reading:
                page_rows = zip(self._batch_page.rows, self._rows, strict=True)
                columns, order = self._batch_page.batch.columns, self._batch_page.order
                listed = batch_html(columns, order, list(page_rows), self._serial) + below
            else:
                listed = rows_html(self._rows, details, self._serial) + below
            with self._session.batch_updates():
                self._window.show(
                    status=status_html(self._status),
                    top=recent_html(self._recent, self._serial) + places_html(parts),
                    rows=listed,
                )


@dataclass(frozen=True, slots=True)
class _Reading:
    """A request to read a place."""

    place: FolderPlace | None
