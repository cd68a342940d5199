"""Short recorded rollouts of every environment, scenario and associator: the same seed still gives the same episode.

`tests/data/rollouts.npz` holds, for every step of every rollout, the rewards, the scalars of `info`, and projections of
observations and other arrays. They are compared within 1e-6, which leaves room for a processor that rounds otherwise.
With `SLAM_GYM_EXACT=1` a hash of every bit is compared as well; that holds only on the machine that recorded.

A change that is meant to alter episodes records anew, all rollouts or the ones named, and says so in its message:

    python -m tests.test_rollouts --record [NAME ...]
"""

import argparse
import hashlib
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest

import slam_gym

RECORDED = Path(__file__).parent / "data" / "rollouts.npz"
TOLERANCE = 1e-6
EXACT = os.environ.get("SLAM_GYM_EXACT") == "1"
PROJECTIONS = 3  # numbers kept of an array that has more

Outcome = tuple[Mapping[str, Any], Any, Any, Any, Mapping[str, Any]]


class Rollout(NamedTuple):
    """What is rolled out: an environment, its arguments, at most so many random steps, a seed, how many worlds."""

    env: str
    steps: int
    arguments: dict[str, Any]
    seed: int = 1
    worlds: int = 1

    def outcomes(self) -> Iterator[Outcome]:
        """What reset and each step hand out, by the legal actions of a fixed seed."""
        rng = np.random.default_rng(0)
        if self.worlds > 1:
            env: Any = gym.make_vec(f"slam_gym/{self.env}-v0", num_envs=self.worlds, **self.arguments)
        else:
            env = gym.make(f"slam_gym/{self.env}-v0", disable_env_checker=True, **self.arguments)
        observation, info = env.reset(seed=self.seed)
        yield observation, 0.0, False, False, info
        for _ in range(self.steps):
            outcome = env.step(self.action(info, rng))
            yield outcome
            info = outcome[-1]
            if self.worlds == 1 and outcome[2]:
                break
        env.close()

    def action(self, info: Mapping[str, Any], rng: np.random.Generator) -> Any:
        """A legal action, in walks of the tree most often the first; a twist leans forward, to get somewhere."""
        if "action_mask" not in info:
            shape = (2,) if self.worlds == 1 else (self.worlds, 2)
            return np.clip(rng.normal([0.5, 0.0], [0.6, 0.5], shape), -1.0, 1.0).astype(np.float32)
        masks = np.atleast_2d(info["action_mask"])
        chosen = [int(rng.choice(np.flatnonzero(mask))) for mask in masks]
        if self.env != "Explore":
            chosen = [int(np.argmax(mask)) if rng.random() < 0.7 else one for one, mask in zip(chosen, masks)]
        return chosen[0] if self.worlds == 1 else np.array(chosen)


def _twist(scenario: str, steps: int = 30, **arguments: Any) -> Rollout:
    return Rollout("Explore", steps, {"scenario": scenario, "action": "twist", **arguments})


def _goals(scenario: str, steps: int = 2, **arguments: Any) -> Rollout:
    return Rollout("Explore", steps, {"scenario": scenario, "action": "goal", **arguments})


def _kidnapped(budget: int, seed: int, **arguments: Any) -> Rollout:
    """Carried away after three quarters of so many ticks."""
    overrides = {"budget": budget, "kidnapping.at": 0.75, "kidnapping.distance": 1.0}
    return _twist("kidnapped", budget, overrides=overrides, **arguments)._replace(seed=seed)


def _associate(scenario: str, **arguments: Any) -> Rollout:
    return Rollout("Associate", 40, {"scenario": scenario, **arguments})


def _relocate(scenario: str, budget: int, **arguments: Any) -> Rollout:
    return Rollout("Relocate", 40, {"scenario": scenario, "overrides": {"budget": budget}, **arguments})


_TWIST = ("office", "aliased", "crowd", "drift-1", "drift-3", "crowd-drift", "sparse", "loop", "building")
_GOALS = ("hall", "drift-2", "aliased-drift", "hall-drift", "patrol", "short-sighted")
_ASSOCIATORS = sorted(set(slam_gym.ASSOCIATORS) - {"ppo"})
_RELOCATORS = ("gcbb", "indexed", "max_clique", "random_sampling")

ROLLOUTS: dict[str, Rollout] = {
    **{f"twist/{name}": _twist(name) for name in _TWIST},
    **{f"goals/{name}": _goals(name) for name in _GOALS},
    **{f"associator/{name}": _goals("drift-3", steps=1, associator=name) for name in _ASSOCIATORS},
    **{f"kidnapped/{name}": _kidnapped(100, 0, relocation=name) for name in _RELOCATORS},
    "kidnapped/second-map": _kidnapped(60, 2),
    "to-its-end/office-small": _goals("office-small", steps=20, reward="d_opt", overrides={"budget": 60}),
    "reward/entropy": _twist("office-small", reward="entropy", atlas=False, locality=None),
    "reward/a_opt": _twist("aliased-drift", reward="a_opt", relocation=None),
    "associate/office": _associate("office"),
    "associate/drift-2": _associate("drift-2", reward="map_error"),
    "associate/individual": _associate("aliased-drift", compatibility="individual", order="fewest_candidates"),
    "associate/corridor": _associate("corridor"),
    "associate/closure/3": _associate("closure/3", driver="random"),
    "relocate/office-small": _relocate("office-small", 100),
    "relocate/aliased": _relocate("aliased", 120, locality="distance", outside=0.0),
    "vector/twist": _twist("office-small", 25, workers=2, overrides={"budget": 10})._replace(worlds=3),
}


