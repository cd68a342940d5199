"""Train an associator: `python -m agents.train_associate --scenario office-small --timesteps 300000 --out runs/assoc`.

MaskablePPO walks the interpretation tree of Associate-v0, while a baseline drives. Writes into OUT what `agents.train`
writes. The model file is an associator wherever a command takes one by file (`python -m agents.evaluate_association`),
and in Python through `agents.learning.policies.load_associator`.
"""

from __future__ import annotations

import argparse

from agents.cli import add_associate_options, associate_arguments, command_line, program, run_main
from agents.train import Length, add_training_options, train_as_asked
from slam_gym.simulation.association_runs import LOGS


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog=program("agents.train_associate"), description="Train an agent to associate.")
    add_training_options(p, Length(300_000, 50_000, 10), "runs/assoc")
    add_associate_options(p)
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    command = command_line("agents.train_associate", argv)
    model = train_as_asked(a, "branch", associate_arguments(a, "train"), command)
    where = f" --scenarios {a.scenario}" if a.scenario not in LOGS else ""  # nobody can drive in a log
    print(f"wrote {model}; compare it with the classical associators by\n  {program('agents.evaluate_association')}"
          f" --associators singles jcbb {model}{where}")  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
