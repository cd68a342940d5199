"""Episodes: the arguments of their environment, which are the same for every agent, the run to the end, and the
evaluations of every driver, or of one driver with every associator, in the same test worlds."""

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import slam_gym  # noqa: F401  (registers the environments)
from agents.drivers.base import Agent, is_learned, make_agent, visible
from agents.drivers.clairvoyant import Clairvoyant
from agents.evaluation.associators import Metered, contenders, hashes_of, metered
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record, stem
from slam_gym.slam.relocate import SEARCH

ON_A_FLOOR = "building"
"""The default scenario for a floor plan file."""


@dataclass(frozen=True)
class _Arguments:
    """The arguments of both environments."""

    scenario: str
    overrides: tuple[tuple[str, Any], ...] = ()  # dotted names in the scenario, and their values
    split: str = "test"

    @property
    def plain(self) -> dict[str, Any]:
        """The arguments as the environment takes them and results record them."""
        return asdict(self) | {"overrides": dict(self.overrides)}


@dataclass(frozen=True)
class ExploreArguments(_Arguments):
    """Arguments of slam_gym/Explore-v0, except those that depend on the agent."""

    scenario: str = "office"
    associator: str | None = None  # None: that of the scenario
    reward: str = "map_error"
    floor_plan: str | None = None  # a file that replaces the scenario's worlds
    resolution: float | None = None  # [m/pixel] of that file, where it is an image
    relocation: str | None = SEARCH  # the search that relocates a lost robot

    @property
    def world(self) -> str:
        """The name of its worlds for titles: that of the scenario, or of the file of a floor plan, with the scenario
        unless it is the default there."""
        if self.floor_plan is None:
            return self.scenario
        return Path(self.floor_plan).name + f" as {self.scenario}" * (self.scenario != ON_A_FLOOR)

    def make(self, action: str, **others: Any) -> gym.Env[Any, Any]:
        """The environment; `others` are further arguments of it, and replace those of the same name. Raises ValueError,
        with the known names, for an unknown associator or relocator."""
        return gym.make("slam_gym/Explore-v0", action=action, disable_env_checker=True, **self.plain | others)


@dataclass(frozen=True)
class AssociateArguments(_Arguments):
    """Arguments of slam_gym/Associate-v0."""

    scenario: str = "office-small"
    split: str = "train"
    driver: str = "nearest_frontier"
    reward: str = "truth"
    candidates: int = 5
    order: str = "as_scanned"
    compatibility: str = "joint"
    wrong_cost: float = 10.0

    def make(self, action: str = "branch") -> gym.Env[Any, Any]:
        """The environment, which has one kind of action. ValueError, with the known names, for an unknown one."""
        return gym.make("slam_gym/Associate-v0", disable_env_checker=True, **self.plain)


LOST_ERROR, LOST_DUPLICATES = 0.8, 10.0
"""A map with a greater error, or with more features mapped twice, counts as lost: it contains the building twice."""

LOST_MEANS = (
    f"lost: fraction of episodes with a map error above {LOST_ERROR:g} "
    f"or more than {LOST_DUPLICATES:g} features mapped twice"
)


def reset_arguments(episode: int) -> dict[str, Any]:
    """Arguments of `env.reset` for the i-th episode of a split."""
    return {"seed": episode, "options": {"world": episode}}


CURVE = ("ticks", "map_error", "coverage")
CURVE_STEP = 10  # [ticks] least distance between points of a curve, since twist episodes have many steps


