"""Calls in order, whatever threads they come to."""

import threading
from concurrent.futures import ThreadPoolExecutor

from scanloom.jobs.ordered_calls import OrderedCalls
from tests.patience import ENOUGH_S


def test_calls_are_made_in_order_and_one_at_a_time() -> None:
    made: list[int] = []
    inside = threading.Lock()

    def call(number: int) -> None:
        assert inside.acquire(blocking=False)
        made.append(number)
        inside.release()

    with ThreadPoolExecutor(8) as pool:
        calls = OrderedCalls(pool.submit)
        done = threading.Event()
        for number in range(500):
            calls.add(lambda number=number: call(number))  # type: ignore[misc]
        calls.add(done.set)
        assert done.wait(ENOUGH_S)
    assert made == list(range(500))


def test_a_call_that_fails_does_not_hold_up_the_others() -> None:
    with ThreadPoolExecutor(2) as pool:
        futures = []
        calls = OrderedCalls(lambda run: futures.append(pool.submit(run)))
        done = threading.Event()
        calls.add(lambda: 1 // 0)  # type: ignore[arg-type,return-value]
        calls.add(done.set)
        assert done.wait(ENOUGH_S)
    assert isinstance(futures[0].exception(), ZeroDivisionError)
