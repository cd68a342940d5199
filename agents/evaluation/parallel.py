"""Tasks shared out over processes or a cluster, through joblib."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import joblib
from threadpoolctl import threadpool_limits

Result = TypeVar("Result")


def connect(backend: str, jobs: int) -> None:
    """Make a cluster known to joblib, before `run_all`. ImportError names the extra that is missing.

    `ray` goes to the cluster of RAY_ADDRESS, `dask` to that of DASK_SCHEDULER_ADDRESS; else each starts one on
    this machine. Machines of a cluster need this checkout, and a common file system for models and films.
    """
    try:
        if backend == "ray":
            from ray.util.joblib import register_ray

            register_ray()
        elif backend == "dask":
            import dask
            from distributed import Client

            remote = dask.config.get("scheduler-address", None)
            Client() if remote else Client(n_workers=jobs, threads_per_worker=1)
    except ImportError as error:
        raise ImportError(f"--backend {backend} needs {error.name}: pip install 'slam_gym[cluster]'") from error


def run_all(calls: Sequence[Callable[[], Result]], jobs: int, backend: str = "loky") -> Iterator[Result]:
    """The results of calls that can be pickled, as they finish, in any order; each on one thread.

    `ray` does not hand on single results: these come in batches.
    """
    tasks = [joblib.delayed(_on_one_thread)(call) for call in calls]
    # A worker grows when it first imports torch; loky takes that for a leak, replaces the worker and warns.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    with joblib.parallel_config(backend=backend, n_jobs=jobs):
        if backend == "ray":
            for start in range(0, len(tasks), 4 * jobs):
                yield from joblib.Parallel(batch_size=1)(tasks[start : start + 4 * jobs])
        else:
            yield from joblib.Parallel(return_as="generator_unordered", batch_size=1)(tasks)


def _on_one_thread(call: Callable[[], Any]) -> Any:
    """Threads of BLAS and torch on top of the processes would only get in the way. Ctrl-C is for the parent."""
    own_process = multiprocessing.parent_process() is not None
    if own_process and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    with threadpool_limits(1):
        return call()
