"""Train an associator: `python -m agents.train_associate --scenario office-small --timesteps 300000 --out runs/assoc`.

MaskablePPO walks the interpretation tree of Associate-v0, while a baseline drives. Writes into OUT what `agents.train`
writes. The model file is an associator wherever a command takes one by file (`python -m agents.evaluate_association`),
and in Python through `agents.learning.association_models.load`.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from agents.cli import command_line, run_main
from agents.learning.association_setting import add_association_options, association_setting
from agents.learning.ppo import HYPERPARAMETERS, load_hyperparameters
from agents.train import train


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m agents.train_associate", description="Train an agent to associate.")
    p.add_argument("--timesteps", type=int, default=300_000, help="decisions in all (default: %(default)s)")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", type=Path, default=Path("runs/assoc"), metavar="DIR", help="default: %(default)s")
    p.add_argument("--resume", action="store_true", help="go on from DIR/checkpoint.pt up to --timesteps")
    p.add_argument(
        "--hyperparameters", type=Path, default=HYPERPARAMETERS, metavar="FILE", help="TOML (default: agents/)"
    )
    p.add_argument("--envs", type=int, help="parallel environments (default: from the hyperparameters)")
    p.add_argument("--eval-every", type=int, default=50_000, metavar="N", help="decisions (default: %(default)s)")
    p.add_argument("--eval-episodes", type=int, default=10, metavar="N", help="default: %(default)s")
    add_association_options(p)
    return p


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    hyper = load_hyperparameters("branch", a.hyperparameters)
    if a.envs is not None:
        hyper = replace(hyper, envs=a.envs)
    for name, value in (("--timesteps", a.timesteps), ("--envs", hyper.envs), ("--eval-every", a.eval_every)):
        if value < 1:
            raise ValueError(f"{name} must be at least 1, not {value}")
    if not a.resume and (a.out / "checkpoint.pt").exists():
        raise ValueError(f"{a.out} holds a training already: give --resume to go on with it, or another --out")
    model = train(
        a.out, association_setting(a, "train"), "branch", hyper, seed=a.seed, timesteps=a.timesteps,
        command=command_line("agents.train_associate", argv), eval_every=a.eval_every, eval_episodes=a.eval_episodes,
        resumed=a.resume,
    )  # fmt: skip
    print(f"wrote {model}; compare it with the classical associators by\n  python -m agents.evaluate_association"
          f" --associators singles jcbb {model} --scenarios {a.scenario}")  # fmt: skip
    return 0


if __name__ == "__main__":
    raise SystemExit(run_main(main))
