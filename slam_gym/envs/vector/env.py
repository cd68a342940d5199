"""Many worlds as one Gymnasium vector environment, spread over processes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from slam_gym.envs.base import BaseEnv, Observation, Snapshot
from slam_gym.envs.vector.buffers import Layout, SharedBlock
from slam_gym.envs.vector.checks import (
    checked_actions,
    one_each,
    options_of,
    reset_mask,
    seeds_of,
    shared_out,
    worker_count,
)
from slam_gym.envs.vector.drawing import Drawing
from slam_gym.envs.vector.infos import InfoLayout, Infos, SharedInfos, enter, plainest
from slam_gym.envs.vector.worker import WorkerWorlds
from slam_gym.envs.vector.worlds import Making, Told, Worlds
from slam_gym.envs.warm_up import compile_on_two_cores
from slam_gym.types import Array, BoolArray

Outcome = tuple[Observation, Array, BoolArray, BoolArray, Infos]
RESET_MASK = "reset_mask"  # the option by which Gymnasium resets some worlds only


class ManyWorlds(gym.vector.VectorEnv[Observation, Any, Array]):
    """N worlds of one of the environments, each bit for bit what the single environment is with the same seed.

    The worlds are spread over `workers` processes, this one among them, each of which steps its own one after the other
    and writes into memory that all share. An error in a world is raised here, with the number of the world; the others
    have made their step. Workers end with this process.
    """

    def __init__(
        self,
        of: type[BaseEnv],
        num_envs: int = 1,
        *,
        workers: int | None = None,
        autoreset_mode: AutoresetMode | Literal["NextStep", "SameStep", "Disabled"] = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        copy: bool = True,
        **arguments: Any,
    ) -> None:
        """Make the worlds.

        Args:
            of: the class of the single environment, which `gym.make_vec` knows by its id.
            num_envs: how many worlds.
            workers: processes, of which this is the first; 0 or 1: all in this one; None: as many as there are cores.
            autoreset_mode: what happens at the end of an episode, as Gymnasium has it.
            max_episode_steps: after so many steps an episode is `truncated`; None: never.
            copy: hand out copies of the observations; else the shared arrays, which the next step overwrites.
            **arguments: of every single environment.
        """
        if not (isinstance(num_envs, int) and num_envs >= 1):
            raise ValueError(f"num_envs={num_envs}: expected a whole number >= 1")
        self.num_envs, self._copy = num_envs, copy
        making = Making(of, arguments, AutoresetMode(autoreset_mode), max_episode_steps)
        single = making()  # refuses bad arguments now
        assert isinstance(single.observation_space, spaces.Dict)
        self.metadata = {**single.metadata, "autoreset_mode": making.autoreset}
        self.render_mode = single.render_mode
        self.single_observation_space, self.single_action_space = single.observation_space, single.action_space
        self.observation_space = batch_space(single.observation_space, num_envs)
        self.action_space = batch_space(single.action_space, num_envs)
        self._autoreset = making.autoreset
        self._masks: BoolArray | None = None
        self._begun = np.zeros(num_envs, np.bool_)
        layout = Layout.of(single.observation_space, single.action_space, num_envs)
        count = worker_count(workers, num_envs)
        self._rows = shared_out(num_envs, max(count, 1))
        self._groups: Sequence[WorkerWorlds | _Here] = []
        self._drawing: Drawing | None = None
        self._infos: SharedInfos | None = None
        if count <= 1:
            self._buffers = layout.buffers(bytearray(layout.size))
            self._groups = [_Here(Worlds(making, self._rows[0], self._buffers))]
            return
        if compile_on_two_cores(getattr(single, "associator", "jcbb")):  # once, and not in every worker
            single.reset(seed=0)
        self._start(making, layout)

    # -- Gymnasium ---------------------------------------------------------------------------------------------------

    def reset(  # type: ignore[override]
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Begin an episode in every world.

        Args:
            seed: of world 0, that of world i being i more; or one for each world; or None, and each goes on drawing.
            options: those of the single environment, where `world` may be a sequence with one for each world; and
                `reset_mask` (N,) bool, the worlds to reset.
        """
        options = dict(options or {})
        which = reset_mask(options.pop(RESET_MASK, None), self.num_envs)
        seeds, of_worlds = seeds_of(seed, self.num_envs), options_of(options, self.num_envs)
        chosen = np.flatnonzero(which).tolist()
        told = self._parts("reset", {i: seeds[i] for i in chosen}, {i: of_worlds[i] for i in chosen})
        infos = self._take_in(told)
        self._share_infos(told)
        self._begun |= which
        return self._observations(), infos

    def step(self, actions: Any) -> Outcome:  # type: ignore[override]
        """Carry out an action in every world.

        Raises ValueError for an action outside the space and RuntimeError for a world without an episode or, where
        nothing resets it, with one that is over; both name the world, and no world has moved then.
        """
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: Any) -> None:
        """Begin a step, and return while the workers carry it out; `step_wait` does the part of this process. Raises as
        `step`."""
        self._check_running()
        self._buffers.actions[:] = self._checked(actions)
        for group, rows in zip(self._groups, self._rows):
            group.request("step", {} if self._drawing is None else self._drawing.ready(rows))

    def step_wait(self) -> Outcome:
        """What the step that was begun came to."""
        infos = self._take_in(self._answers())
        _, rewards, terminated, truncated, _ = self._buffers
        return self._observations(), rewards.copy(), terminated.copy(), truncated.copy(), infos

    def render(self) -> tuple[Any, ...]:  # type: ignore[override]
        """What `render` of each world gives."""
        return self.call("render")

    def close_extras(self, **_: Any) -> None:
        """End the workers, and close the worlds."""
        for part in (*self._groups, self._drawing):
            if part is not None:
                part.close()

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """The generator of each world."""
        return self.call("np_random")

    @property
    def np_random_seed(self) -> tuple[int | None, ...]:  # type: ignore[override]
        """The seed of each world."""
        return self.call("np_random_seed")

    # -- as Gymnasium's own vector environments have it --------------------------------------------------------------

    def call(self, name: str, *arguments: Any, **named: Any) -> tuple[Any, ...]:
        """What the method or attribute `name` of each world gives."""
        return self.call_in(range(self.num_envs), name, *arguments, **named)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """The attribute of each world."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute in each world: to the value of each, given as a list or tuple, or one and the same."""
        each = values if isinstance(values, list | tuple) else [values] * self.num_envs
        self._parts("set_attr", name, dict(enumerate(one_each(name, each, self.num_envs))))

    # -- beyond it ---------------------------------------------------------------------------------------------------

    def action_masks(self) -> BoolArray:
        """(N, actions) which actions are legal in each world now. AttributeError where there are no masks."""
        if not isinstance(self.single_action_space, spaces.Discrete):
            raise AttributeError("action masks exist in goal mode only")
        if self._masks is None:
            raise RuntimeError("no episode yet: call reset() first")
        return self._masks.copy()

    def call_in(self, worlds: Collection[int], name: str, *arguments: Any, **named: Any) -> tuple[Any, ...]:
        """`call` in some worlds only; what they give, in the order of their numbers."""
        return tuple(value for part in self._parts("call", name, arguments, named, worlds) for value in part)

    def restore(self, snapshots: Sequence[Snapshot]) -> tuple[Observation, Infos]:
        """Go on in each world from its snapshot, as `call("snapshot")` gave them; returns what the worlds last gave."""
        given = dict(enumerate(one_each("snapshots", snapshots, self.num_envs)))
        told = self._parts("restore", given)
        infos = self._take_in(told)
        self._share_infos(told)
        self._begun[:] = True
        return self._observations(), infos

    # -- parts -------------------------------------------------------------------------------------------------------

    def _start(self, making: Making, layout: Layout) -> None:
        """Start the workers, and wait until they have made their worlds."""
        block = SharedBlock(layout.size)
        try:
            self._buffers = layout.buffers(block.memory)
            workers = [WorkerWorlds(making, rows, layout, block.path) for rows in self._rows[1:]]
            # A process that waits takes its time to wake up; this one has no need to while its own part lasts.
            ahead = self._autoreset is not AutoresetMode.DISABLED
            here = Worlds(making, self._rows[0], self._buffers.of(self._rows[0]), ahead)
            for worker in workers:
                worker.answer()
            self._groups = [_Here(here), *workers]
            if self._autoreset is not AutoresetMode.DISABLED:
                self._drawing = Drawing(making, layout, block.path)
        finally:
            block.forget()

    def _share_infos(self, told: Sequence[Told]) -> None:
        """Give memory to infos that are made like those of the first reset, so that they need not be sent."""
        infos = [info for part in told for _, info in part.infos]
        layout = InfoLayout.of(plainest(infos), self.num_envs) if self._infos is None and infos else None
        if layout is None:
            return
        if len(self._groups) == 1:
            here = bytearray(layout.size)
            self._infos = SharedInfos(layout, here)
            self._parts("share_infos", layout, here)
            return
        block = SharedBlock(layout.size)
        try:
            self._infos = SharedInfos(layout, block.memory)
            self._parts("share_infos", layout, block.path)
        finally:
            block.forget()

    def _check_running(self) -> None:
        if self.closed:
            raise RuntimeError("the environment is closed")

    def _parts(self, name: str, *arguments: Any) -> list[Any]:
        self._check_running()
        for group in self._groups:
            group.request(name, *arguments)
        return self._answers()

    def _take_in(self, parts: list[Told | None]) -> Infos:
        """The infos of all worlds; their masks are kept, and the worlds that come next drawn ahead."""
        infos: Infos = {} if self._infos is None else self._infos.read()
        for part in parts:
            if part is None:
                continue
            if self._drawing is not None:
                self._drawing.ask(part.upcoming)
            for world, info in part.infos:
                enter(infos, info, world, self.num_envs)
        if "action_mask" in infos:
            masks, told = infos["action_mask"], infos["_action_mask"]
            if self._masks is None:
                self._masks = np.zeros_like(masks)
            self._masks[told] = masks[told]
        return infos

    def _answers(self) -> list[Any]:
        """Of all groups; every one is fetched before the first error is raised."""
        answers, errors = [], []
        for group in self._groups:
            try:
                answers.append(group.answer())
            except Exception as error:
                errors.append(error)
        if errors:
            raise errors[0]
        return answers

    def _observations(self) -> Observation:
        shared = self._buffers.observations
        return {name: part.copy() if self._copy else part for name, part in shared.items()}

    def _checked(self, actions: Any) -> NDArray[Any]:
        """The actions, in the form that the buffers have. Raises as `step`."""
        if not self._begun.all():
            raise RuntimeError(f"world {int(np.argmin(self._begun))}: no episode yet: call reset() first")
        over = self._buffers.terminated | self._buffers.truncated
        if self._autoreset is AutoresetMode.DISABLED and over.any():
            told = f"call reset(options={{'{RESET_MASK}': …}})"
            raise RuntimeError(f"world {int(np.argmax(over))}: the episode is over: {told}")
        ignored = over if self._autoreset is AutoresetMode.NEXT_STEP else None
        return checked_actions(actions, self._buffers.actions, self.single_action_space, ignored)


class _Here:
    """`Worlds` of this process, asked in the same way as those of another."""

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds

    def request(self, name: str, *arguments: Any) -> None:
        self._asked = name, arguments

    def answer(self) -> Any:
        name, arguments = self._asked
        return getattr(self._worlds, name)(*arguments)

    def close(self) -> None:
        self._worlds.close()
