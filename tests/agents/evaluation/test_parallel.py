"""Calls shared out over processes: all results, whichever backend."""

import os
from functools import partial

import pytest
from threadpoolctl import threadpool_info

from agents.evaluation.parallel import connect, run_all


def square(number):
    return number**2, os.getpid(), [pool["num_threads"] for pool in threadpool_info()]


@pytest.mark.parametrize(("backend", "jobs"), [("loky", 1), ("loky", 2)])
def test_every_call_is_answered_once_on_one_thread(backend, jobs):
    connect(backend, jobs)
    found = list(run_all([partial(square, k) for k in range(10)], jobs, backend))
    assert sorted(value for value, _, _ in found) == [k**2 for k in range(10)]
    assert (os.getpid() in {pid for _, pid, _ in found}) == (jobs == 1)
    assert {count for _, _, threads in found for count in threads} <= {1}


@pytest.mark.parametrize("backend", ["ray", "dask"])
def test_a_cluster_answers_too_or_names_the_extra_that_is_missing(backend):
    try:
        connect(backend, 1)
    except ImportError as error:
        assert "pip install 'slam_gym[cluster]'" in str(error)
    else:
        assert sorted(value for value, _, _ in run_all([partial(square, k) for k in range(3)], 1, backend)) == [0, 1, 4]
