"""Train a driver: `python -m agents.train --scenario office-small --timesteps 50000 --seed 0 --out runs/demo`.

Writes into OUT: model.pt (the last weights), best.pt (the best on held-out worlds), checkpoint.pt (from which --resume
goes on), progress.csv, and TensorBoard logs (`tensorboard --logdir OUT`).
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import signal
from collections.abc import Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import gymnasium as gym
import numpy as np
import torch
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv
from threadpoolctl import threadpool_limits

from agents.cli import add_world_options, command_line, run_main, setting_of, versions
from agents.evaluation.rollout import Setting, run_episode
from agents.learning.association_models import BestBranch, associate_episode
from agents.learning.association_setting import AssociationSetting
from agents.learning.ppo import (
    HYPERPARAMETERS,
    Hyperparameters,
    ModelSpec,
    PolicyAgent,
    Task,
    load_hyperparameters,
    make_algorithm,
    read_model,
    save_model,
)
from slam_gym.metrics.statistics import interquartile_mean

HELD_OUT = 5_000
"""First world of the test split used to watch a training; evaluation reports on worlds from 0 on, so never on these."""

EPISODE_END: dict[str, tuple[str, ...]] = {
    "goal": ("map_error", "coverage"),
    "twist": ("map_error", "coverage"),
    "branch": ("score", "map_error"),
}
"""What is logged of an episode, from its last `info`, by what the policy decides."""

AnySetting = Setting | AssociationSetting


def training_env(setting: Any, action: Task, reward_scale: float) -> gym.Env[Any, Any]:
    """One training environment: true returns are logged, scaled ones are learned from."""
    if multiprocessing.parent_process() is not None:
        threadpool_limits(1)  # BLAS threads on top of the processes would only get in the way
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the trainer, which ends its environments
    monitored = Monitor(setting.make(action), info_keywords=EPISODE_END[action])
    return gym.wrappers.TransformReward(monitored, partial(_scaled, reward_scale))


def _scaled(factor: float, reward: float) -> float:
    return factor * float(reward)


class Watch(BaseCallback):
    """Progress bar, the episodes' map error and coverage in the log, checkpoints, and evaluation on held-out worlds."""

    def __init__(self, out: Path, setting: Any, spec: ModelSpec, every: int, episodes: int, progress: Progress) -> None:
        super().__init__()
        self._out, self._spec, self._every, self._episodes = out, spec, every, episodes
        self._env = setting.make(spec.action)
        self._progress, self._bar = progress, progress.add_task("training", total=None)
        self._best, self._next = float(spec.training["best"]), 0
        self.evaluated = -1  # decisions so far at the last evaluation

    def _on_training_start(self) -> None:
        self._progress.update(self._bar, total=self.model._total_timesteps)
        self._next = self.model.num_timesteps + self._every

    def _on_step(self) -> bool:
        self._progress.update(self._bar, completed=self.num_timesteps)
        return True

    def _on_rollout_end(self) -> None:
        episodes = list(self.model.ep_info_buffer or [])
        for key in EPISODE_END[self._spec.action]:
            if episodes:
                self.logger.record(f"rollout/{key}", float(np.mean([episode[key] for episode in episodes])))
        if self.num_timesteps >= self._next:
            self._next += self._every
            self.evaluate()

    def evaluate(self) -> None:
        """Try the present weights on held-out worlds; keep them as best.pt if no others did as well."""
        self.evaluated = self.model.num_timesteps
        records = self.held_out()
        scores = {
            key: float(interquartile_mean(np.array([record[key] for record in records])))
            for key in EPISODE_END[self._spec.action]
        }
        for key, value in scores.items():
            self.logger.record(f"held_out/{key}", value)
        told = ", ".join(f"{key.replace('_', ' ')} {value:.3f}" for key, value in scores.items())
        self._progress.console.print(f"{self.model.num_timesteps:>9} decisions: {told} on held-out worlds")
        loss = -scores["score"] if "score" in scores else scores["map_error"]
        if loss < self._best:
            self._best = loss
            self.save("best.pt")
        self.save("checkpoint.pt")

    def held_out(self) -> list[dict[str, Any]]:
        """Figures of an episode on each of the held-out worlds."""
        if self._spec.action == "branch":
            return [associate_episode(self._env, BestBranch(self.model.policy), k) for k in self._worlds()]
        deterministic = bool(self._spec.hyperparameters["deterministic"])
        agent = PolicyAgent(self.model.policy, self._spec.action, deterministic=deterministic)
        return [run_episode(self._env, agent, k) for k in self._worlds()]

    def _worlds(self) -> range:
        return range(HELD_OUT, HELD_OUT + self._episodes)

    def save(self, name: str) -> None:
        training = self._spec.training | {"timesteps": self.model.num_timesteps, "best": self._best}
        spec = ModelSpec(**(asdict(self._spec) | {"training": training}))
        save_model(self._out / name, spec, self.model.policy)

    def close(self) -> None:
        self._env.close()


@contextlib.contextmanager
def vectorised(setting: AnySetting, action: Task, hyper: Hyperparameters) -> Iterator[VecEnv]:
    """The training environments, each in a process of its own; ended however the training ends."""
    makers = [partial(training_env, setting, action, hyper.reward_scale)] * hyper.envs
    envs = SubprocVecEnv(makers) if hyper.envs > 1 else DummyVecEnv(makers)
    try:
        yield envs
    except BaseException:
        for process in getattr(envs, "processes", []):
            process.terminate()  # close() could wait for ever for the answer to a step that was interrupted
        raise
    envs.close()


