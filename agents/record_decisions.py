"""`slam-gym record-decisions`: what an associator decides in Associate-v0, as a Minari data set."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from typer import Option

from agents.cli import command
from agents.options import AssociateWorld, Episodes

if TYPE_CHECKING:
    import gymnasium as gym
    from numpy.typing import NDArray

EPISODES = 10


class Decided(NamedTuple):
    """The t decisions of an episode."""

    observations: dict[str, NDArray[np.float32]]  # parts (t + 1, …): before each decision, and after the last
    masks: NDArray[np.bool_]  # (t, k + 1) legal actions
    actions: NDArray[np.int64]  # (t,)
    right: NDArray[np.int64]  # (t,) what the truth would have taken; −1 where that is unknown or not on offer
    rewards: NDArray[np.float64]  # (t,)
    world: int


def decisions(env: gym.Env[Any, Any], associator: str | Callable[..., Any], worlds: range) -> Iterator[Decided]:
    """Each world's episode of Associate-v0, decided by an associator; `true_association` is told the truth.

    A feature that is not on offer is left unpaired. ValueError for an associator that nobody knows.
    """
    from agents.evaluation.episodes import reset_arguments
    from slam_gym.association import resolve_associator
    from slam_gym.simulation.judged import CEILING

    associate, bare, told = resolve_associator(associator), env.unwrapped, associator == CEILING
    for world in worlds:
        observation, info = env.reset(**reset_arguments(world))
        seen, steps, look, over, answer = [observation], [], -1, False, None
        while not over:
            mask, right = info["action_mask"], info["truth"]["action"]
            if not told and info["look"] != look:
                look, answer = info["look"], associate(bare.run.scan, bare.run.prediction)  # type: ignore[attr-defined]
            action = right if told else bare.action_of(answer)  # type: ignore[attr-defined]
            if action is None or action < 0:
                action = bare.K  # type: ignore[attr-defined]
            observation, reward, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            seen.append(observation)
            steps.append((mask, action, right, reward))
        masks, actions, rights, rewards = (np.array(column) for column in zip(*steps))
        parts = {name: np.stack([one[name] for one in seen]) for name in seen[0]}
        yield Decided(parts, masks.astype(bool), actions, rights, rewards, world)


def main(
    world: AssociateWorld,
    episodes: Episodes,
    associator: Annotated[str, Option(metavar="NAME", help="See slam-gym list associators.")] = "jcbb",
    split: Annotated[Literal["train", "test"], Option(help="Of the worlds.")] = "train",
    dataset: Annotated[str, Option(metavar="NAME", help="Of the data set, as Minari names them.")] = "",
) -> None:
    """Write an associator's decisions into a Minari data set: pip install 'slam_gym[minari]'."""
    import minari
    from minari.data_collector import EpisodeBuffer

    worlds, buffers, numbers = world.worlds(split), [], episodes.range(EPISODES)
    name = dataset or f"slam_gym/{'-'.join(each.scenario for each in worlds)}/{associator}-v0"
    envs = [each.make() for each in worlds]
    for each, own in ((each, one) for each, env in zip(worlds, envs) for one in decisions(env, associator, numbers)):
        ends = np.arange(1, len(own.actions) + 1) == len(own.actions)
        taken, infos = (own.observations, own.actions, own.rewards), {"action_mask": own.masks, "right": own.right}
        buffers.append(EpisodeBuffer(own.world, own.world, None, *taken, ends, np.zeros_like(ends), infos))
        right, earned = np.mean(own.actions == own.right), own.rewards.sum()
        print(f"{each.scenario}, world {own.world}: {len(ends)} decisions, {right:.0%} right, return {earned:.2f}")
    minari.create_dataset_from_buffers(
        name, buffers, env=envs[0], algorithm_name=associator, description="Decisions of an associator in Associate-v0"
    )
    print(f'data set: minari.load_dataset("{name}")')


app = command(main, "slam-gym record-decisions --scenario drift-2 --associator learned --episodes 20")
if __name__ == "__main__":
    app()
