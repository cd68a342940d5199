"""Timings tell what was called and how often; how long it took is the machine's business."""

import itertools

import pytest

from slam_gym.bench.timing import PROCESS, THREAD, WALL, fastest, medians_in_turns, timed


def ticking(*nanoseconds):
    """A clock that shows these times one after the other."""
    return iter(nanoseconds).__next__


def test_a_call_is_timed_in_microseconds():
    answer, microseconds = timed(divmod, 7, 2, clock=ticking(1_000, 4_500))
    assert answer == (3, 1) and microseconds == 3.5


@pytest.mark.parametrize("clock", [WALL, THREAD, PROCESS])
def test_time_does_not_run_backwards(clock):
    assert timed(sum, range(1000), clock=clock).microseconds >= 0.0


def test_the_fastest_of_some_calls_counts():
    clock = ticking(*itertools.accumulate([0, 9_000, 0, 2_000, 0, 5_000]))
    calls = []
    assert fastest(calls.append, 1, repeats=3, clock=clock) == 2.0 and calls == [1, 1, 1]


def test_calls_take_turns():
    calls = []
    found = medians_in_turns({name: lambda k, name=name: calls.append((name, k)) for name in "ab"}, 3, 2)
    assert calls == [(name, k) for k in range(5) for name in "ab"]
    assert set(found) == {"a", "b"} and all(time > 0.0 for time in found.values())
