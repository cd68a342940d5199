"""The base class of the three environments: reset, step, snapshots and copies, rendering, closing."""

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from slam_gym.scenarios import (
    SPLITS,
    Scenario,
    floor_budget,
    from_floor_plan,
    get_scenario,
    overridden,
    world_generator,
    world_seed,
)
from slam_gym.scenarios.scenario import Plain
from slam_gym.simulation.episode import Site, survey
from slam_gym.validation import known_names, one_of

Observation = dict[str, Any]
Info = dict[str, Any]
Kind = TypeVar("Kind", bound="Settings")
Split = Literal["train", "test"]
RenderMode = Literal["rgb_array", "rgb_array_list", "human"]
T = TypeVar("T")

_CARRIED_OVER = ("_np_random_seed", "action_space", "observation_space", "spec")
"""Attributes that a copy takes over, since replay does not restore them: spaces have random states of their own."""


class Snapshot(NamedTuple):
    """Everything that determines the present state of an environment, which is restored by replay."""

    generator: dict[str, Any]  # state of `np_random` when the episode began
    series: tuple[int, ...]  # state that the environment carries from episode to episode
    options: dict[str, Any]  # of the reset
    actions: list[Any]  # since the reset


def box(length: int, low: float = -1.0) -> gym.spaces.Box:
    """The space of vectors of `length` numbers from `low` to 1."""
    return gym.spaces.Box(low, 1.0, (length,), np.float32)


def chosen_scenario(scenario: str | Scenario, overrides: Mapping[str, Plain] | None = None) -> Scenario:
    """A scenario, itself or by name, with `overrides` applied. Raises ValueError as `get_scenario` and `overridden`."""
    original = get_scenario(scenario) if isinstance(scenario, str) else scenario
    for name, value, kind in (("scenario", original, Scenario), ("overrides", overrides or {}, Mapping)):
        if not isinstance(value, kind):
            raise ValueError(f"{name}: expected a {kind.__name__}, got {value!r}")
    return overridden(original, overrides) if overrides else original


@dataclass(frozen=True)
class Settings:
    """The arguments that all environments take.

    - `scenario`: a name from `slam_gym.scenarios.SCENARIOS`, a level of the suite such as `"closure/0"`, or a
      `Scenario`; by default `"office"`. `floor_plan` (a file), with `resolution` [m per pixel] for occupancy images,
      replaces the scenario's worlds by that floor; the scenario is then `"building"` by default.
    - `split`: `"train"` or `"test"`, whose worlds never overlap.
    - `overrides`: fields of the scenario to change, by dotted name, such as
      `{"sensor.range": 4.0, "odometry.turn_per_metre": 0.1, "dynamics.people": 3}`.
    - `render_mode`: `"rgb_array"`, `"rgb_array_list"` (all pictures since the last call, for films) or `"human"`.
    """

    scenario: Any = None
    split: Split = "train"
    floor_plan: str | Path | None = None
    resolution: float | None = None
    overrides: Mapping[str, Plain] | None = None
    render_mode: RenderMode | None = None

    def __post_init__(self) -> None:
        one_of("split", self.split, SPLITS)
        one_of("render_mode", self.render_mode, (None, "rgb_array", "rgb_array_list", "human"))
        if isinstance(self.overrides, Mapping):
            object.__setattr__(self, "overrides", dict(self.overrides))  # the caller's may change

    @property
    def scenario_on_floor(self) -> Scenario:
        """The scenario with its overrides: by default `"office"`, or with a floor plan `"building"` on that floor.

        Raises ValueError for a resolution without a floor plan, and for an invalid file as `load_floor_plan` does.
        """
        if self.floor_plan is None:
            if self.resolution is not None:
                raise ValueError(f"resolution={self.resolution} goes with a floor_plan, and there is none")
            return chosen_scenario("office" if self.scenario is None else self.scenario, self.overrides)
        like = chosen_scenario("building" if self.scenario is None else self.scenario)
        scenario = chosen_scenario(from_floor_plan(self.floor_plan, self.resolution, like), self.overrides)
        if not self.overrides or "budget" in self.overrides:
            return scenario
        return replace(scenario, budget=floor_budget(scenario.generator(np.random.default_rng()), scenario))


def settings_of(kind: type[Kind], scenario: Any, arguments: Mapping[str, Any]) -> Kind:
    """The settings of an environment. Raises TypeError, listing the known ones, for an unknown argument."""
    known = [field.name for field in fields(kind)]
    for name in arguments:
        if name not in known:
            raise TypeError(f"{kind.__name__.removesuffix('Settings')} takes no {name!r}; {known_names(name, known)}")
    return kind(scenario, **arguments)