def begin_episode(env: gym.Env[Any, Any], agent: Agent, episode: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Reset environment and agent for the i-th episode; returns the first observation and info. The clairvoyant driver,
    identified by its class, receives the truth here; no other agent does."""
    observation, info = env.reset(**reset_arguments(episode))
    digest = hashlib.sha256(f"agent of episode {episode}".encode()).digest()
    agent.reset(int.from_bytes(digest[:4], "big"))  # different for each episode, and does not reveal the world
    if isinstance(agent, Clairvoyant):
        agent.behold(env.unwrapped.episode)  # type: ignore[attr-defined]
    return observation, info


def run_episode(
    env: gym.Env[Any, Any], agent: Agent, episode: int, watch: Callable[[gym.Env[Any, Any]], None] | None = None
) -> Record:
    """Drive one episode of Explore-v0 to its end. `watch(env)` is called after every tick.

    Returns a flat dict of JSON-able numbers: episode, return, decisions, ticks, seconds (of driving, without the
    reset), all of `map_quality`, map_lost; and `curve`, lists of equal length over the decisions: ticks, map_error,
    coverage.
    """
    observation, info = begin_episode(env, agent, episode)
    if watch is not None:
        env.unwrapped.watch(watch)  # type: ignore[attr-defined]
    curve = {name: [float(info[name]) if name != "ticks" else 0] for name in CURVE}
    decisions, ticks, total, ended = 0, 0, 0.0, False
    start = time.perf_counter()
    while not ended:
        try:
            action = agent.act(observation, visible(info))
        except Exception as error:
            error.add_note(f"raised by agent {agent.name}")
            raise
        observation, reward, terminated, truncated, info = env.step(action)
        ended = terminated or truncated
        decisions, ticks, total = decisions + 1, ticks + int(info["ticks"]), total + float(reward)
        if ended or ticks - curve["ticks"][-1] >= CURVE_STEP:
            for name, value in zip(CURVE, (ticks, info["map_error"], info["coverage"])):
                curve[name].append(round(float(value), 6))
    seconds = time.perf_counter() - start
    quality = {key: float(np.asarray(value)) for key, value in info["map_quality"].items()}
    record = {"episode": episode, "return": total, "decisions": decisions, "seconds": seconds} | quality
    lost = float(record["map_error"] > LOST_ERROR or record["duplicates"] > LOST_DUPLICATES)
    return record | {"map_lost": lost, "ticks": ticks, "ticks_per_second": ticks / seconds, "curve": curve}


# -- the evaluations --------------------------------------------------------------------------------------------------


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
    if associator is None:
        return arguments.make(action), None
    meter, associate = metered(associator)
    return arguments.make(action, associator=associate), meter


def driver_evaluation(
    drivers: Sequence[Driver], loops: Sequence[ExploreArguments], episodes: Sequence[int]
) -> Evaluation:
    """The evaluation of every driver in every episode of every loop. Loads the models, and raises ValueError for
    unknown names, and for a model that does not fit a loop."""
    tried = {driver.model or _agent(driver).action: driver for driver in reversed(drivers)}
    for loop, driver in product(loops, tried.values()):
        _try_out(driver, loop, episodes[0])
    tasks = [
        Task([Key(driver.agent, loop.world, k, driver.model)], partial(drive, driver, loop, None, k))
        for loop, k, driver in product(loops, episodes, drivers)
    ]
    of_drivers = [name for driver in drivers for name in (driver.agent, driver.model)]
    models = hashes_of(*of_drivers, loops[0].floor_plan, loops[0].associator, loops[0].relocation)
    for name in {driver.model for driver in drivers if driver.model}:
        models[name] |= _training(Path(name))
    several = {"scenario": [loop.scenario for loop in loops]} if len(loops) > 1 else {}
    return Evaluation("drivers", tasks, loops[0].plain | several, {"models": models})


def _try_out(driver: Driver, loop: ExploreArguments, episode: int) -> None:
    """Let a driver decide once, which also compiles the inner loops of its kind of action here, instead of in every
    worker. Raises ValueError, naming it, for a model that does not fit the loop."""
    agent = _agent(driver)
    env, _ = _loop(loop, agent.action, None)
    observation, info = begin_episode(env, agent, episode)
    try:
        action = agent.act(observation, visible(info))
    except (AssertionError, KeyError, ValueError) as error:  # AssertionError: of Stable-Baselines3
        if not driver.model:
            error.add_note(f"raised by agent {driver.agent}")
            raise
        raise ValueError(f"model {driver.model}: does not fit {loop.world}: {str(error)[:300]}") from None
    env.step(action)


def _training(model: Path) -> dict[str, Any]:
    """The description of the training in a model file; empty for a trusted file of another format."""
    from agents.learning.policies import read_about  # imports torch, which only learned agents need

    try:
        about = read_about(model)
    except ValueError:
        return {}
    return {"training": about.training | {"timesteps": about.timesteps}}


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
    models = hashes_of(*associators, *relocations, driver, loops[0].floor_plan)
    return Evaluation("associators", tasks, conditions, {"models": models})
