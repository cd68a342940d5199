"""Rollouts collected by Ray actors, on this machine or a cluster; learning happens in one place.

Every actor has worlds of its own and a copy of the policy. Weights and rollouts go through Ray's object store. An actor
that is lost is replaced by one with new worlds, which collects its part of the rollout anew: a part is entered once,
when it has arrived whole.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from agents.learning.many_worlds import WorldsForLearning
from agents.learning.ppo import Decision, Hyperparameters, make_algorithm
from slam_gym.envs.vector.checks import shared_out

_PARTS = ("actions", "rewards", "returns", "episode_starts", "values", "log_probs", "advantages", "action_masks")
_LOSSES = 5  # in a row, of the actors at one place: then something is wrong that a new one will not cure

Weights = dict[str, np.ndarray[Any, Any]]
MakeWorlds = Callable[[int], WorldsForLearning]
"""So many worlds for learning, all in the calling process."""


class Rollout(NamedTuple):
    """What one actor has collected: T decisions in each of its n worlds."""

    observations: dict[str, np.ndarray[Any, Any]]  # (T, n, …)
    parts: dict[str, np.ndarray[Any, Any]]  # (T, n, …) the rest, by the name it has in the buffer
    episodes: list[dict[str, float]]  # that ended
    seconds: float  # that it took

    @property
    def bytes(self) -> int:
        return sum(array.nbytes for array in (*self.observations.values(), *self.parts.values()))


class Collector:
    """Worlds, and a copy of the policy that acts in them."""

    def __init__(self, decision: Decision, make: MakeWorlds, hyper: Hyperparameters, worlds: int, seed: int) -> None:
        torch.set_num_threads(1)
        of_worlds = replace(hyper, envs=worlds, batch_size=max(2, worlds * hyper.steps))
        self._model: Any = make_algorithm(decision, make(worlds), of_worlds, seed)
        _, self._callback = self._model._setup_learn(1)

    def collect(self, weights: Weights) -> Rollout:
        """As many decisions in each world as an update asks for, by the policy with these weights."""
        start, model = time.perf_counter(), self._model
        model.policy.load_state_dict({name: torch.from_numpy(array.copy()) for name, array in weights.items()})
        model.ep_info_buffer.clear()
        model.collect_rollouts(model.env, self._callback, model.rollout_buffer, model.n_steps)
        buffer = model.rollout_buffer
        parts = {name: getattr(buffer, name) for name in _PARTS if hasattr(buffer, name)}
        return Rollout(dict(buffer.observations), parts, list(model.ep_info_buffer), time.perf_counter() - start)


def enter(buffer: Any, rollout: Rollout, worlds: range) -> None:
    """Enter the rollout of some of the worlds into the buffer of all."""
    rows = slice(worlds.start, worlds.stop)
    for name, array in rollout.observations.items():
        buffer.observations[name][:, rows] = array
    for name, array in rollout.parts.items():
        getattr(buffer, name)[:, rows] = array.reshape(getattr(buffer, name)[:, rows].shape)


@dataclass
class Stages:
    """Where the time of a training went."""

    decisions: int = 0
    rollouts: int = 0
    lost: int = 0  # actors
    megabytes: float = 0.0  # of rollouts, through the object store
    collecting: float = 0.0  # [s] of all actors together
    waiting: float = 0.0  # [s] from weights handed out to rollouts entered
    learning: float = 0.0  # [s] between rollouts
    actors: int = field(default=1)

    def told(self) -> str:
        """One line for each stage."""
        beyond = max(self.waiting - self.collecting / self.actors, 0.0)
        return "\n".join((
            f"{self.decisions} decisions in {self.rollouts} rollouts by {self.actors} actors, {self.lost} lost",
            f"collecting: {self.decisions / max(self.collecting, 1e-9):.0f} decisions/s and actor, "
            f"{self.decisions / max(self.waiting, 1e-9):.0f} together",
            f"transfer and waiting for the slowest: {self.megabytes:.1f} MB, {beyond:.1f} s of {self.waiting:.1f} s",
            f"learning: {self.decisions / max(self.learning, 1e-9):.0f} decisions/s ({self.learning:.1f} s)",
        ))  # fmt: skip


class RayCollection:
    """Stands in for `collect_rollouts` of a model: its worlds are those of actors."""

    def __init__(
        self,
        model: BaseAlgorithm,
        decision: Decision,
        make: MakeWorlds,
        hyper: Hyperparameters,
        actors: int,
        seed: int,
    ) -> None:
        import ray

        self._ray, self._model = ray, model
        self._rows = shared_out(hyper.envs, min(actors, hyper.envs))
        self._remote = ray.remote(num_cpus=1, max_restarts=0)(Collector)
        self._arguments, self._seed, self._started = (decision, make, hyper), seed, 0
        self.actors = [self._start(rows) for rows in self._rows]
        self.stages = Stages(actors=len(self.actors))
        self._ended: float | None = None

    def __call__(self, env: Any, callback: BaseCallback, rollout_buffer: Any, n_rollout_steps: int, *_: Any) -> bool:
        if self._ended is not None:
            self.stages.learning += time.perf_counter() - self._ended
        callback.on_rollout_start()
        rollout_buffer.reset()
        start = time.perf_counter()
        self._collect(rollout_buffer)
        rollout_buffer.pos, rollout_buffer.full = n_rollout_steps, True
        self.stages.waiting += time.perf_counter() - start
        self.stages.decisions += n_rollout_steps * env.num_envs
        self.stages.rollouts += 1
        self._model.num_timesteps += n_rollout_steps * env.num_envs
        goes_on = callback.on_step()
        callback.on_rollout_end()
        self._ended = time.perf_counter()
        return goes_on

    def close(self) -> None:
        """End the actors, so that others can have their cores."""
        for actor in self.actors:
            self._ray.kill(actor)

    def _collect(self, buffer: Any) -> None:
        """Enter one rollout from every place into the buffer."""
        ray = self._ray
        state = self._model.policy.state_dict()
        weights = ray.put({name: tensor.detach().numpy() for name, tensor in state.items()})
        pending = {actor.collect.remote(weights): place for place, actor in enumerate(self.actors)}
        losses = [0] * len(self.actors)
        while pending:
            (done, *_), _ = ray.wait(list(pending), num_returns=1)
            place = pending.pop(done)
            try:
                rollout = ray.get(done)
            except ray.exceptions.RayActorError as error:
                self.stages.lost, losses[place] = self.stages.lost + 1, losses[place] + 1
                if losses[place] > _LOSSES:
                    raise RuntimeError(
                        f"{losses[place]} actors in a row were lost, the last one by: {error}"
                    ) from error
                self.actors[place] = self._start(self._rows[place])
                pending[self.actors[place].collect.remote(weights)] = place
                continue
            enter(buffer, rollout, self._rows[place])
            self._model.ep_info_buffer.extend(rollout.episodes)
            self.stages.collecting += rollout.seconds
            self.stages.megabytes += 1e-6 * rollout.bytes

    def _start(self, rows: range) -> Any:
        """An actor with new worlds: no two that were ever started begin with the same."""
        seed = self._seed + self._started
        self._started += len(rows)
        return self._remote.remote(*self._arguments, len(rows), seed)


def connect() -> None:
    """To the cluster of RAY_ADDRESS, or one on this machine. ImportError names the extra that is missing."""
    try:
        import ray
    except ImportError as error:
        raise ImportError("--backend ray needs ray: pip install 'slam_gym[cluster]'") from error
    if not ray.is_initialized():
        ray.init(include_dashboard=False, log_to_driver=False)
