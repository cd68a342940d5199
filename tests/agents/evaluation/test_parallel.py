"""Calls shared out over processes: all results, whichever backend."""

import os
from functools import partial

import pytest
from threadpoolctl import threadpool_info

from agents.evaluation.parallel import connect, run_all


def square(number):
    return number**2, os.getpid()


def threads():
    return [pool["num_threads"] for pool in threadpool_info()]


@pytest.mark.parametrize(("backend", "jobs"), [("loky", 1), ("loky", 2), ("multiprocessing", 2)])
def test_every_call_is_answered_once(backend, jobs):
    connect(backend, jobs)
    found = list(run_all([partial(square, k) for k in range(10)], jobs, backend))
    assert sorted(value for value, _ in found) == [k**2 for k in range(10)]
    assert (os.getpid() in {pid for _, pid in found}) == (jobs == 1)


def test_every_call_has_one_thread():
    assert all(count == 1 for counts in run_all([threads], 1) for count in counts)


@pytest.mark.parametrize("backend", ["ray", "dask"])
def test_a_cluster_that_is_not_installed_names_its_extra(backend):
    try:
        __import__(backend)
    except ImportError:
        with pytest.raises(ImportError, match="cluster"):
            connect(backend, 1)
    else:
        pytest.skip(f"{backend} is installed")
