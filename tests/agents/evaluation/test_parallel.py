"""Calls shared out over processes: all results, whichever backend."""

import os
import select
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info

from agents.evaluation.parallel import connect, run_all

ROOT = Path(__file__).parents[3]


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


ORPHANS = """
import os, signal, sys, time
from agents.evaluation.parallel import run_all

def work():
    os.write(1, f"{os.getpid()}\\n".encode())  # in one piece, whoever else writes
    time.sleep(60)

list(run_all([work] * 2, 2))
"""


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="waits for processes that are not its children, as Linux can")
def test_workers_end_with_a_parent_that_is_killed():
    parent = subprocess.Popen([sys.executable, "-c", ORPHANS], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    workers = [os.pidfd_open(int(parent.stdout.readline())) for _ in range(2)]
    parent.kill()
    parent.wait()
    for worker in workers:
        assert select.select([worker], [], [], 20.0)[0], "a worker outlives its parent"
        os.close(worker)
