"""What the parts of a page owe the session that drives them."""

from collections.abc import Sequence
from typing import Protocol

from scanloom.frame_view import FrameView
from scanloom.page.events import ToolName
from scanloom.state.hover import Hover
from scanloom.state.review_choices import Answer
from scanloom.state.review_overlay import ReviewOverlay


class Panel(Protocol):
    """A part of the page. ``scanloom.panels.registry`` says how to add one."""

    def show(self, frame_view: FrameView) -> None:
        """Display a computed view; called in the session's worker thread.

        Set all widgets from ``frame_view.view``: it may come from a link, from undo, or from
        another panel.
        """

    def show_hover(self, frame_view: FrameView, hover: Hover) -> None:
        """Light up the sample under the pointer. By default nothing is."""
        return

    def show_progress(self, frame_view: FrameView) -> None:
        """Display how far the alignment is; all else is as ``show`` had it. By default nothing
        does."""
        return

    def close(self) -> None:
        """End the panel's background work. By default there is none."""
        return


class Review(Protocol):
    """The review of labels in one browser."""

    @property
    def is_on(self) -> bool:
        """Whether keys and clicks are about labels now."""
        ...

    def undo(self) -> None:
        """Take back the last label."""
        ...

    def redo(self) -> None:
        """Give it again."""
        ...

    def go(self, direction: int) -> None:
        """To the next run, or to the previous one for -1."""
        ...

    def answer(self, answer: Answer) -> None:
        """Say what the marked samples are."""
        ...

    def draw(
        self, tool: ToolName, places: Sequence[tuple[float, float]], *, is_added: bool
    ) -> None:
        """Mark pixels of the upright depth image, drawn at (column, row)."""
        ...

    def mark_beams(self, beams: Sequence[int], *, is_added: bool) -> None:
        """Mark beams of the displayed scan."""
        ...

    def overlay(self, frame_view: FrameView) -> ReviewOverlay | None:
        """What a frame shows of it."""
        ...
