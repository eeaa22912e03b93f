"""Runs the surveys of one open recording that browsers want, one frame at a time."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import partial

from scanloom.jobs.activity import Activity
from scanloom.jobs.long_job import Cancelled
from scanloom.state.frame_survey import FrameSurvey, SurveyInputs

# Settings that were left alone for so long are meant: a drag passes through many.
_DEBOUNCE_S = 0.6
# After an answer a person often asks again: whoever steps through frames does not pause longer.
_QUIET_S = 0.8
# Somebody plays without end: the survey goes on, one step at a time.
_LONGEST_WAIT_S = 4.0
# While it waits it looks so often whether it is still wanted.
_LOOK_S = 0.25
# A strip need not grow more smoothly.
_NOTIFY_S = 0.5
# For going back to former settings and for undo: as many as fit, of those that nobody wants now.
# The runs of 640 paired beams take 19 kB a frame, a survey of 2000 such frames 38 MB.
_SURVEYS_KEPT = 6
_KEPT_BYTES = 50_000_000


@dataclass(slots=True)
class _Wish:
    """Whose survey it is, since when, and whom to tell."""

    key: Hashable
    since_s: float
    on_change: Callable[[], None]


class SurveyRunner:
    """The surveys of one alignment: one for equal settings, shared by all who want it.

    A survey that nobody wants any more stops after its current step; what it has counted is kept
    for a while. Thread-safe.
    """

    def __init__(self, activity: Activity | None = None) -> None:
        self._activity = Activity() if activity is None else activity
        self._changed = threading.Condition()
        # The most recently wanted last.
        self._surveys: OrderedDict[Hashable, FrameSurvey] = OrderedDict()
        self._wishes: dict[Hashable, _Wish] = {}
        self._thread: threading.Thread | None = None
        self._is_closed = False

    def want(
        self, viewer: Hashable, inputs: SurveyInputs, on_change: Callable[[], None]
    ) -> FrameSurvey:
        """The survey of these inputs, which is continued as long as somebody wants it.

        It replaces the viewer's former one. ``on_change`` is called now and then in the runner's
        thread, and when the survey is complete.
        """
        key = inputs.key
        with self._changed:
            survey = self._surveys.get(key)
            if survey is None:
                survey = self._surveys[key] = FrameSurvey(inputs)
            self._surveys.move_to_end(key)
            wish = self._wishes.get(viewer)
            if wish is None or wish.key != key:
                # The first one is no drag.
                since_s = -float("inf") if wish is None else time.monotonic()
                self._wishes[viewer] = _Wish(key, since_s, on_change)
            self._forget_oldest()
            if self._thread is None and not self._is_closed and not survey.is_complete:
                self._thread = threading.Thread(target=self._run, name="survey", daemon=True)
                self._thread.start()
            self._changed.notify_all()
            return survey

    def release(self, viewer: Hashable) -> None:
        """A viewer wants no survey any more."""
        with self._changed:
            self._wishes.pop(viewer, None)
            self._changed.notify_all()

    def close(self) -> None:
        """Stop after the current step, for good."""
        with self._changed:
            self._is_closed = True
            self._wishes.clear()
            self._changed.notify_all()

    def wait(self, timeout_s: float) -> bool:
        """Whether all wanted surveys were complete, or none was wanted, within the time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._thread is None, timeout_s)

    def _forget_oldest(self) -> None:
        wanted = {wish.key for wish in self._wishes.values()}
        for key in [key for key in self._surveys if key not in wanted]:
            kept = sum(survey.nbytes for survey in self._surveys.values())
            if len(self._surveys) > _SURVEYS_KEPT or kept > _KEPT_BYTES:
                del self._surveys[key]

    def _run(self) -> None:
        notified_s = time.monotonic()
        while (survey := self._next()) is not None:
            try:
                survey.advance(partial(self._give_way, survey))
            except Cancelled:
                continue
            now_s = time.monotonic()
            if survey.is_complete or now_s - notified_s > _NOTIFY_S:
                notified_s = now_s
                self._notify(survey)

    def _next(self) -> FrameSurvey | None:
        """The wanted survey that is least advanced, once its settings rest; None for none, and then
        the thread ends."""
        with self._changed:
            while True:
                since_s: dict[Hashable, float] = {}
                for wish in self._wishes.values():
                    if not self._surveys[wish.key].is_complete:
                        since_s[wish.key] = min(wish.since_s, since_s.get(wish.key, wish.since_s))
                if not since_s or self._is_closed:
                    # Set here, under the lock: whoever wants one later starts a new thread.
                    self._thread = None
                    self._changed.notify_all()
                    return None
                now_s = time.monotonic()
                ready = [key for key, at_s in since_s.items() if now_s - at_s >= _DEBOUNCE_S]
                if ready:
                    return min((self._surveys[key] for key in ready), key=lambda one: one.done)
                self._changed.wait(min(since_s.values()) + _DEBOUNCE_S - now_s)

    def _give_way(self, survey: FrameSurvey) -> None:
        """Wait while people wait for answers. Raises Cancelled if nobody wants the survey."""
        deadline_s = time.monotonic() + _LONGEST_WAIT_S
        while True:
            is_quiet = self._activity.wait_until_quiet(_QUIET_S, _LOOK_S)
            with self._changed:
                if all(wish.key != survey.inputs.key for wish in self._wishes.values()):
                    raise Cancelled
            if is_quiet or time.monotonic() >= deadline_s:
                return

    def _notify(self, survey: FrameSurvey) -> None:
        with self._changed:
            told = [w.on_change for w in self._wishes.values() if w.key == survey.inputs.key]
        for on_change in told:
            on_change()