class BaseEnv(gym.Env[Observation, Any], ABC):
    """An environment whose episodes are determined by the generator's state and options at reset, and the actions.

    A reset without a seed uses the generator that lies one jump (at least 2¹²⁷ numbers) beyond the generator of the
    previous episode, so that the episodes after a seeded one do not depend on the actions taken in it.

    A subclass defines how an episode begins (`_begin`), what an action does (`_act`), the observation and info
    (`_observe`, `_info`), when the episode is `over`, and its picture (`_picture`). Its `_act` calls `_changed` when
    there is something new to render.

    Environments can be pickled and deepcopied during an episode. The copy is constructed from the same arguments and
    replays the episode, which takes as long as the episode did; it then continues like the original, bit for bit. It
    has no watchers and no window. If an argument does not pickle (a lambda as associator), the `snapshot` still does.
    """

    metadata = {"render_modes": ["rgb_array", "rgb_array_list", "human"], "render_fps": 4}  # noqa: RUF012 (Gymnasium's convention)

    settings: type[Settings] = Settings  # names and defaults of the arguments

    def __init__(self, settings: Settings) -> None:
        self.arguments = settings
        self.split, self.render_mode = settings.split, settings.render_mode
        self._snapshot: Snapshot | None = None
        self._episode_generator: np.random.Generator | None = None
        self._series: tuple[int, ...] = ()
        self._failed = False  # a step or reset raised an error half-way
        self._site: Site | None = None
        self._watchers: list[Callable[[Any], None]] = []
        self._replaying = False
        self._window: Any = None
        self._frames: list[NDArray[np.uint8]] = []  # not yet returned by `render`

    # -- Gymnasium ---------------------------------------------------------------------------------------------------

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, Info]:
        """Start an episode. `options={"world": i}` selects a world; any other option raises ValueError."""
        options = self.checked_options(options)  # before any change
        super().reset(seed=seed)
        if seed is not None:
            self._series = ()
        elif self._np_random is not None and self._np_random is self._episode_generator:
            self._np_random = self._next_generator()
        self._episode_generator = self.np_random
        state: Any = copy.deepcopy(self.np_random.bit_generator.state)
        snapshot = Snapshot(state, self._series, options, [])
        self._snapshot, self._failed, self._frames = snapshot, True, []
        try:
            observation = self._begin(self._draw_world(options))
            self._changed()
            info = self._info()
        except BaseException:  # there is no episode to go back to, and the next reset tries the same one
            self.np_random.bit_generator.state = state
            self._series, self._snapshot, self._episode_generator = snapshot.series, None, None
            raise
        self._failed = False
        return observation, info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, Info]:
        """Carry out one action.

        Raises RuntimeError before the first reset and after the end of the episode, and ValueError for an action
        outside the space; neither changes anything. If an error occurs within the step, for example in an associator,
        the episode ends with it: every further step raises RuntimeError, and `snapshot` returns the state before it.
        """
        if self._failed:
            back = "" if self._snapshot is None else ", or restore(snapshot()) to go back"
            raise RuntimeError(f"the last call failed half-way: call reset(){back}")
        history = self._started(self._snapshot)
        if self.over:
            raise RuntimeError("the episode is over: call reset()")
        action = self._checked(action)
        self._failed = True
        reward = self._act(action)
        outcome = self._observe(), float(reward), self.over, False, self._info()
        self._failed = False
        history.actions.append(action)
        return outcome

    def render(self) -> NDArray[np.uint8] | list[NDArray[np.uint8]] | None:  # type: ignore[override]
        """The picture (h, w, 3) in `rgb_array` mode; in `human` mode, updates the window and returns None.

        In `rgb_array_list` mode, returns all pictures since the last call, one per tick.
        """
        if self.render_mode is None:
            gym.logger.warn("render() without a render_mode: pass render_mode='rgb_array' or 'human' to gym.make")
            return None
        self._started(self._snapshot)
        if self.render_mode == "rgb_array_list":
            frames, self._frames = self._frames, []
            return frames
        # imported here, since pygame is an extra that only pictures need
        from slam_gym.rendering.canvas import Window, pixels

        picture = self._picture()
        if self.render_mode == "rgb_array":
            return pixels(picture)
        if self._window is None:
            self._window = Window(type(self).__name__, float(self.metadata["render_fps"]))
        self._window.show(picture)
        return None

    def close(self) -> None:
        """Close the window, if there is one. May be called repeatedly; rendering opens a new window."""
        if self._window is not None:
            self._window.close()

    def checked_options(self, options: dict[str, Any] | None) -> dict[str, Any]:
        """The options of a reset. Raises ValueError for unknown ones, and for a world outside the split."""
        if not isinstance(options or {}, Mapping):
            raise ValueError(f"options: expected a dict, got {options!r}")
        checked = dict(options or {})
        if unknown := set(checked) - {"world"}:
            raise ValueError(f"unknown reset option {sorted(unknown)[0]!r}; known: world")
        world_seed(self.split, checked.get("world", 0))
        return checked

    # -- beyond Gymnasium --------------------------------------------------------------------------------------------

    def watch(self, callback: Callable[[Any], None]) -> None:
        """From now on, call `callback(env)` whenever there is something new to render, for example to make a film."""
        self._watchers.append(callback)

    def snapshot(self) -> Snapshot:
        """The present state, for `restore`. Raises RuntimeError before the first reset."""
        return copy.deepcopy(self._started(self._snapshot))

    def restore(self, snapshot: Snapshot) -> tuple[Observation, Info]:
        """Replay the snapshot of an environment with the same arguments; returns its last observation and info.

        Raises ValueError for anything but a snapshot.
        """
        if not isinstance(snapshot, Snapshot):
            raise ValueError(f"snapshot: {type(snapshot).__name__}, expected what `snapshot()` of one world returns")
        generator = np.random.default_rng()
        generator.bit_generator.state = copy.deepcopy(snapshot.generator)
        self.np_random, self._series = generator, snapshot.series
        self._replaying = True
        try:
            observation, info = self.reset(options=snapshot.options)
            for action in snapshot.actions:
                observation, _, _, _, info = self.step(action)
        finally:
            self._replaying = False
        return observation, info

    def __reduce__(self) -> Any:
        again = partial(type(self), **vars(self.arguments))
        generator = None if self._failed else self._np_random  # a failed step may have used it
        return again, (), (self._snapshot, generator, self._carried_over())

    def __setstate__(self, state: tuple[Snapshot | None, np.random.Generator | None, dict[str, Any]]) -> None:
        snapshot, generator, carried_over = state
        vars(self).update(carried_over)
        if snapshot is None:
            self._np_random = generator
            return
        self.restore(snapshot)
        if generator is not None:
            self.np_random.bit_generator.state = generator.bit_generator.state  # the episode shares this generator
        vars(self).update(carried_over)

    # -- what a subclass provides ------------------------------------------------------------------------------------

    @abstractmethod
    def _begin(self, world: int) -> Observation:
        """Start an episode in the `world`-th world of the split; returns the first observation."""

    @abstractmethod
    def _act(self, action: Any) -> float:
        """Carry out an action that `_checked` returned; returns the reward."""

    @abstractmethod
    def _observe(self) -> Observation: ...

    @abstractmethod
    def _info(self) -> Info: ...

    @property
    @abstractmethod
    def over(self) -> bool:
        """Whether the episode has ended."""

    @abstractmethod
    def _picture(self) -> Any:
        """A pygame surface that shows the present state."""

    # -- what a subclass may use or change ---------------------------------------------------------------------------

    def _draw_world(self, options: dict[str, Any]) -> int:
        """The world of an episode: the one in `options`, else a random one of the split."""
        drawn = int(self.np_random.integers(SPLITS[self.split][1]))
        return int(options.get("world", drawn))

    def _checked(self, action: Any) -> Any:
        """The action in the form that `_act` takes. Raises ValueError for an action outside the space."""
        space = self.action_space
        assert isinstance(space, gym.spaces.Discrete)
        if not space.contains(action):
            raise ValueError(f"action {action!r} is not one of 0 … {space.n - 1}")
        return int(action)

    def _carried_over(self) -> dict[str, Any]:
        """Attributes that are assigned to a copy before it replays the episode, and again afterwards."""
        return {name: getattr(self, name) for name in _CARRIED_OVER}

    def _changed(self) -> None:
        """Call the watchers, and render the present state in modes that show every change."""
        if self._replaying or not (self._watchers or self.render_mode):
            return
        for callback in self._watchers:
            callback(self)
        if self.render_mode == "human":
            self.render()
        elif self.render_mode == "rgb_array_list":
            from slam_gym.rendering.canvas import pixels

            self._frames.append(pixels(self._picture()))

    def _started(self, part: T | None) -> T:
        """`part`, a part of the running episode. Raises RuntimeError where it is None, before the first reset."""
        if part is None:
            raise RuntimeError("no episode yet: call reset() first")
        return part

    def _next_generator(self) -> np.random.Generator:
        """The generator of the next episode: this episode's generator as it was at the reset, jumped once."""
        assert self._snapshot is not None
        bits = type(self.np_random.bit_generator)()
        bits.state = self._snapshot.generator
        return np.random.Generator(cast(Any, bits).jumped())

    def _survey(self, scenario: Scenario, world: int) -> Site:
        """The surveyed floor of a world. A floor that is the same in every episode is surveyed only once."""
        plan = scenario.generator(world_generator(self.split, world))
        if self._site is None or self._site.plan is not plan:
            self._site = survey(plan, scenario)
        return self._site
