"""One drive on bad wheels, mapped twice: `slam-gym demo` draws the maps of nearest neighbour and the default.

Odometry and scans are the same; only the associations differ.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
from typer import Option

from agents.cli import command
from agents.options import Associators
from slam_gym.types import Array

WORLD = 4  # of the train split
ASSOCIATORS = ("nearest_neighbour", "learned")


def one_drive(scenario: str, world: int, **arguments: Any) -> Array:
    """(t, 2) the speeds, in [−1, 1], of a drive by information gain with true associations."""
    from agents.drivers.base import make_agent, visible

    arguments |= {"scenario": scenario, "disable_env_checker": True, "associator": "true_association"}
    env: Any = gym.make("slam_gym/Explore-v0", **arguments).unwrapped
    agent = make_agent("information_gain")
    agent.reset(world)
    observation, info = env.reset(seed=world, options={"world": world})
    speeds, tick, over = [], env.episode.tick, False

    def recorded_tick(forward: float, turn: float) -> None:
        speeds.append((forward, turn))
        tick(forward, turn)

    env.episode.tick = recorded_tick
    while not over:
        observation, _, over, _, info = env.step(agent.act(observation, visible(info)))
    return np.array(speeds)


def mapped(
    scenario: str, world: int, speeds: Array, *, watch: Callable[[Any], None] = lambda episode: None, **arguments: Any
) -> Any:
    """The episode with the same drive, odometry and scans, and another SLAM. Calls `watch(episode)` after each scan."""
    arguments |= {"scenario": scenario, "action": "twist", "disable_env_checker": True}
    env: Any = gym.make("slam_gym/Explore-v0", **arguments).unwrapped
    env.reset(seed=world, options={"world": world})
    watch(env.episode)
    for speed in speeds.tolist():
        env.episode.tick(*speed)
        watch(env.episode)
    return env.episode


def main(
    scenario: Annotated[str, Option(metavar="NAME", help="See slam-gym list scenarios.")] = "drift-3",
    seed: Annotated[int, Option(min=0, metavar="K", help="World k of the train split, with seed k.")] = WORLD,
    associators: Associators = None,
    output: Annotated[Path, Option(metavar="FILE", help="The picture.")] = Path("demo.png"),
) -> None:
    """Draw the maps that different associators make of one drive on bad wheels."""
    from matplotlib.figure import Figure

    from slam_gym.association import resolve_associator
    from slam_gym.rendering.plot import plot_episode

    names = associators or list(ASSOCIATORS)
    for name in names:
        resolve_associator(name)
    figure = Figure(figsize=(5.6 * len(names), 4.4), dpi=120, layout="constrained")
    formats = figure.canvas.get_supported_filetypes()
    if output.suffix[1:].lower() not in formats or not output.resolve().parent.is_dir():
        raise ValueError(f"--output {output}: expected a picture ({', '.join(formats)}) in a folder that exists")
    print(f"driving through {scenario}, world {seed} …", flush=True)
    speeds = one_drive(scenario, seed)
    figure.suptitle("true walls black, explored walls light, mapped features blue, true path grey, estimated path red")
    axes = figure.subplots(1, len(names), sharex=True, sharey=True, squeeze=False)[0]
    for ax, name in zip(axes, names):
        print(f"mapping {len(speeds)} scans with {name} …", flush=True)
        episode = mapped(scenario, seed, speeds, associator=name)
        error = episode.map_error()
        print(f"  map error {error:.2f} (0: a perfect map, 1: an empty one)")
        title = f"{name}: map error {error:.2f}"
        plot_episode(episode, ax).set(title=title, xticks=[], yticks=[], xlabel="", ylabel="")
        ax.spines[:].set_visible(False)
    figure.savefig(output)
    print(f"picture: {output.resolve()}")
    print(f"next: slam-gym evaluate-association --scenario {scenario} --associators {' '.join(names)} --episodes 4")


app = command("demo", main, "--associators jcbb ipjc --output mine.png")

if __name__ == "__main__":
    app()
