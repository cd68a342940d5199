"""Episodes shared out over processes or a cluster, through joblib."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import gymnasium as gym
import joblib
from threadpoolctl import threadpool_limits

from agents.drivers.base import ActionKind, Agent, make_agent
from agents.evaluation.results import Record
from agents.evaluation.rollout import Setting, run_episode

BACKENDS = ("loky", "multiprocessing", "ray", "dask")


@dataclass(frozen=True)
class Driver:
    """An agent, and the model file behind it if it is learned."""

    agent: str
    model: str | None = None
    trust: bool = False

    def make(self) -> Agent:
        return make_agent(self.agent, self.model, trust=self.trust)


@dataclass(frozen=True)
class Task:
    """One episode to drive, or to film into a file."""

    driver: Driver
    setting: Setting
    episode: int
    film: Path | None = None

    @property
    def key(self) -> tuple[str, str | None, int]:
        return self.driver.agent, self.driver.model, self.episode


@lru_cache(maxsize=8)
def _agent(driver: Driver) -> Agent:
    return driver.make()


@lru_cache(maxsize=2)
def _env(setting: Setting, action: ActionKind) -> gym.Env[Any, Any]:
    return setting.make(action)


def run_task(task: Task) -> Record:
    """Drive one episode in whatever process this is, on one thread. Agent and env are kept for the next task."""
    agent = _agent(task.driver)
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
    with threadpool_limits(1):
        if task.film is not None:
            from agents.reports.film import film  # ffmpeg and pygame are needed for films only

            return {"picture": str(film(task.setting, agent, task.episode, task.film))}
        record = run_episode(_env(task.setting, agent.action), agent, task.episode)
    return {"agent": task.driver.agent, "model": task.driver.model} | record


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
        raise ImportError(f"--backend {backend} needs {error.name}: pip install -e '.[cluster]'") from error


def run_all(
    tasks: Sequence[Any], jobs: int, backend: str = "loky", run: Callable[[Any], Any] = run_task
) -> Iterator[Any]:
    """What `run` makes of each task (a Record), as they finish, in any order.

    `ray` and `multiprocessing` do not hand on single results: these come in batches.
    """
    calls = [joblib.delayed(run)(task) for task in tasks]
    # A worker grows when it first imports torch; loky takes that for a leak, replaces the worker and warns.
    warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
    with joblib.parallel_config(backend=backend, n_jobs=jobs):
        if backend in ("ray", "multiprocessing"):
            for start in range(0, len(calls), 4 * jobs):
                yield from joblib.Parallel(batch_size=1)(calls[start : start + 4 * jobs])
        else:
            yield from joblib.Parallel(return_as="generator_unordered", batch_size=1)(calls)
