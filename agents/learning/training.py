"""Reinforcement learning: environments in parallel, PPO, watched on held-out worlds, resumable.

A training writes into a folder: model.zip (the last weights), best_model.zip (the best on held-out worlds),
checkpoints/ (--resume continues from the last), progress.csv, TensorBoard logs (`tensorboard --logdir DIR`); and of an
associator associator.npz, its last weights as plain arrays.
"""

import contextlib
import itertools
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.wrappers import FilterObservation, TransformReward
from sb3_contrib.common.maskable.callbacks import MaskableEvalCallback
from stable_baselines3.common.callbacks import BaseCallback, CheckpointCallback, EvalCallback
from stable_baselines3.common.logger import Logger, make_output_format
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv
from threadpoolctl import threadpool_limits

from agents.evaluation.episodes import AssociateArguments, ExploreArguments, reset_arguments
from agents.evaluation.records import command_line, plain, versions
from agents.learning import policies
from agents.learning.cloning import clone
from agents.learning.policies import About, Decision, Hyperparameters
from agents.options import Training
from slam_gym import weights
from slam_gym.geometry import compose
from slam_gym.simulation.association_runs import DrivenRun

HELD_OUT = 5_000
"""First world of the test split used to watch a training; evaluation reports on worlds from 0 on, so never on these."""

LOGGED = {"goal": ("map_error", "coverage"), "twist": ("map_error", "coverage"), "branch": ("score", "map_error")}
"""What is logged of an episode, from its last `info`, by what the policy decides."""

ASTRAY = 0.7  # [m] of a robot from where it believes to be, which ends an episode of association in training

Arguments = ExploreArguments | AssociateArguments

MODEL, WEIGHTS, CHECKPOINTS = "model.zip", "associator.npz", "checkpoints"
_MAY_CHANGE = ("command", "versions")  # when a training is resumed


class HeldOutWorlds(gym.Wrapper[Any, Any, Any, Any]):
    """Resets go through the same few held-out worlds, again and again: `count` episodes are one in each of them."""

    def __init__(self, decision: Decision, arguments: Arguments, count: int) -> None:
        super().__init__(make(decision, replace(arguments, split="test")))
        self._worlds = itertools.cycle(range(HELD_OUT, HELD_OUT + count))

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        return self.env.reset(**reset_arguments(next(self._worlds)))


class EndsAstray(gym.Wrapper[Any, Any, Any, Any]):
    """Truncates an episode of Associate-v0 once the robot is farther than `ASTRAY` from where it believes to be.

    On a broken map most pairings are wrong. An agent that had to go on there would make most of its decisions there and
    learn to refuse whatever is uncertain, and what it refuses makes the next scan more uncertain still.
    """

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        run: Any = self.env.unwrapped.run  # type: ignore[attr-defined]
        if isinstance(run, DrivenRun) and run.estimates:
            error = compose(run.base, run.estimates[-1]) - run.poses[-1]
            truncated |= bool(np.hypot(error[0], error[1]) > ASTRAY)
        return observation, reward, terminated, truncated, info


def make(decision: Decision, arguments: Arguments, scale: float | None = None) -> gym.Env[Any, Any]:
    """The environment; its rewards scaled, those of branches also by the number of scans, which differs between
    scenarios. A policy of branches does not see the budget, which it would not as an associator; episodes that it is
    trained on end when the robot is astray."""
    env = arguments.make(decision)
    if decision == "branch":
        env = FilterObservation(env, [name for name in env.observation_space if name != "budget"])
        env = env if scale is None else EndsAstray(env)
    env, inner = Monitor(env, info_keywords=LOGGED[decision]), env.unwrapped
    if scale is None:
        return env

    def scaled(reward: Any) -> float:
        return scale * float(reward) * (inner.run.length if decision == "branch" else 1)  # type: ignore[attr-defined]

    return TransformReward(env, scaled)


