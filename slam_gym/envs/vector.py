"""Many worlds as one vector environment: `gym.make_vec("slam_gym/Explore-v0", 8, "vector_entry_point")`.

Several processes, including this one, each step a group of worlds. Actions, observations, rewards and the flags
`terminated` and `truncated` lie in shared memory; infos are sent over the standard output of the workers. A worker does
not import the caller's main module, which therefore needs no guard. It ends when its standard input does, so it ends
with this process.
"""

import contextlib
import itertools
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import cloudpickle
import gymnasium as gym
import numba
import numpy as np
from gymnasium import spaces
from gymnasium.error import ClosedEnvironmentError
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.base import BaseEnv, Observation
from slam_gym.envs.explore import ExploreEnv
from slam_gym.envs.relocate import RelocateEnv
from slam_gym.scenarios import SCENARIOS
from slam_gym.types import Array, BoolArray, IntArray
from slam_gym.validation import check_count

Infos = dict[str, Any]  # arrays (N, …) by key; beside every `key`, `_key` (N,) says which worlds have it
WorldInfos = list[tuple[int, dict[str, Any]]]  # worlds and their infos, in the order in which they are merged

_WORKER = "import sys; sys.path[:] = {path!r}; from slam_gym.envs.vector import serve; serve()"


class WorldError(RuntimeError):
    """An error in one world. The message names the world by its number; a note contains the traceback."""


