"""The time that long work still takes: told late, without jumps, and no finer than it is known."""

from itertools import pairwise

import pytest

from scanloom.jobs.time_left import TimeLeft, time_left_text


class Clock:
    """A clock that is set by hand."""

    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_a_steady_step_runs_down_to_its_end(clock: Clock) -> None:
    left = TimeLeft(clock)
    told = []
    for done in range(101):
        told.append(left.after(done, 100, "fusing"))
        clock.now_s += 0.5
    # The first counts, and a second passes.
    assert told[:3] == [None, None, None]
    assert told[3] == pytest.approx(0.5 * 97)
    assert told[60] == pytest.approx(0.5 * 40)
    assert told[100] == pytest.approx(0.0, abs=1e-9)


def test_a_long_first_part_is_left_out(clock: Clock) -> None:
    left = TimeLeft(clock)
    left.after(0, 10, "fusing")
    clock.now_s = 60.0
    left.after(1, 10, "fusing")
    clock.now_s = 62.0
    assert left.after(2, 10, "fusing") == pytest.approx(16.0)


def test_a_change_of_pace_is_taken_in_without_a_jump(clock: Clock) -> None:
    left = TimeLeft(clock)
    told = []
    for done in range(1, 200):
        told.append(left.after(done, 200, "fusing"))
        clock.now_s += 0.1 if done < 100 else 0.4
    known = [seconds for seconds in told if seconds is not None]
    steps = [after - before for before, after in pairwise(known)]
    assert max(map(abs, steps)) < 2.0
    assert known[-1] < 5.0


@pytest.mark.parametrize(("total", "what"), [(None, "fusing"), (100, "drawing figures")])
def test_another_step_and_what_is_not_counted_have_no_estimate(
    clock: Clock, total: int | None, what: str
) -> None:
    left = TimeLeft(clock)
    for done in range(1, 6):
        left.after(done, 100, "fusing")
        clock.now_s += 1.0
    assert left.after(6, total, what) is None


@pytest.mark.parametrize(
    ("left_s", "text"),
    [
        (0.0, "A few seconds left."),
        (4.9, "A few seconds left."),
        (12.0, "About 10 s left."),
        (57.4, "About 55 s left."),
        (58.0, "About 1 min left."),
        (89.0, "About 1 min left."),
        (150.1, "About 3 min left."),
    ],
)
def test_it_is_told_no_finer_than_it_is_known(left_s: float, text: str) -> None:
    assert time_left_text(left_s) == text
