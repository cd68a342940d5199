"""`slam-gym record-decisions`: writes the decisions of an associator in Associate-v0 as a Minari data set."""

from collections.abc import Callable, Iterator
from typing import Annotated, Any, Literal, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from typer import Option

from agents.cli import command
from agents.evaluation.records import stem
from agents.options import AssociateWorld, Episodes

EPISODES = 10


class EpisodeDecisions(NamedTuple):
    """The t decisions of an episode."""

    observations: dict[str, NDArray[np.float32]]  # parts (t + 1, …): before each decision, and after the last
    masks: NDArray[np.bool_]  # (t, k + 1) legal actions
    actions: NDArray[np.int64]  # (t,)
    right: NDArray[np.int64]  # (t,) the right actions; −1 where unknown or not on offer
    rewards: NDArray[np.float64]  # (t,)
    world: int


def decisions(
    env: gym.Env[Any, Any], associator: str | Callable[..., Any], worlds: range, mistakes: float = 0.0
) -> Iterator[EpisodeDecisions]:
    """The episode of Associate-v0 in each world, decided by an associator; `true_association` uses the truth.

    A measurement whose feature is not on offer is left unpaired. A fraction of `mistakes` is decided at random, so that
    states after a wrong decision occur as well. Raises ValueError for an unknown associator.
    """
    from agents.evaluation.episodes import reset_arguments
    from slam_gym.association import resolve_associator
    from slam_gym.simulation.judged import CEILING

    bare: Any = env.unwrapped
    associate, uses_truth = resolve_associator(associator), associator == CEILING
    for world in worlds:
        rng = np.random.default_rng((world, 3))
        observation, info = env.reset(**reset_arguments(world))
        observations, steps, look, over, answer = [observation], [], -1, False, None
        while not over:
            mask, right = info["action_mask"], info["truth"]["action"]
            if not uses_truth and bare.walk is not None and info["look"] != look:  # no walk: there is no choice
                look, answer = info["look"], associate(bare.run.scan, bare.run.prediction)
            action = right if uses_truth else bare.action_of(answer)
            if action is None or action < 0:
                action = bare.K
            if rng.random() < mistakes:
                action = int(rng.choice(np.flatnonzero(mask)))
            observation, reward, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            observations.append(observation)
            steps.append((mask, action, right, reward))
        masks, actions, rights, rewards = (np.array(column) for column in zip(*steps))
        parts = {name: np.stack([each[name] for each in observations]) for name in observations[0]}
        yield EpisodeDecisions(parts, masks.astype(bool), actions, rights, rewards, world)


def main(
    world: AssociateWorld,
    episodes: Episodes,
    associator: Annotated[str, Option(metavar="NAME", help="See slam-gym list associators.")] = "jcbb",
    split: Annotated[Literal["train", "test"], Option(help="Split of the worlds.")] = "train",
    dataset: Annotated[str, Option(metavar="NAME", help="Name of the data set: NAME-v0, or FOLDER/NAME-v0.")] = "",
) -> None:
    """Write an associator's decisions to a Minari data set. Needs the extra `minari`."""
    import minari
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_dataset import parse_dataset_id

    worlds, numbers = world.worlds(split), episodes.range(EPISODES, split)
    if dataset and len(worlds) > 1:
        raise ValueError(f"--dataset {dataset}: each of the {len(worlds)} scenarios has a data set of its own")
    data_sets = {dataset or f"slam_gym/{stem(each.scenario)}/{stem(associator)}-v0": each for each in worlds}
    if len(data_sets) < len(worlds):
        raise ValueError(f"--scenario: some share a data set, since only {', '.join(data_sets)} would be written")
    for name in data_sets:
        try:
            parse_dataset_id(name)
        except (TypeError, ValueError) as error:  # TypeError: it has no version
            reason = error if isinstance(error, ValueError) else "no version"
            raise ValueError(f"--dataset {name}: is neither NAME-v0 nor FOLDER/NAME-v0 ({reason})") from None
        if name in minari.list_local_datasets():
            raise ValueError(f"--dataset {name}: there is one of this name")
    for name, each in data_sets.items():
        buffers, env = [], each.make()
        for e in decisions(env, associator, numbers):
            ends = np.arange(1, len(e.actions) + 1) == len(e.actions)
            steps, infos = (e.observations, e.actions, e.rewards), {"action_mask": e.masks, "right": e.right}
            episode = len(buffers), e.world, {"world": e.world}  # seed and options of its reset
            buffers.append(EpisodeBuffer(*episode, *steps, ends, np.zeros_like(ends), infos))
            right, total = np.mean(e.actions == e.right), e.rewards.sum()
            print(f"{each.scenario}, world {e.world}: {len(ends)} decisions, {right:.0%} right, return {total:.2f}")
        text = f"Decisions in Associate-v0, {len(numbers)} episodes of {each.scenario}"
        minari.create_dataset_from_buffers(name, buffers, env=env, algorithm_name=associator, description=text)
        print(f'data set: minari.load_dataset("{name}")')


app = command("record-decisions", main, "--scenario drift-2 --associator learned --episodes 20")

if __name__ == "__main__":
    app()
