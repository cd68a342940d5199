"""Train an associator: `python -m agents.train_associate --scenario office-small --timesteps 300000 --out runs/assoc`.

MaskablePPO walks the interpretation tree of Associate-v0, while a baseline drives. Writes into OUT what `agents.train`
writes. The model file is an associator wherever a command takes one by file (`python -m agents.evaluate_association`),
and in Python through `agents.learning.models.load_associator`.
"""

from __future__ import annotations

from agents.cli import AssociateWorld, command
from agents.learning.training import Training, train
from slam_gym.simulation.association_runs import LOGS


def main(training: Training, world: AssociateWorld) -> None:
    """Train an agent to associate, by reinforcement learning."""
    model = train("branch", world.arguments("train"), training, "runs/assoc")
    where = f" --scenarios {world.scenario}" if world.scenario not in LOGS else ""  # nobody can drive in a log
    print(f"wrote {model}; compare it with the classical associators by\n"
          f"  python -m agents.evaluate_association --associators singles jcbb {model}{where}")  # fmt: skip


app = command(main)

if __name__ == "__main__":
    app()
