"""`slam-gym train drive` and `slam-gym train associate`: policies by reinforcement learning.

`agents.learning.training` lists their files. Every command accepts associator.npz as the name of an associator; in
Python it is `slam_gym.association.ppo(scan, prediction, weights=FILE)`.
"""

import shlex
from dataclasses import replace
from typing import Annotated, Literal

from typer import Option, Typer

from agents.cli import command
from agents.options import AssociateWorld, ExploreWorld, Training

QUICK = 400_000  # decisions


def options_of(world: ExploreWorld | AssociateWorld, *names: str) -> str:
    """The options `names` and the overrides that a command has got, as another command takes them."""
    given = [(f"--{name.replace('_', '-')}", getattr(world, name)) for name in names]
    given += [("--set", change) for change in world.overrides or ()]
    return shlex.join(str(text) for option in given if option[1] is not None for text in option)


def drive(
    training: Training,
    world: ExploreWorld,
    action: Annotated[Literal["goal", "twist"], Option(help="What it decides.")] = "goal",
    reward: Annotated[str, Option(help="map_error, a_opt, d_opt or entropy.")] = "map_error",
) -> None:
    """Train an agent to drive."""
    from agents.learning.training import train

    arguments = world.arguments("office-small", "train", reward)
    model = train(action, [arguments], training, "runs/drive")
    where = options_of(world, "floor_plan", "resolution", "associator", "relocation")
    if arguments.floor_plan is None or world.scenario:
        where = f"--scenario {arguments.scenario} {where}"
    print(f"wrote {model}; evaluate it beside the baselines with\n  slam-gym evaluate --model {model} {where}")


def associate(
    training: Training,
    world: AssociateWorld,
    clone: Annotated[str | None, Option(metavar="NAME", help="Begin by deciding as this associator does.")] = None,
    quick: Annotated[bool, Option("--quick", help=f"{QUICK} decisions, three minutes: to see it learn.")] = False,
) -> None:
    """Train an agent to associate, in scenarios that take turns."""
    from agents.learning.training import WEIGHTS, train
    from slam_gym.simulation.association_runs import LOGS

    worlds = world.worlds("train")
    training = replace(training, timesteps=training.timesteps or QUICK) if quick else training
    weights = train("branch", worlds, training, "runs/associate", clone).with_name(WEIGHTS)
    driven = [name for each in worlds if (name := each.scenario) not in LOGS and not name.startswith("recording:")]
    where = f"--scenario {' '.join(driven)} {options_of(world)}" if driven else "--suite"  # no drives in logs
    print(f"wrote {weights}, and the curve to progress.csv there; compare it with the classical associators by\n"
          f"  slam-gym evaluate-association --associators jcbb marginal {weights} {where}")  # fmt: skip


app = Typer(name="train", help="Train a driver or an associator.", add_completion=False, pretty_exceptions_enable=False)
command("drive", drive, "--scenario office-small --timesteps 50000 --output runs/mine", app)
command("associate", associate, "--quick --output runs/mine", app)

if __name__ == "__main__":
    app()
