"""Train a driver: `python -m agents.train --scenario office-small --timesteps 50000 --seed 0 --out runs/demo`.

Writes into OUT: model.zip (the last weights), best_model.zip (the best on held-out worlds), checkpoints/ (from the last
of which --resume goes on), progress.csv, and TensorBoard logs (`tensorboard --logdir OUT`).
"""

from __future__ import annotations

from typing import Annotated, Literal

from typer import Option

from agents.cli import World, command
from agents.learning.training import Training, train


def main(
    training: Training,
    world: World,
    action: Annotated[Literal["goal", "twist"], Option(help="What it decides.")] = "goal",
    reward: Annotated[str, Option(help="map_error, a_opt, d_opt or entropy.")] = "map_error",
) -> None:
    """Train an agent to drive, by reinforcement learning."""
    arguments = world.arguments("office-small", "train", reward)
    model = train(action, arguments, training, "runs/ppo")
    print(f"wrote {model}; evaluate it beside the baselines with\n"
          f"  python -m agents.evaluate --model {model} --scenario {arguments.scenario}")  # fmt: skip


app = command(main)

if __name__ == "__main__":
    app()
