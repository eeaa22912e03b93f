"""Where streams are silent: within, before their first message and after their last."""

from types import SimpleNamespace

import numpy as np
import pytest

from fusion_core.model.conventions import NS_PER_MS
from fusion_core.workflows.stream_gaps import stream_gaps

START_NS = 1_700_000_000_000_000_000


class Recording:
    """Log times of topics, in ms after the start; the recording lasts from the first to the last
    of all."""

    def __init__(self, roles=None, **times_ms):
        self._times_ns = {
            name: START_NS + (np.array(times) * NS_PER_MS).astype(np.int64)
            for name, times in times_ms.items()
        }
        every = np.concatenate([np.empty(0, np.int64), *self._times_ns.values()])
        self.start_ns = int(every.min()) if every.size else None
        self.end_ns = int(every.max()) if every.size else None
        self.topics = tuple(
            SimpleNamespace(name=name, role=(roles or {}).get(name, "lidar"), count=len(times))
            for name, times in times_ms.items()
        )

    def received_ns(self, topic):
        return self._times_ns[topic]


def test_a_steady_stream_has_no_gap():
    rng = np.random.default_rng(3)
    found = stream_gaps(Recording(scan=np.arange(100) * 100.0 + rng.uniform(-40.0, 40.0, 100)))
    assert (found["scan"].count, found["scan"].longest_s) == (0, 0.0)


def test_gaps_are_counted_and_the_longest_is_placed():
    times_ms = np.array([0, 100, 200, 600, 700, 800, 2000, 2100, 2200, 2300.0])
    found = stream_gaps(Recording(scan=times_ms))["scan"]
    assert found.count == 2
    assert found.longest_s == pytest.approx(1.2)
    assert found.longest_at_s == pytest.approx(0.8)


@pytest.mark.parametrize(("last_ms", "count"), [(300.0, 0), (301.0, 1)])
def test_three_times_the_usual_interval_is_no_gap_yet(last_ms, count):
    times_ms = [*np.arange(0, 1000, 100.0), 900.0 + last_ms]
    assert stream_gaps(Recording(scan=times_ms))["scan"].count == count


def test_a_stream_that_ends_or_begins_in_mid_recording_has_a_gap():
    whole = np.arange(0, 10_000, 100.0)
    found = stream_gaps(Recording(scan=whole, ends=whole[:50], begins=whole[20:]))
    assert found["scan"].count == 0
    assert (found["ends"].count, found["begins"].count) == (1, 1)
    assert found["ends"].longest_at_s == pytest.approx(4.9)
    assert found["ends"].longest_s == pytest.approx(5.0)
    assert (found["begins"].longest_at_s, found["begins"].longest_s) == (0.0, pytest.approx(2.0))


def test_what_was_logged_out_of_order_is_no_gap():
    times_ms = np.arange(0, 2000, 100.0)
    assert stream_gaps(Recording(scan=np.roll(times_ms, 7)))["scan"].count == 0


@pytest.mark.parametrize("role", ["tf", "tf_static", "other"])
def test_what_has_no_rate_of_its_own_is_left_out(role):
    times_ms = [0, 1, 2, 3, 1000]
    assert stream_gaps(Recording(roles={"a": role}, a=times_ms)) == {}


def test_too_few_messages_and_no_time_tell_nothing():
    assert stream_gaps(Recording(scan=[0.0, 100.0, 900.0])) == {}
    assert stream_gaps(Recording(scan=[5.0] * 9)) == {}
    assert stream_gaps(Recording()) == {}