def resume(model: BaseAlgorithm, path: Path, expected: ModelSpec) -> dict[str, Any]:
    """Load weights, optimiser and step count of a checkpoint. ValueError where it was trained on something else."""
    spec, content = read_model(path)
    for name in sorted(expected.training.keys() - {"command", "versions", "best", "resolution"}):
        was, now = spec.training.get(name), expected.training.get(name)
        if was != now:
            raise ValueError(f"{path} was trained with {name} {was!r}, not {now!r}")
    envs = {"envs": 0}  # may differ: it changes how fast the training goes, not what it is
    if (spec.action, spec.hyperparameters | envs) != (expected.action, expected.hyperparameters | envs):
        raise ValueError(f"{path} was trained on action {spec.action!r} with other hyperparameters")
    model.policy.load_state_dict(content["policy"])
    model.policy.optimizer.load_state_dict(content["optimizer"])
    model.num_timesteps = int(spec.training["timesteps"])
    return spec.training


def train(
    out: Path, setting: AnySetting, action: Task, hyper: Hyperparameters, *, seed: int, timesteps: int, command: str,
    eval_every: int, eval_episodes: int, resumed: bool = False,
) -> Path:  # fmt: skip
    """Train up to `timesteps` decisions in all and return the path of the model file. Ctrl-C keeps what was learned."""
    torch.set_num_threads(1)  # the networks are small, and the environments need the other cores
    held_out = replace(setting, split="test")
    training = asdict(setting) | {"seed": seed, "command": command, "versions": versions()}
    probe = cast(Any, setting).make(
        action
    )  # first alone: faults are reported here, and the inner loops are compiled once
    probe.reset(seed=seed)
    spec = ModelSpec.of(probe, action, hyper, training)
    probe.close()
    with vectorised(setting, action, hyper) as envs, progress_bar() as progress:
        model = make_algorithm(action, envs, hyper, seed)
        before = resume(model, out / "checkpoint.pt", spec) if resumed else {}
        spec.training["best"] = before.get("best", float("inf"))
        model.set_random_seed(seed + model.num_timesteps)  # a resumed run goes on to new worlds
        model.set_logger(open_logs(out, model.num_timesteps))
        watch = Watch(out, held_out, spec, eval_every, eval_episodes, progress)
        watch.init_callback(model)
        try:
            if model.num_timesteps < timesteps:
                model.learn(timesteps - model.num_timesteps, callback=watch, reset_num_timesteps=False)
            if watch.evaluated != model.num_timesteps:
                watch.evaluate()
            model.logger.dump(model.num_timesteps)
        except KeyboardInterrupt:
            progress.console.print(f"interrupted; go on with the same command and --resume --out {out}")
            raise
        finally:
            watch.save("checkpoint.pt")
            watch.save("model.pt")
            watch.close()
    return out / "model.pt"


def open_logs(out: Path, start: int) -> Logger:
    """TensorBoard and CSV logs; a resumed run writes a CSV file of its own."""
    out.mkdir(parents=True, exist_ok=True)
    csv = make_output_format("csv", str(out), f"_from_{start}" if start else "")
    return Logger(str(out), [csv, make_output_format("tensorboard", str(out))])


def progress_bar() -> Progress:
    """Decisions done, of how many, and the time left."""
    return Progress(TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m agents.train", description="Train an agent to drive.")
    p.add_argument("--agent", default="ppo", choices=["ppo"], help="what to train (default: %(default)s)")
    p.add_argument("--action", default="goal", choices=["goal", "twist"], help="what it decides (default: %(default)s)")
    p.add_argument("--reward", default="map_error", help="map_error, a_opt, d_opt or entropy (default: %(default)s)")
    p.add_argument("--timesteps", type=int, default=100_000, help="decisions in all (default: %(default)s)")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", type=Path, default=Path("runs/ppo"), metavar="DIR", help="default: %(default)s")
    p.add_argument("--resume", action="store_true", help="go on from DIR/checkpoint.pt up to --timesteps")
    p.add_argument(
        "--hyperparameters", type=Path, default=HYPERPARAMETERS, metavar="FILE", help="TOML (default: agents/)"
    )
    p.add_argument("--envs", type=int, help="parallel environments (default: from the hyperparameters)")
    p.add_argument("--eval-every", type=int, default=10_000, metavar="N", help="decisions (default: %(default)s)")
    p.add_argument("--eval-episodes", type=int, default=20, metavar="N", help="default: %(default)s")
    add_world_options(p, "office-small")
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    hyper = load_hyperparameters(a.action, a.hyperparameters)
    if a.envs is not None:
        hyper = Hyperparameters(**(asdict(hyper) | {"envs": a.envs}))
    for name, value in (("--timesteps", a.timesteps), ("--envs", hyper.envs), ("--eval-every", a.eval_every)):
        if value < 1:
            raise ValueError(f"{name} must be at least 1, not {value}")
    if not a.resume and (a.out / "checkpoint.pt").exists():
        raise ValueError(f"{a.out} holds a training already: give --resume to go on with it, or another --out")
    model = train(
        a.out, setting_of(a, reward=a.reward, split="train"), a.action, hyper, seed=a.seed, timesteps=a.timesteps,
        command=command_line("agents.train", argv), eval_every=a.eval_every, eval_episodes=a.eval_episodes,
        resumed=a.resume,
    )  # fmt: skip
    print(f"wrote {model}; evaluate it beside the baselines with\n  python -m agents.evaluate --model {model}"
          f" --scenario {a.scenario}")  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
