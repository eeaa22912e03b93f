"""Playback by the clock: late frames are left out, and people may interfere."""

import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest

from scanloom.jobs.playback import Playback
from tests.patience import ENOUGH_S, comes_true


class Film:
    """A player that keeps what it showed, each frame after ``draw_s``."""

    def __init__(self) -> None:
        self.frame_index = 0
        self.frames_hz = 100.0
        self.frames = 1000
        self.is_looping = True
        self.draw_s = 0.0
        self.shown: list[tuple[int, float]] = []
        self._changed = threading.Condition()

    @property
    def is_at_end(self) -> bool:
        return not self.is_looping and self.frame_index >= self.frames - 1

    def frame_after(self, frame_index: int, by: int) -> int:
        number = frame_index + by
        return number % self.frames if self.is_looping else min(number, self.frames - 1)

    def show_frame(self, frame_index: int) -> None:
        self.frame_index = frame_index

    def wait(self, timeout_s: float) -> bool:
        time.sleep(self.draw_s)
        with self._changed:
            self.shown.append((self.frame_index, time.monotonic()))
            self._changed.notify_all()
        return True

    def until(self, condition: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(condition, ENOUGH_S)

    @property
    def numbers(self) -> list[int]:
        return [number for number, _ in self.shown]


@pytest.fixture
def film() -> Film:
    return Film()


@pytest.fixture
def playback(film: Film) -> Iterator[Playback]:
    made = Playback(film)
    yield made
    made.close()


def test_the_clock_decides_and_slow_frames_are_left_out(film: Film, playback: Playback) -> None:
    film.draw_s = 0.06
    started_s = time.monotonic()
    playback.toggle()
    film.until(lambda: len(film.shown) >= 8)
    numbers = film.numbers
    # At 100 frames a second each drawing costs six of them.
    assert min(b - a for a, b in pairwise(numbers)) >= 5
    for number, shown_s in film.shown:
        # It was due when its drawing began, which was not earlier.
        late_s = shown_s - film.draw_s - started_s - number / film.frames_hz
        assert late_s >= -0.001


def test_at_a_slow_rate_no_frame_is_left_out(film: Film, playback: Playback) -> None:
    film.frames_hz = 20.0
    playback.toggle()
    film.until(lambda: len(film.shown) >= 6)
    numbers = film.numbers
    # A busy machine may be late for one.
    assert numbers[:6] == sorted(set(numbers[:6]))
    assert numbers[5] <= 8
    assert numbers[0] == 1


def test_it_stops_at_the_end_with_the_last_frame_shown(film: Film, playback: Playback) -> None:
    film.is_looping, film.frames, film.draw_s = False, 20, 0.03
    playback.toggle()
    film.until(lambda: film.numbers[-1:] == [19])
    assert comes_true(lambda: not playback.is_playing)
    assert film.numbers[-1] == 19


def test_it_goes_on_from_where_somebody_has_gone(film: Film, playback: Playback) -> None:
    playback.toggle()
    film.until(lambda: len(film.shown) >= 2)
    film.frame_index = 500
    film.until(lambda: film.numbers[-1] > 500)
    jumped = next(number for number in film.numbers if number > 500)
    assert jumped < 600


def test_it_begins_again_at_the_first_frame(film: Film, playback: Playback) -> None:
    film.frames = 10
    playback.toggle()
    film.until(lambda: film.numbers.count(0) >= 1 and len(film.shown) > 12)
    assert set(film.numbers) <= set(range(10))


def test_whoever_wants_to_know_is_told_of_start_stop_and_end(film: Film) -> None:
    told: list[bool] = []
    ended = threading.Event()

    def hear() -> None:
        told.append(playback.is_playing)
        if len(told) == 4:
            ended.set()

    playback = Playback(film, hear)
    playback.toggle()
    playback.toggle()
    film.is_looping, film.frames = False, 10
    playback.toggle()
    assert ended.wait(ENOUGH_S)
    assert told == [True, False, True, False]
    playback.close()
