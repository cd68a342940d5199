"""How worlds are shared out and addressed."""

import numpy as np
import pytest

from slam_gym.envs.vector.checks import options_of, reset_mask, seeds_of, shared_out, worker_count


@pytest.mark.parametrize(("worlds", "groups"), [(1, 1), (8, 2), (7, 3), (3, 3)])
def test_every_world_is_in_one_group_and_groups_are_of_like_size(worlds, groups) -> None:
    rows = shared_out(worlds, groups)
    assert [world for group in rows for world in group] == list(range(worlds))
    assert max(map(len, rows)) - min(map(len, rows)) <= 1


def test_workers_are_as_many_as_asked_for_and_never_more_than_worlds() -> None:
    assert [worker_count(asked, 3) for asked in (0, 1, 2, 9)] == [0, 1, 2, 3]
    assert worker_count(None, 1) == 0
    assert 0 <= worker_count(None, 64) <= 64
    for wrong in (-1, 1.5, "two"):
        with pytest.raises(ValueError, match="workers"):
            worker_count(wrong, 3)


def test_seeds_and_worlds_are_counted_on_or_given_one_by_one() -> None:
    assert seeds_of(None, 2) == [None, None]
    assert seeds_of(np.int64(4), 3) == [4, 5, 6]
    assert seeds_of([7, None], 2) == [7, None]
    assert options_of({"world": 3}, 2) == [{"world": 3}] * 2
    assert options_of({"world": np.array([3, 4])}, 2) == [{"world": 3}, {"world": 4}]
    with pytest.raises(ValueError, match="seed: 1 values for 2 worlds"):
        seeds_of([7], 2)
    with pytest.raises(ValueError, match=r"options\['world'\]: 3 values for 2 worlds"):
        options_of({"world": [1, 2, 3]}, 2)


def test_a_mask_has_a_flag_for_each_world_and_one_that_is_true() -> None:
    assert reset_mask(None, 2).tolist() == [True, True]
    assert reset_mask(np.array([False, True]), 2).tolist() == [False, True]
    for wrong in (np.zeros(2, bool), np.ones(3, bool), np.ones(2, int)):
        with pytest.raises(ValueError, match="reset_mask"):
            reset_mask(wrong, 2)
