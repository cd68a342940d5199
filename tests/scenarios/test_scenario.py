"""What a scenario may be, and the seeds of its worlds."""

from dataclasses import FrozenInstanceError, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest

from slam_gym.envs.explore import ExploreEnv
from slam_gym.scenarios import SPLITS, get_scenario, world_generator, world_seed
from slam_gym.world.floor_plan import FloorPlan


def assert_frozen(record: Any) -> None:
    """Nothing of a record of records can be changed, and all of it can be hashed."""
    for field in fields(record):
        with pytest.raises(FrozenInstanceError):
            setattr(record, field.name, None)
        if is_dataclass(getattr(record, field.name)):
            assert_frozen(getattr(record, field.name))
    hash(record)


def test_posts_that_would_coincide_are_drawn_again() -> None:
    assert len(get_scenario("density/4").generator(world_generator("test", 260)).features) == 100


def test_train_and_test_seeds_never_overlap() -> None:
    ranges = [range(first, first + count) for first, count in SPLITS.values()]
    assert set(SPLITS) == {"train", "test"} and all(len(r) >= 10_000 for r in ranges)
    assert ranges[0].stop <= ranges[1].start or ranges[1].stop <= ranges[0].start
    ends = {split: (world_seed(split, 0), world_seed(split, count - 1)) for split, (_, count) in SPLITS.items()}
    for split, reach in zip(SPLITS, ranges):
        assert ends[split] == (reach.start, reach.stop - 1)
    for index in (-1, SPLITS["test"][1], 1.5, float("nan")):
        with pytest.raises(ValueError, match=r"of split 'test': expected a whole number 0 … 9999"):
            world_seed("test", index)
    with pytest.raises(ValueError, match=r"split='validation'; known: train, test"):
        world_seed("validation", 0)


def test_whatever_reset_draws_belongs_to_its_split() -> None:
    office, drawn = get_scenario("office-small"), []

    def generator(rng: np.random.Generator) -> FloorPlan:
        drawn.append(rng.bit_generator.seed_seq.entropy[0])  # of the seed of the world and a constant
        return office.generator(rng)

    for split, (first, count) in SPLITS.items():
        env = ExploreEnv(replace(office, generator=generator), split=split, action="twist")
        drawn.clear()
        for seed in range(20):
            env.reset(seed=seed)
        assert len(set(drawn)) == 20 and all(first <= world < first + count for world in drawn)
