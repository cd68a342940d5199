"""Train a driver: `python -m agents.train --scenario office-small --timesteps 50000 --seed 0 --out runs/demo`.

Writes into OUT: model.zip (the last weights), best_model.zip (the best on held-out worlds), checkpoints/ (from the last
of which --resume goes on), progress.csv, and TensorBoard logs (`tensorboard --logdir OUT`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from typer import Option

from agents.cli import World, command
from agents.evaluation.episodes import AssociateArguments, ExploreArguments
from agents.evaluation.records import command_line
from agents.learning.policies import HYPERPARAMETERS, Decision, load_hyperparameters
from agents.learning.training import TrainingPlan, train


@dataclass(frozen=True)
class Training:
    """What every training takes."""

    timesteps: Annotated[int, Option(min=1, metavar="N", help="Decisions, rounded up to whole rollouts.")] = 100_000
    seed: Annotated[int, Option(min=0)] = 0
    out: Annotated[Path | None, Option(metavar="DIR", help="By default a folder in runs/.")] = None
    resume: Annotated[bool, Option("--resume", help="Go on in DIR, up to --timesteps.")] = False
    hyperparameters: Annotated[Path, Option(metavar="FILE", help="TOML.")] = HYPERPARAMETERS
    envs: Annotated[int | None, Option(min=1, metavar="N", help="Environments; by default as in FILE.")] = None
    processes: Annotated[bool, Option("--processes", help="Give each environment a process of its own.")] = False
    eval_every: Annotated[int, Option(min=1, metavar="N", help="Decisions between evaluations.")] = 10_000
    eval_episodes: Annotated[int, Option(min=1, metavar="N", help="Held-out worlds.")] = 10

    def run(self, decision: Decision, arguments: ExploreArguments | AssociateArguments, folder: str) -> Path:
        """Train; the path of the model. ValueError where the options do not make sense."""
        hyper = load_hyperparameters(decision, self.hyperparameters)
        plan = TrainingPlan(
            decision, arguments, replace(hyper, envs=self.envs or hyper.envs), self.seed, self.timesteps,
            self.eval_every, self.eval_episodes, command_line(), self.processes,
        )  # fmt: skip
        return train(self.out or Path(folder), plan, self.resume)


def main(
    training: Training,
    world: World,
    agent: Annotated[Literal["ppo"], Option(help="What to train.")] = "ppo",
    action: Annotated[Literal["goal", "twist"], Option(help="What it decides.")] = "goal",
    reward: Annotated[str, Option(help="map_error, a_opt, d_opt or entropy.")] = "map_error",
) -> None:
    """Train an agent to drive, by reinforcement learning."""
    arguments = world.arguments("office-small", "train", reward)
    model = training.run(action, arguments, f"runs/{agent}")
    print(f"wrote {model}; evaluate it beside the baselines with\n"
          f"  python -m agents.evaluate --model {model} --scenario {arguments.scenario}")  # fmt: skip


app = command(main)

if __name__ == "__main__":
    app()