def plain(value: Any, name: str) -> Iterator[tuple[str, float]]:
    """A nested value as named numbers; an array of more than PROJECTIONS numbers by so many fixed projections."""
    if isinstance(value, Mapping):
        for key in value:
            yield from plain(value[key], f"{name}.{key}")
        return
    array = np.asarray(value)
    if array.dtype == object:
        for i, part in enumerate(array.ravel()):
            yield from plain(part, f"{name}.{i}")
        return
    numbers = array.astype(float).ravel()
    if len(numbers) > PROJECTIONS:
        i = np.arange(1.0, len(numbers) + 1.0)
        weights = np.cos(np.outer(np.sqrt([2.0, 3.0, 5.0]), i)) / math.sqrt(len(numbers))
        numbers = weights @ np.nan_to_num(numbers, nan=-7.0)
    for i, number in enumerate(numbers.tolist()):
        yield f"{name}.{i}", number


def hashed(value: Any, digest: Any) -> None:
    """Enter every bit of a nested value into a digest."""
    if isinstance(value, Mapping):
        for key in sorted(value):
            digest.update(key.encode())
            hashed(value[key], digest)
        return
    array = np.asarray(value)
    if array.dtype == object:
        for part in array.ravel():
            hashed(part, digest)
        return
    digest.update(str((array.dtype, array.shape)).encode() + array.tobytes())


class Record(NamedTuple):
    """A rollout in numbers: their names (k,), one row per outcome (t, k) with NaN for what it lacks, hashes (t,)."""

    names: np.ndarray
    values: np.ndarray
    hashes: np.ndarray


def roll_out(rollout: Rollout) -> Record:
    rows: list[dict[str, float]] = []
    hashes: list[int] = []
    for observation, reward, terminated, truncated, info in rollout.outcomes():
        outcome = {"observation": observation, "reward": reward, "info": info}
        outcome |= {"terminated": terminated, "truncated": truncated}
        digest = hashlib.blake2b(digest_size=8)
        hashed(outcome, digest)
        hashes.append(int.from_bytes(digest.digest(), "big"))
        rows.append({name: number for key in outcome for name, number in plain(outcome[key], key)})
    names = sorted({name for row in rows for name in row})
    values = np.array([[row.get(name, np.nan) for name in names] for row in rows])
    return Record(np.array(names), values, np.array(hashes, np.uint64))


def recorded() -> dict[str, Record]:
    """All records by the name of their rollout."""
    if not RECORDED.exists():
        return {}
    with np.load(RECORDED, allow_pickle=False) as file:
        names = sorted({key.rpartition(":")[0] for key in file.files})
        return {name: Record(*(file[f"{name}:{field}"] for field in Record._fields)) for name in names}


def record(chosen: list[str]) -> None:
    """Record the rollouts that are named or new, or all; what is no rollout any more is dropped."""
    records = recorded()
    kept = {name: of for name, of in records.items() if chosen and name not in chosen}
    records = {name: kept[name] if name in kept else roll_out(rollout) for name, rollout in ROLLOUTS.items()}
    RECORDED.parent.mkdir(exist_ok=True)
    arrays = {f"{name}:{field}": part for name, of in records.items() for field, part in of._asdict().items()}
    np.savez_compressed(RECORDED, **arrays)


@pytest.fixture(scope="module")
def records() -> dict[str, Record]:
    return recorded()


@pytest.mark.parametrize("name", ROLLOUTS)
def test_the_rollout_is_the_recorded_one(name: str, records: dict[str, Record]) -> None:
    now, then = roll_out(ROLLOUTS[name]), records[name]
    changed = set(then.names.tolist()) ^ set(now.names.tolist())
    assert not changed, f"handed out by one of them only: {sorted(changed)}"
    assert len(now.values) == len(then.values)
    off = ~np.isclose(now.values, then.values, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True)
    first = int(np.argmax(off.any(axis=1)))
    places = [
        f"{now.names[i]}: {then.values[first, i]!r} → {now.values[first, i]!r}" for i in np.flatnonzero(off[first])
    ]
    assert not places, f"step {first}: " + "; ".join(places[:12])
    if EXACT:
        np.testing.assert_array_equal(now.hashes, then.hashes)


def test_every_scenario_is_rolled_out() -> None:
    assert set(slam_gym.SCENARIOS) <= {rollout.arguments["scenario"] for rollout in ROLLOUTS.values()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Record the rollouts anew.")
    parser.add_argument("--record", nargs="*", metavar="NAME", required=True, help=", ".join(ROLLOUTS))
    record(parser.parse_args().record)
