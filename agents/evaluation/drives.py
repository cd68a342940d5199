"""Drives through the same test worlds, by every driver or by one driver with every associator."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.drivers.base import Agent, is_learned, make_agent, visible
from agents.evaluation.associators import Metered, contenders, hash_of, hashes_of, metered, models_of
from agents.evaluation.episodes import ExploreArguments, reset_arguments, run_episode
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record, stem


@dataclass(frozen=True)
class Driver:
    """An agent, and the model file of a learned one."""

    agent: str
    model: str = ""
    trust: bool = False

    def make(self) -> Agent:
        return make_agent(self.agent, self.model or None, trust=self.trust)


def drivers_of(names: Sequence[str], models: Sequence[Path | str], trust: bool) -> list[Driver]:
    """One driver for each name, for learned ones one for each model file. Models without a learned name add `ppo`."""
    names = list(dict.fromkeys(names))
    if models and not any(is_learned(name) for name in names):
        names.append("ppo")
    files = [str(Path(model).resolve()) for model in models]
    return [Driver(name, file, trust) for name in names for file in (is_learned(name) and files) or [""]]


def drive(
    driver: Driver, arguments: ExploreArguments, associator: str | None, episode: int, picture: Path | None = None
) -> list[Record]:
    """One drive through one world. An evaluated `associator` replaces that of the arguments; its decisions and its
    effort are recorded as well, and its final map is drawn into the file `picture`."""
    agent = _agent(driver)
    env, meter = _loop(arguments, agent.action, associator)
    if meter is None:
        return [run_episode(env, agent, episode)]
    meter.reset()
    record = run_episode(env, agent, episode)
    del record["curve"]
    if picture is not None:
        from agents.reports.figures import final_map

        picture.parent.mkdir(parents=True, exist_ok=True)
        final_map(env.unwrapped.episode).savefig(picture)  # type: ignore[attr-defined]
    tally: Any = env.unwrapped.episode.identities.total  # type: ignore[attr-defined]
    return [record | {"f1": tally.f1, "exact": tally.exact} | asdict(tally) | meter.effort()]


# Agents and environments are cached for the next task of the same process.
_agent = lru_cache(maxsize=8)(Driver.make)


@lru_cache(maxsize=4)
def _loop(arguments: ExploreArguments, action: str, associator: str | None) -> tuple[gym.Env[Any, Any], Metered | None]:
    """The environment, and the meter of the evaluated associator."""
    meter, associate = (None, None) if associator is None else metered(associator)
    return arguments.make(action, associator=associate), meter


def driver_evaluation(
    drivers: Sequence[Driver], loops: Sequence[ExploreArguments], episodes: Sequence[int]
) -> Evaluation:
    """The evaluation of every driver in every episode of every loop. Loads the models, and raises ValueError for
    unknown names, and for a model that does not fit a loop."""
    for loop in loops:
        _warm_up(loop, drivers, episodes[0])
    tasks = [
        Task([Key(driver.agent, loop.world, k, driver.model)], partial(drive, driver, loop, None, k))
        for loop, k, driver in product(loops, episodes, drivers)
    ]
    models = {driver.model: _describe(Path(driver.model)) for driver in drivers if driver.model}
    several = {"scenario": [loop.scenario for loop in loops]} if len(loops) > 1 else {}
    return Evaluation("drivers", tasks, loops[0].plain | several, {"models": models | hashes_of([loops[0].floor_plan])})


def _warm_up(loop: ExploreArguments, drivers: Sequence[Driver], episode: int) -> None:
    """Compile the inner loops here once, instead of in every worker, and let every model decide once. Raises
    ValueError, naming it, for a model that does not fit the loop."""
    agents = {driver: driver.make() for driver in drivers}
    for action in sorted({agent.action for agent in agents.values()}):
        env = loop.make(action)
        observation, info = env.reset(**reset_arguments(episode))
        for driver, agent in agents.items():
            if driver.model and agent.action == action:
                try:
                    agent.act(observation, visible(info))
                except ValueError as error:
                    raise ValueError(f"model {driver.model}: does not fit {loop.world}: {error}") from None
        env.step(0 if isinstance(env.action_space, gym.spaces.Discrete) else env.action_space.sample())
        env.close()


def _describe(model: Path) -> dict[str, Any]:
    """The hash of a model file, and its description of the training."""
    from agents.learning.policies import read_about  # imports torch, which only learned agents need

    try:
        about = read_about(model)
    except ValueError:  # a trusted file of another format
        return hash_of(model)
    return hash_of(model) | {"training": about.training | {"timesteps": about.timesteps}}


def map_path(out: Path, setting: str, name: str) -> Path:
    """The file of an associator's final map in its first episode of a setting."""
    return out / "maps" / f"{stem(setting, name)}.png"


def associator_evaluation(
    associators: Sequence[str],
    loops: Sequence[ExploreArguments],
    driver: str,
    episodes: Sequence[int],
    relocations: Sequence[str | None],
    out: Path | None = None,
) -> Evaluation:
    """The evaluation of every associator with each of the `relocations` in every loop; draws final maps into `out`.

    Raises ValueError for an unknown associator, scenario, driver or relocator.
    """
    names, fixed_driver, tasks = contenders(associators, relocations), Driver(driver), []
    for loop in loops:
        _loop(loop, _agent(fixed_driver).action, associators[0])  # raises for unknown names
    for loop, k, (name, (associator, relocation)) in product(loops, episodes, names.items()):
        picture = map_path(out, loop.world, name) if out and k == episodes[0] else None
        call = partial(drive, fixed_driver, replace(loop, relocation=relocation), associator, k, picture)
        tasks.append(Task([Key(name, loop.world, k)], call))
    shared = {name: loops[0].plain[name] for name in ("split", "overrides", "floor_plan", "resolution")}
    conditions = {"driver": driver, "relocation": list(relocations)} | shared
    files = models_of(associators) | hashes_of([loops[0].floor_plan])
    return Evaluation("associators", tasks, conditions, {"models": files})
