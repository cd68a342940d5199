"""`slam-gym train`: a driver by reinforcement learning.

Writes into its folder: model.zip (the last weights), best_model.zip (the best on held-out worlds), checkpoints/ (from
the last of which --resume goes on), progress.csv, and TensorBoard logs (`tensorboard --logdir DIR`).
"""

from __future__ import annotations

from typing import Annotated, Literal

from typer import Option

from agents.cli import command
from agents.options import Training, World


def main(
    training: Training,
    world: World,
    action: Annotated[Literal["goal", "twist"], Option(help="What it decides.")] = "goal",
    reward: Annotated[str, Option(help="map_error, a_opt, d_opt or entropy.")] = "map_error",
) -> None:
    """Train an agent to drive, by reinforcement learning."""
    from agents.learning.training import train

    arguments = world.arguments("office-small", "train", reward)
    model = train(action, arguments, training, "runs/ppo")
    print(f"wrote {model}; evaluate it beside the baselines with\n"
          f"  slam-gym evaluate --model {model} --scenario {arguments.scenario}")  # fmt: skip


app = command(main, "slam-gym train --scenario office-small --timesteps 50000 --output runs/mine")

if __name__ == "__main__":
    app()