def train(
    decision: Decision, worlds: Sequence[Arguments], training: Training, folder: str, associator: str | None = None
) -> Path:
    """Train up to `training.timesteps` decisions in all, in its folder or in `folder`; the path of the model file. The
    environments take turns with what `worlds` are. A policy of branches may begin as the clone of an associator. Ctrl-C
    keeps what was learned.

    Raises ValueError where the folder holds a training and is not to be resumed, or one of something else; for a clone
    that is to be resumed; for more worlds than environments or held-out episodes; and as `load_hyperparameters`.
    """
    out = training.output or Path(folder)
    hyper = policies.load_hyperparameters(decision, training.hyperparameters or policies.HYPERPARAMETERS)
    changes = {name: getattr(training, name) for name in ("timesteps", "eval_every", "envs")}
    hyper = replace(hyper, **{name: value for name, value in changes.items() if value is not None})
    models = [*out.glob(MODEL), *out.glob(f"{CHECKPOINTS}/*.zip")]
    if models and not training.resume:
        raise ValueError(f"{out} holds a training already: give --resume to go on with it, or another --output")
    if training.resume and associator is not None:
        raise ValueError("--clone begins a training, --resume goes on with one: give one of them")
    if not models and training.resume:
        raise ValueError(f"{out} holds no training to resume")
    last = max(models, key=_steps, default=None)
    torch.set_num_threads(1)  # the networks and the products of SLAM are small: more threads are slower
    threadpool_limits(1)
    if (fewest := min(hyper.envs, training.eval_episodes)) < len(worlds):
        raise ValueError(f"{len(worlds)} scenarios need as many --envs and --eval-episodes, not {fewest}")
    held_out = [(training.eval_episodes + i) // len(worlds) for i in range(len(worlds))]  # as EvalCallback spreads them
    watched = DummyVecEnv([partial(HeldOutWorlds, decision, *each) for each in zip(worlds, held_out)])
    known = worlds[0].plain | {"scenario": [each.scenario for each in worlds], "split": "train", "seed": training.seed}
    known |= {"command": command_line(), "versions": versions()}
    shapes = {name: list(space.shape) for name, space in watched.observation_space.spaces.items()}
    about = About(decision, shapes, gym.spaces.flatdim(watched.action_space), hyper, plain(known))
    vectorised = SubprocVecEnv if training.processes and hyper.envs > 1 else DummyVecEnv
    learned_from = [partial(make, decision, replace(each, split="train"), hyper.reward_scale) for each in worlds]
    envs: VecEnv = vectorised([learned_from[k % len(worlds)] for k in range(hyper.envs)])
    model: Any = policies.make_algorithm(decision, envs, hyper, training.seed)
    model.about = asdict(about)  # Stable-Baselines3 writes it into its files as JSON
    if last is not None:
        _resume(model, last, about)
    elif associator is not None:
        losses = clone(model.policy, [each() for each in learned_from], associator, training.seed)
        print(f"cloned {associator}: −log p of its decisions {losses[-1]:.3f}")
    out.mkdir(parents=True, exist_ok=True)
    csv = f"_from_{model.num_timesteps}" if model.num_timesteps else ""  # a resumed training writes a file of its own
    logs = [make_output_format("csv", str(out), csv), make_output_format("tensorboard", str(out))]
    model.set_logger(Logger(str(out), logs))
    watch = _watch(out, about, training, watched, model.num_timesteps)
    keep = CheckpointCallback(watch.eval_freq, str(out / CHECKPOINTS), "model")
    try:
        if (left := hyper.timesteps - model.num_timesteps) > 0:
            callbacks = [EpisodeEnds(LOGGED[decision], hyper), keep, watch]
            model.learn(left, callbacks, reset_num_timesteps=False, progress_bar=True)
    finally:
        model.save(out / MODEL)
        if decision == "branch":
            weights.write(out / WEIGHTS, policies.branch_weights(model.policy, about.training))
        with contextlib.suppress(OSError, EOFError):  # Ctrl-C has ended its processes
            envs.close()
        watched.close()
    return out / MODEL


def _watch(out: Path, about: About, training: Training, held_out: VecEnv, start: int) -> EvalCallback:
    """What tries the present weights on held-out worlds, and keeps the best; of a resumed training, the best of all."""
    warnings.filterwarnings("ignore", "Training and eval env", UserWarning)  # one has processes, the other needs none
    results = [np.load(path)["results"] for path in out.glob("held_out_from_*/evaluations.npz")]
    watch = (MaskableEvalCallback if about.action in policies.CHOICES else EvalCallback)(
        held_out,
        n_eval_episodes=training.eval_episodes,
        eval_freq=max(about.hyperparameters.eval_every // about.hyperparameters.envs, 1),
        log_path=str(out / f"held_out_from_{start}"),
        best_model_save_path=str(out),
        deterministic=about.hyperparameters.deterministic,
    )
    watch.best_mean_reward = max((float(rewards.mean(axis=1).max()) for rewards in results), default=-np.inf)
    return watch


class EpisodeEnds(BaseCallback):
    """Logs what decisions and the last episodes came to, and lowers the entropy coefficient where it is annealed."""

    def __init__(self, names: Sequence[str], hyper: Hyperparameters) -> None:
        super().__init__()
        self._names, self._hyper = names, hyper

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self._hyper.annealed:
            left = policies.LAST + (1.0 - policies.LAST) * self.model._current_progress_remaining
            self.model.ent_coef = left * self._hyper.ppo["ent_coef"]  # type: ignore[attr-defined]

    def _on_rollout_end(self) -> None:
        self.logger.record("rollout/reward", float(self.model.rollout_buffer.rewards.mean()))  # type: ignore[attr-defined]
        episodes = list(self.model.ep_info_buffer or [])
        for name in self._names if episodes else ():
            self.logger.record(f"rollout/{name}", float(np.mean([episode[name] for episode in episodes])))


def _steps(path: Path) -> int:
    """The number of steps that a model was trained for, or −1: a training that was killed may leave half a file."""
    try:
        return policies.read_about(path).timesteps
    except ValueError:
        return -1


def _resume(model: Any, path: Path, about: About) -> None:
    """Load weights, optimiser and step count, and go on to new worlds. ValueError where it was trained on something
    else."""
    before = policies.read_about(path)
    for name in sorted(about.training.keys() - set(_MAY_CHANGE)):
        was, now = before.training.get(name), about.training[name]
        if was != now:
            raise ValueError(f"{path} was trained with {name} {was!r}, not {now!r}")
    present = {name: getattr(about.hyperparameters, name) for name in ("timesteps", "eval_every", "envs")}
    if before.network != about.network or replace(before.hyperparameters, **present) != about.hyperparameters:
        raise ValueError(f"{path} was trained on action {before.action!r} with other hyperparameters")
    model.set_parameters(path, device="cpu")  # weights only: nothing is unpickled
    model.num_timesteps = before.timesteps
    model.set_random_seed(model.seed + model.num_timesteps)
