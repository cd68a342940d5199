"""A training run: environments in parallel, PPO, watched on held-out worlds, resumable.

Writes into a folder: model.pt (the last weights), best.pt (the best on held-out worlds), checkpoint.pt (from which it
goes on), progress.csv, and TensorBoard logs.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, make_output_format

from agents.evaluation.episodes import AssociateArguments, ExploreArguments, associate_episode, run_episode
from agents.evaluation.records import Record, plain, versions
from agents.learning.many_worlds import WorldsForLearning
from agents.learning.model_file import ModelSpec, read_model, save_model
from agents.learning.policies import BestBranch, PolicyAgent
from agents.learning.ppo import Decision, Hyperparameters, make_algorithm
from agents.learning.training_state import restore_state, state_of
from slam_gym.metrics.statistics import interquartile_mean

HELD_OUT = 5_000
"""First world of the test split used to watch a training; evaluation reports on worlds from 0 on, so never on these."""

EPISODE_END: dict[str, tuple[str, ...]] = {
    "goal": ("map_error", "coverage"),
    "twist": ("map_error", "coverage"),
    "branch": ("score", "map_error"),
}
"""What is logged of an episode, from its last `info`, by what the policy decides."""

MAY_CHANGE = frozenset({"command", "versions", "best", "next_evaluation", "resolution"})
"""What a resumed training may do otherwise than before."""


@dataclass(frozen=True)
class TrainingPlan:
    """What is trained, on what, and for how long.

    A resumed training goes on as one that was not interrupted, worlds and random states included, on one machine with
    the same versions. With another number of environments it goes on to new worlds.
    """

    decision: Decision
    arguments: ExploreArguments | AssociateArguments
    hyperparameters: Hyperparameters
    seed: int = 0
    timesteps: int = 100_000  # decisions in all
    eval_every: int = 10_000  # decisions
    eval_episodes: int = 20
    command: str = ""  # as it was typed
    workers: int | None = None  # processes that step the worlds; None: as many as there are cores

    def decisions_from(self, start: int) -> int:
        """How many it comes to that begins with `start`: rollouts are taken whole."""
        rollout = self.hyperparameters.steps * self.hyperparameters.envs
        return start + math.ceil(max(self.timesteps - start, 0) / rollout) * rollout


def train(out: Path, plan: TrainingPlan, resumed: bool = False) -> Path:
    """Train up to `plan.timesteps` decisions in all and return the path of the model file. Ctrl-C keeps what was
    learned."""
    torch.set_num_threads(1)  # the networks are small, and the environments need the other cores
    training = plan.arguments.plain | {"seed": plan.seed, "command": plan.command, "versions": versions()}
    probe: Any = plan.arguments.make(plan.decision)  # alone: faults are reported, and inner loops compiled, once
    probe.reset(seed=plan.seed)
    spec = ModelSpec.of(probe, plan.decision, plan.hyperparameters, training)
    probe.close()
    with _many_worlds(plan) as envs, _progress_bar() as progress:
        model = make_algorithm(plan.decision, envs, plan.hyperparameters, plan.seed)
        before = _resume(model, out / "checkpoint.pt", spec) if resumed else {}
        spec.training["best"] = before.get("best", float("inf"))
        spec.training["next_evaluation"] = before.get("next_evaluation", model.num_timesteps + plan.eval_every)
        model.set_logger(_open_logs(out, model.num_timesteps))
        watch = Watch(out, plan, spec, progress)
        watch.init_callback(model)
        try:
            if model.num_timesteps < plan.timesteps:
                model.learn(plan.timesteps - model.num_timesteps, callback=watch, reset_num_timesteps=False)
                watch.keep()
            if watch.evaluated != model.num_timesteps:
                watch.evaluate()
            model.logger.dump(model.num_timesteps)
        except KeyboardInterrupt:
            progress.console.print(f"interrupted; go on with the same command and --resume --out {out}")
            raise
        finally:
            watch.save("model.pt")
            watch.close()
    return out / "model.pt"


class Watch(BaseCallback):
    """Progress bar, the episodes' ends in the log, checkpoints, and evaluation on held-out worlds."""

    def __init__(self, out: Path, plan: TrainingPlan, spec: ModelSpec, progress: Progress) -> None:
        super().__init__()
        self._out, self._plan, self._spec = out, plan, spec
        self._env = replace(plan.arguments, split="test").make(plan.decision)
        self._progress, self._bar = progress, progress.add_task("training", total=None)
        self._best, self._next = float(spec.training["best"]), int(spec.training["next_evaluation"])
        self.evaluated = -1  # decisions so far at the last evaluation

    def _on_training_start(self) -> None:
        self._progress.update(self._bar, total=self._plan.decisions_from(self.model.num_timesteps))

    def _on_step(self) -> bool:
        self._progress.update(self._bar, completed=self.num_timesteps)
        return True

    def _on_rollout_start(self) -> None:
        self.keep()  # what the last rollout taught is in the weights: a training that is killed loses no more than one

    def _on_rollout_end(self) -> None:
        episodes = list(self.model.ep_info_buffer or [])
        for key in EPISODE_END[self._plan.decision]:
            if episodes:
                self.logger.record(f"rollout/{key}", float(np.mean([episode[key] for episode in episodes])))
        if self.num_timesteps >= self._next:
            self._next += self._plan.eval_every
            self.evaluate()

    def evaluate(self) -> None:
        """Try the present weights on held-out worlds; keep them as best.pt if no others did as well."""
        self.evaluated = self.model.num_timesteps
        records = self.held_out()
        scores = {
            key: float(interquartile_mean(np.array([record[key] for record in records])))
            for key in EPISODE_END[self._plan.decision]
        }
        for key, value in scores.items():
            self.logger.record(f"held_out/{key}", value)
        told = ", ".join(f"{key.replace('_', ' ')} {value:.3f}" for key, value in scores.items())
        self._progress.console.print(f"{self.model.num_timesteps:>9} decisions: {told} on held-out worlds")
        loss = -scores["score"] if "score" in scores else scores["map_error"]
        if loss < self._best:
            self._best = loss
            self.save("best.pt")

    def held_out(self) -> list[Record]:
        """Figures of an episode on each of the held-out worlds."""
        worlds, policy = range(HELD_OUT, HELD_OUT + self._plan.eval_episodes), self.model.policy
        if self._plan.decision == "branch":
            return [associate_episode(self._env, BestBranch(policy), k) for k in worlds]
        agent = PolicyAgent(policy, self._plan.decision, deterministic=self._plan.hyperparameters.deterministic)
        return [run_episode(self._env, agent, k) for k in worlds]

    def keep(self) -> None:
        """Between two rollouts: the file from which the training goes on."""
        self.save("checkpoint.pt", state_of(self.model))

    def save(self, name: str, state: bytes = b"") -> None:
        """The present weights, as a model file."""
        counted = {"timesteps": self.model.num_timesteps, "best": self._best, "next_evaluation": self._next}
        spec = replace(self._spec, training=self._spec.training | counted)
        save_model(self._out / name, spec, self.model.policy, state)

    def close(self) -> None:
        self._env.close()


