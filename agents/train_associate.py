"""`slam-gym train-associate`: an associator by reinforcement learning.

MaskablePPO walks the interpretation tree of Associate-v0, while a baseline drives. Writes into its folder what
`slam-gym train` writes. The model file is an associator wherever a command takes one by file, and in Python through
`agents.learning.models.load_associator`.
"""

from __future__ import annotations

from agents.cli import command
from agents.options import AssociateWorld, Training


def main(training: Training, world: AssociateWorld) -> None:
    """Train an agent to associate, by reinforcement learning."""
    from agents.learning.training import train
    from slam_gym.simulation.association_runs import LOGS

    model = train("branch", world.arguments("train"), training, "runs/assoc")
    where = f" --scenario {world.scenario}" if world.scenario not in LOGS else ""  # nobody can drive in a log
    print(f"wrote {model}; compare it with the classical associators by\n"
          f"  slam-gym evaluate-association --associators singles jcbb {model}{where}")  # fmt: skip


app = command(main, "slam-gym train-associate --scenario office-small --timesteps 300000 --output runs/mine")

if __name__ == "__main__":
    app()