class ManyWorlds(gym.vector.VectorEnv[Observation, Any, Array]):
    """N worlds of one environment, each bit for bit equal to the single environment with the same seed.

    A step that fails or is interrupted closes the vector environment, since its worlds are no longer at the same step.
    Other errors in a world are raised after all worlds have answered, and change nothing else.
    """

    def __init__(
        self,
        of: type[BaseEnv],
        num_envs: int = 1,
        *,
        workers: int | None = None,
        autoreset_mode: AutoresetMode | Literal["NextStep", "SameStep", "Disabled"] = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        **arguments: Any,
    ) -> None:
        """Make the worlds.

        Args:
            of: the class of the single environment, which `gym.make_vec` finds by its id.
            num_envs: number of worlds.
            workers: number of processes including this one; 0 or 1: only this process; None: the number of cores.
            autoreset_mode: what happens at the end of an episode, as defined by Gymnasium.
            max_episode_steps: number of steps after which an episode is `truncated`; None: never.
            **arguments: arguments of every single environment.
        """
        check_count("num_envs", num_envs)
        check_count("workers", workers or 1)  # 0 and None have a meaning of their own
        num_envs = int(num_envs)
        scenario = arguments.get("scenario")
        if isinstance(scenario, str):  # workers do not know those that the caller's script has registered
            arguments["scenario"] = SCENARIOS.get(scenario, scenario)

        def make() -> gym.Env[Any, Any]:
            env: gym.Env[Any, Any] = of(**arguments)
            return env if max_episode_steps is None else gym.wrappers.TimeLimit(env, max_episode_steps)

        single, self._autoreset = make(), AutoresetMode(autoreset_mode)  # raises for bad arguments
        self.num_envs, self.render_mode = num_envs, single.render_mode
        self._checked_options = cast(Any, single.unwrapped).checked_options
        self.metadata = {**single.metadata, "autoreset_mode": self._autoreset}
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        self.observation_space = batch_space(single.observation_space, num_envs)
        self.action_space = batch_space(single.action_space, num_envs)
        self._failure = ""  # the reason why the environment is closed
        self._started, self._groups = False, list[Any]()  # `_Worlds` here, then each `_Worker`
        processes = int(cast(Any, numba.config).NUMBA_DEFAULT_NUM_THREADS) if workers is None else workers
        groups = np.array_split(np.arange(num_envs), min(max(processes, 1), num_envs))
        kind, folder = _row_type(single), "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        handle, path = tempfile.mkstemp(prefix="slam_gym-", dir=folder)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(bytes(num_envs * kind.itemsize))  # the whole file, so that a full disk raises an error here
            self._shared: NDArray[Any] = np.asarray(np.memmap(path, kind, "r+"))
            for worlds in groups[1:]:
                self._groups.append(_Worker(worlds, make, self._autoreset, path, kind))
            self._groups.insert(0, _Worlds(groups[0], make, self._autoreset, path, kind))
            self._groups[0].shared = self._shared  # one array, so that a copy of both has one as well
            self._exchange("call", "render_mode", (), {})  # waits until all groups are ready
        except BaseException:
            self.close()
            raise
        finally:
            with contextlib.suppress(PermissionError):  # Windows does not delete mapped files
                Path(path).unlink()

    def reset(  # type: ignore[override]
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Begin an episode in every world. World i has the seed `seed` + i, or `seed[i]` of a sequence.

        `options` are those of the single environment, in which `world` may be a sequence with one entry for each
        world, and `reset_mask` (N,) bool, which selects the worlds to reset, after the first reset.
        """
        if not isinstance(options or {}, Mapping):
            raise ValueError(f"options: expected a dict, got {options!r}")
        options, count = dict(options or {}), self.num_envs
        mask = np.asarray(options.pop("reset_mask", np.ones(count, np.bool_)))
        if mask.shape != (count,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"options['reset_mask']={mask}: expected {count} flags (bool), at least one of them true")
        if not (self._started or mask.all()):
            raise ValueError(f"options['reset_mask']={mask}: the first reset is of all worlds")
        seed = seed.tolist() if isinstance(seed, np.ndarray | np.integer) else seed
        seeds = [seed + i for i in range(count)] if isinstance(seed, int) else self._each("seed", seed)
        worlds = self._each("options['world']", options.get("world"))
        each = [options if world is None else options | {"world": world} for world in worlds]
        resets = {i: {"seed": seeds[i], "options": each[i]} for i in np.flatnonzero(mask).tolist()}
        for i, arguments in resets.items():  # before any world changes
            with _numbered_errors(i):
                self._checked_options(arguments["options"])
                if seeds[i] is not None:
                    seeding.np_random(seeds[i])
        return self._outcome(self._exchange("reset", resets))

    def step(self, actions: Any) -> tuple[Observation, Array, BoolArray, BoolArray, Infos]:  # type: ignore[override]
        """Carry out an action in every world.

        Raises ValueError for an action outside the space, and RuntimeError for a world without an episode or, unless
        it is reset automatically, after the end of its episode. Both name the world, and no world changes.
        """
        self._check_open()
        self._shared["action"] = self._checked(actions)
        observations, infos = self._outcome(self._exchange("step"))
        reward, terminated, truncated = (self._shared[name].copy() for name in ("reward", "terminated", "truncated"))
        return observations, reward, terminated, truncated, infos

    def render(self) -> tuple[Any, ...]:  # type: ignore[override]
        return self.call("render")

    def __del__(self) -> None:
        if not self.closed and hasattr(self, "_groups"):
            self.close()

    def close_extras(self, **_: Any) -> None:
        for group in self._groups:
            group.close()

    def call(self, name: str, *arguments: Any, **named: Any) -> tuple[Any, ...]:
        """The results of the method, or the values of the attribute, `name` of each world."""
        return tuple(itertools.chain(*self._exchange("call", name, arguments, named)))

    get_attr = call

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute in each world: `values` is a sequence with a value for each world, or one value for all."""
        self._exchange("set_attr", name, self._each(name, values))

    def action_masks(self) -> BoolArray:
        """(N, actions) which actions are legal in each world. Raises AttributeError where actions are not discrete."""
        if not isinstance(self.single_action_space, spaces.Discrete):
            raise AttributeError("action masks exist in goal mode only")
        if not self._started:
            raise RuntimeError("no episode yet: call reset() first")
        return np.array(self._shared["mask"])

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedEnvironmentError(f"the environment is closed{self._failure}: make a new one")

    def _exchange(self, name: str, *arguments: Any) -> list[Any]:
        """The results of a method of each group of worlds. All answers are read before the first error is raised."""
        self._check_open()
        try:
            for group in self._groups:
                group.request(name, *arguments)
            answers = [group.answer() for group in self._groups]
            errors = [answer for answer in answers if isinstance(answer, WorldError)]
            if errors and name == "step":
                raise errors[0]
        except BaseException as error:  # worlds may be at different steps, or an answer unread
            self._failure = f" since a {name} failed ({error!r})"
            self.close()
            raise
        if errors:
            raise errors[0]
        return answers

    def _outcome(self, pairs: list[WorldInfos]) -> tuple[Observation, Infos]:
        """The observations of all worlds, and their infos merged from the answers of the groups."""
        shared: Any = self._shared["observation"]
        infos: Infos = {}
        self._started = True
        for world, info in itertools.chain(*pairs):
            infos = self._add_info(infos, info, world)
        return {name: np.array(shared[name]) for name in shared.dtype.names}, infos

    def _checked(self, actions: Any) -> NDArray[Any]:
        """(N,) or (N, 2) actions. Raises as `step`. Actions of worlds that are about to be reset may be anything."""
        over = self._shared["terminated"] | self._shared["truncated"]
        if not self._started:
            raise RuntimeError("no episode yet: call reset() first")
        if self._autoreset is AutoresetMode.DISABLED and over.any():
            raise RuntimeError(f"world {np.argmax(over)}: the episode is over: call reset(options={{'reset_mask': …}})")
        values, space, shape = np.asarray(actions), self.single_action_space, self._shared["action"].shape
        kinds, numbers = ("iu", "whole numbers") if len(shape) == 1 else ("iuf", "fractions")
        if values.shape != shape or values.dtype.kind not in kinds:
            raise ValueError(f"actions {actions!r}: expected {shape} {numbers}, a row for each world")
        low, high = (0, space.n - 1) if isinstance(space, spaces.Discrete) else (-1.0, 1.0)
        legal = ((values >= low) & (values <= high)).reshape(self.num_envs, -1).all(axis=1)
        legal |= over & (self._autoreset is AutoresetMode.NEXT_STEP)
        if not legal.all():
            raise ValueError(f"world {np.argmin(legal)}: action {values[np.argmin(legal)]} not within {low} … {high}")
        return values

    def _each(self, name: str, values: Any) -> list[Any]:
        """The values as a list with an entry for each world; one value is repeated. ValueError for a wrong length."""
        if not isinstance(values, list | tuple | np.ndarray):
            return [values] * self.num_envs
        if len(values) != self.num_envs:
            raise ValueError(f"{name}: {len(values)} values for {self.num_envs} worlds")
        return list(values)


ExploreWorlds = partial(ManyWorlds, ExploreEnv)
AssociateWorlds = partial(ManyWorlds, AssociateEnv)
RelocateWorlds = partial(ManyWorlds, RelocateEnv)


def _row_type(env: gym.Env[Any, Any]) -> np.dtype[Any]:
    """A world's row in shared memory. An action is an integer, or two float64, which represent float32 exactly."""
    assert isinstance(env.observation_space, spaces.Dict)
    parts = np.dtype([(name, box.dtype, box.shape) for name, box in env.observation_space.items()], align=True)
    action: list[Any] = [("action", np.float64, (2,))]
    if isinstance(env.action_space, spaces.Discrete):
        action = [("action", np.int64), ("mask", np.bool_, (int(env.action_space.n),))]
    ends = [("reward", np.float64), ("terminated", np.bool_), ("truncated", np.bool_)]
    return np.dtype([*action, *ends, ("observation", parts)], align=True)


class _Worlds:
    """The worlds with the numbers `worlds`, stepped in turn. Each has a row in shared memory, the file at `path`."""

    def __init__(self, worlds: IntArray, make: Callable[[], Any], mode: AutoresetMode, path: str, kind: Any) -> None:
        self._autoreset, self._envs = mode, {world: make() for world in worlds.tolist()}
        self.shared: NDArray[Any] = np.asarray(np.memmap(path, kind, "r+"))

    def request(self, name: str, *arguments: Any) -> None:
        self._method = partial(getattr(self, name), *arguments)

    def answer(self) -> Any:
        """The result of the requested method, or the WorldError that it raised."""
        try:
            return self._method()
        except WorldError as error:
            return error

    def reset(self, resets: Mapping[int, dict[str, Any]]) -> WorldInfos:
        """Begin an episode in each of the worlds that are keys of `resets`; the values are arguments of `reset`."""
        pairs: WorldInfos = []
        for world in filter(self._envs.get, resets):
            with _numbered_errors(world):
                observation, info = self._envs[world].reset(**resets[world])
            pairs.append((world, info))
            self._write_row(world, observation, info, 0.0, False, False)
        return pairs

    def step(self) -> WorldInfos:
        """Carry out the actions. Where an episode was or is over, begin the next according to the autoreset mode."""
        pairs: WorldInfos = []
        for world, env in self._envs.items():
            row = self.shared[world]
            with _numbered_errors(world):
                if (row["terminated"] or row["truncated"]) and self._autoreset is AutoresetMode.NEXT_STEP:
                    (observation, info), ends = env.reset(), (0.0, False, False)
                else:
                    observation, *ends, info = env.step(row["action"])
                if (ends[1] or ends[2]) and self._autoreset is AutoresetMode.SAME_STEP:
                    pairs.append((world, {"final_obs": observation, "final_info": info}))
                    observation, info = env.reset()
            pairs.append((world, info))
            self._write_row(world, observation, info, *ends)
        return pairs

    def call(self, name: str, arguments: Sequence[Any], named: Mapping[str, Any]) -> list[Any]:
        """The results of the method, or the values of the attribute, `name` of each world."""
        values = []
        for world, env in self._envs.items():
            with _numbered_errors(world):
                value = env.get_wrapper_attr(name)
                values.append(value(*arguments, **named) if callable(value) else value)
            if name == "restore":  # the row shows the world as it is now
                self._write_row(world, *values[-1], 0.0, env.unwrapped.over, False)
        return values

    def set_attr(self, name: str, values: Sequence[Any]) -> None:
        for world, env in self._envs.items():
            env.set_wrapper_attr(name, values[world])

    def close(self) -> None:
        for env in self._envs.values():
            env.close()

    def _write_row(self, world: int, observation: Observation, info: dict[str, Any], *ends: Any) -> None:
        row = self.shared[world]
        row["reward"], row["terminated"], row["truncated"] = ends
        if "action_mask" in info:
            row["mask"] = info["action_mask"]
        for name, part in observation.items():
            row["observation"][name] = part


class _Worker:
    """`_Worlds` in another process, which answer asynchronously. Raises RuntimeError if the process has ended."""

    def __init__(self, *arguments: Any) -> None:
        command = [sys.executable, "-c", _WORKER.format(path=[str(Path(place).resolve()) for place in sys.path])]
        environment = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        pipe: Any = subprocess.PIPE
        self.process: Any = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe)
        try:
            self.request("", *arguments)
        except BaseException:  # an argument that does not pickle
            self.close()
            raise

    def request(self, name: str, *arguments: Any) -> None:
        with _report_ended_worker():
            cloudpickle.dump((name, arguments), self.process.stdin)  # arguments may be functions of the caller's script
            self.process.stdin.flush()

    def answer(self) -> Any:
        with _report_ended_worker():
            return pickle.load(self.process.stdout)

    def close(self) -> None:
        """Close the process's input, at which it ends by itself; kill it if it does not."""
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()
        try:
            self.process.wait(5.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@contextlib.contextmanager
def _report_ended_worker() -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError, pickle.UnpicklingError) as error:
        raise RuntimeError("a worker process has ended: make a new environment") from error


def serve() -> None:
    """The main loop of a worker: make worlds and answer requests until the standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # output printed by worlds must not mix with the answers
    with contextlib.suppress(EOFError, BrokenPipeError):
        worlds = _Worlds(*pickle.load(requests)[1])
        while True:
            name, arguments = pickle.load(requests)
            worlds.request(name, *arguments)
            answer = worlds.answer()
            try:
                content = pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
            except Exception as error:
                content = pickle.dumps(WorldError(f"the answer to {name!r} does not pickle: {error}"))
            answers.write(content)
            answers.flush()


@contextlib.contextmanager
def _numbered_errors(world: int) -> Iterator[None]:
    """Convert any error to a WorldError with the number of the world."""
    try:
        yield
    except Exception as error:
        if isinstance(error.__cause__, KeyboardInterrupt):  # numba wraps it in a SystemError
            raise error.__cause__ from None
        numbered = WorldError(f"world {world}: {type(error).__name__}: {error}")
        numbered.add_note(traceback.format_exc())  # the cause itself is not pickled
        raise numbered from error