@contextlib.contextmanager
def _many_worlds(plan: TrainingPlan) -> Iterator[WorldsForLearning]:
    """The training environments: true returns are logged, scaled ones are learned from. Ended however it ends."""
    many = plan.arguments.make_many(plan.decision, plan.hyperparameters.envs, plan.workers)
    worlds = WorldsForLearning(many, plan.hyperparameters.reward_scale, EPISODE_END[plan.decision])
    try:
        yield worlds
    finally:
        worlds.close()


def _resume(model: BaseAlgorithm, path: Path, expected: ModelSpec) -> dict[str, Any]:
    """Load weights, optimiser, step count and state of a checkpoint. ValueError where it was trained on something
    else."""
    spec, content = read_model(path)
    for name in sorted(expected.training.keys() - MAY_CHANGE):
        was, now = spec.training.get(name), plain(expected.training[name])
        if was != now:
            raise ValueError(f"{path} was trained with {name} {was!r}, not {now!r}")
    envs = {"envs": 0}  # may differ: it changes how fast the training goes, not what it is
    if (spec.action, spec.hyperparameters | envs) != (expected.action, expected.hyperparameters | envs):
        raise ValueError(f"{path} was trained on action {spec.action!r} with other hyperparameters")
    model.policy.load_state_dict(content["policy"])
    model.policy.optimizer.load_state_dict(content["optimizer"])
    model.num_timesteps = int(spec.training["timesteps"])
    if "state" in content and spec.hyperparameters["envs"] == expected.hyperparameters["envs"]:
        try:
            restore_state(model, bytes(content["state"].numpy()))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
    else:
        model.set_random_seed(int(expected.training["seed"]) + model.num_timesteps)  # on to new worlds
    return spec.training


def _open_logs(out: Path, start: int) -> Logger:
    """TensorBoard and CSV logs; a resumed run writes a CSV file of its own."""
    out.mkdir(parents=True, exist_ok=True)
    csv = make_output_format("csv", str(out), f"_from_{start}" if start else "")
    return Logger(str(out), [csv, make_output_format("tensorboard", str(out))])


def _progress_bar() -> Progress:
    """Decisions done, of how many, and the time left."""
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
