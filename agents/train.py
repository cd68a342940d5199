"""Train a driver: `python -m agents.train --scenario office-small --timesteps 50000 --seed 0 --out runs/demo`.

Writes into OUT: model.pt (the last weights), best.pt (the best on held-out worlds), checkpoint.pt (from which --resume
goes on), progress.csv, and TensorBoard logs (`tensorboard --logdir OUT`).
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from agents.cli import add_explore_options, command_line, explore_arguments, program, require_positive, run_main
from agents.evaluation.episodes import AssociateArguments, ExploreArguments
from agents.learning.ppo import HYPERPARAMETERS, Decision, load_hyperparameters
from agents.learning.training import TrainingPlan, train


class Length(NamedTuple):
    """How long a training is, and how often it is watched, if nothing else is said."""

    timesteps: int  # decisions
    eval_every: int  # decisions
    eval_episodes: int


def add_training_options(p: argparse.ArgumentParser, default: Length, out: str) -> None:
    """What every training takes."""
    p.add_argument("--timesteps", type=int, default=default.timesteps, help="decisions in all, rounded up to whole "
                   "rollouts (default: %(default)s)")  # fmt: skip
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", type=Path, default=Path(out), metavar="DIR", help="default: %(default)s")
    p.add_argument("--resume", action="store_true", help="go on from DIR/checkpoint.pt up to --timesteps")
    p.add_argument("--hyperparameters", type=Path, default=HYPERPARAMETERS, metavar="FILE",
                   help="TOML (default: agents/learning/)")  # fmt: skip
    p.add_argument("--envs", type=int, help="parallel environments (default: from the hyperparameters)")
    p.add_argument("--workers", type=int, help="processes that step them (default: one a core)")
    p.add_argument("--eval-every", type=int, default=default.eval_every, metavar="N",
                   help="decisions (default: %(default)s)")  # fmt: skip
    p.add_argument("--eval-episodes", type=int, default=default.eval_episodes, metavar="N",
                   help="default: %(default)s")  # fmt: skip


def train_as_asked(
    a: argparse.Namespace, decision: Decision, arguments: ExploreArguments | AssociateArguments, command: str
) -> Path:
    """Train as the options above say; the path of the model. ValueError where they do not make sense, or `--out` holds
    a training already."""
    hyper = load_hyperparameters(decision, a.hyperparameters)
    require_positive(a, "timesteps", "envs", "eval_every")
    if a.envs is not None:
        hyper = replace(hyper, envs=a.envs)
    if not a.resume and (a.out / "checkpoint.pt").exists():
        raise ValueError(f"{a.out} holds a training already: give --resume to go on with it, or another --out")
    lengths = a.timesteps, a.eval_every, a.eval_episodes
    plan = TrainingPlan(decision, arguments, hyper, a.seed, *lengths, command, a.workers)
    return train(a.out, plan, a.resume)


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog=program("agents.train"), description="Train an agent to drive.")
    p.add_argument("--agent", default="ppo", choices=["ppo"], help="what to train (default: %(default)s)")
    p.add_argument("--action", default="goal", choices=["goal", "twist"], help="what it decides (default: %(default)s)")
    p.add_argument("--reward", default="map_error", help="map_error, a_opt, d_opt or entropy (default: %(default)s)")
    add_training_options(p, Length(100_000, 10_000, 20), "runs/ppo")
    add_explore_options(p, "office-small")
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    arguments = explore_arguments(a, reward=a.reward, split="train")
    model = train_as_asked(a, a.action, arguments, command_line("agents.train", argv))
    print(f"wrote {model}; evaluate it beside the baselines with\n  {program('agents.evaluate')} --model {model}"
          f" --scenario {arguments.scenario}")  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
