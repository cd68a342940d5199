"""What must hold at every step of every episode, whatever the settings."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np

from slam_gym.bench.soak.cases import Case
from slam_gym.envs.associate import AssociateEnv
from slam_gym.envs.base import BaseEnv
from slam_gym.envs.explore import ExploreEnv
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import Array

MAPS_EVERY = 50  # [steps] between looks at the whole covariance: they take k³
_NEGATIVE = 1e-9  # of the correlations: an eigenvalue this far below zero is rounding
_SUM = 1e-6  # what the rewards of an episode may differ from first minus last error


class Broken(AssertionError):
    """Something that must hold does not."""


def psd(covariance: Array) -> bool:
    """Whether a covariance (d, d) is finite, symmetric and positive semi-definite, as correlations to 1e-9."""
    if not np.isfinite(covariance).all() or np.abs(covariance - covariance.T).max(initial=0.0) > 1e-9 * max(
        float(np.abs(covariance).max(initial=0.0)), 1e-300
    ):
        return False
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if (np.diag(covariance) < 0.0).any():
        return False
    scale = np.where(sigma > 0.0, sigma, 1.0)
    correlations = covariance / np.outer(scale, scale)
    try:
        np.linalg.cholesky(correlations + _NEGATIVE * len(correlations) * np.eye(len(correlations)))
    except np.linalg.LinAlgError:
        return False
    return True


def check_map(slam_map: StochasticMap) -> None:
    """Raise Broken where a map is not finite or its covariance not positive semi-definite."""
    if not np.isfinite(slam_map.mean).all():
        raise Broken("the state of the map is not finite")
    if not psd(slam_map.covariance):
        raise Broken("the covariance of the map is not positive semi-definite")


class Checked:
    """An episode that is played at random and checked at every step."""

    def __init__(self, case: Case) -> None:
        self.env = case.make()
        self._rng = np.random.default_rng((case.number, 1))
        self._actions = np.random.default_rng((case.number, 2))
        self._seed = case.number
        self.steps, self.total, self._began = 0, 0.0, False

    def play(self) -> Iterator[None]:
        """Reset, then one step at a time until the episode is over. Raises Broken, or what the environment raises."""
        observation, info = self.env.reset(seed=self._seed)
        self._began = True
        self._check(observation, 0.0, info)
        first, over = self._error(), False
        yield
        while not over:
            observation, reward, over, truncated, info = self.env.step(self.action(info))
            self.steps, self.total = self.steps + 1, self.total + reward
            self._check(observation, reward, info)
            if truncated:
                raise Broken("an episode was truncated")
            if over or self.steps % MAPS_EVERY == 0:
                for slam_map in maps_of(self.env):
                    check_map(slam_map)
            yield
        if first is not None and abs(self.total - (first - self._last_error())) > _SUM * max(1.0, abs(first)):
            raise Broken(f"rewards sum to {self.total}, errors fell by {first - self._last_error()}")

    @property
    def ticks(self) -> int:
        """Ticks of the episode so far: scans that the map has learned from. 0 before it began."""
        if not self._began:
            return 0
        if isinstance(self.env, ExploreEnv):
            return self.env.episode.ticks
        return self.env.run.scans if isinstance(self.env, AssociateEnv) else 0

    def action(self, info: dict[str, Any]) -> Any:
        """A legal action, or a twist that leans forward; once in a while an illegal one."""
        if "action_mask" not in info:
            return np.clip(self._actions.normal([0.5, 0.0], [0.6, 0.5]), -1.0, 1.0).astype(np.float32)
        mask = info["action_mask"]
        any_action = self._actions.random() < 0.02
        return int(self._actions.choice(len(mask) if any_action else np.flatnonzero(mask)))

    def _error(self) -> float | None:
        """What the rewards of the episode are decreases of; None where they are not."""
        env = self.env
        if isinstance(env, ExploreEnv):
            return env._error(env.episode)
        return env.run.map_error() if isinstance(env, AssociateEnv) and not env._of_truth else None

    def _last_error(self) -> float:
        error = self._error()
        assert error is not None
        return error

    def _check(self, observation: Any, reward: float, info: dict[str, Any]) -> None:
        if not self.env.observation_space.contains(observation):
            raise Broken(f"observation outside its space: {_outside(self.env, observation)}")
        if type(reward) is not float or not math.isfinite(reward):
            raise Broken(f"reward {reward!r}")
        for name in ("map_error", "coverage", "score"):
            if isinstance(value := info.get(name), float) and not math.isfinite(value):
                raise Broken(f"info[{name!r}] is {value}")
        mask = info.get("action_mask")
        if mask is not None and not mask.any():
            raise Broken("no action is legal")


def maps_of(env: BaseEnv) -> tuple[StochasticMap, ...]:
    """The maps that an environment has at hand."""
    if isinstance(env, ExploreEnv):
        return tuple(env.episode.slam.maps)
    return (env.run.slam.map,) if isinstance(env, AssociateEnv) else ()


def check_copies(checked: Checked, info: dict[str, Any], steps: int) -> None:
    """Raise Broken where a pickle, a deepcopy or a snapshot restored elsewhere does not go on like the original."""
    env = checked.env
    restored = type(env)(**env._arguments)
    restored.restore(env.snapshot())
    restored.np_random.bit_generator.state = env.np_random.bit_generator.state
    copies = {"pickle": pickle.loads(pickle.dumps(env)), "deepcopy": copy.deepcopy(env), "snapshot": restored}
    for _ in range(steps):
        if env.over:
            return
        action = checked.action(info)
        outcome = env.step(action)
        info = outcome[-1]
        for how, other in copies.items():
            if not same(outcome, other.step(action)):
                raise Broken(f"{how}: goes on in another way than the original")


def same(a: Any, b: Any) -> bool:
    """Whether two nested values are equal to the bit, NaN being equal to NaN."""
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple):
        return type(a) is type(b) and len(a) == len(b) and all(same(x, y) for x, y in zip(a, b))
    x, y = np.asarray(a), np.asarray(b)
    return x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes()


def _outside(env: BaseEnv, observation: Any) -> str:
    """Which parts of an observation are outside."""
    found = []
    for name, space in env.observation_space.spaces.items():  # type: ignore[attr-defined]
        if name not in observation or not space.contains(observation[name]):
            value = observation.get(name)
            found.append(f"{name} [{np.min(value)}, {np.max(value)}]" if value is not None else f"{name} is missing")
    return ", ".join(found)
