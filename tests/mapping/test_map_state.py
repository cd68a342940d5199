"""A map taken apart and put together again is the same map, and goes on as it would have."""

from dataclasses import fields, replace

import numpy as np
import pytest

from slam_gym.mapping.map_state import Columns, map_of_state, state_of, successor
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.types import UNKNOWN_KIND, Odometry
from tests.mapping.small_maps import KEEP, mapped, predicted
from tests.oracles.map import Q, make_scan

COLUMNS = [field.name for field in fields(Columns)]


def used_map() -> StochasticMap:
    """A map that has lost features, so that ids are no indices, and knows some sizes and kinds."""
    m, _, _ = mapped()
    known = make_scan(np.ones((2, 2)), np.tile(np.eye(2), (2, 1, 1)), np.array([0.3, np.nan]), np.array([0.01, np.nan]))
    m.add(replace(known, kinds=np.array([3, UNKNOWN_KIND])), np.arange(2))
    m.remove(np.array([0, 4]))
    m.end_of_step()
    return m


def assert_same(a: StochasticMap, b: StochasticMap) -> None:
    for name in ("mean", "covariance", *COLUMNS, "step"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    assert a.next_id == b.next_id


def test_taken_apart_and_put_together_it_is_the_same_map_and_stays_so() -> None:
    m = used_map()
    again = map_of_state(KEEP, state_of(m))
    assert_same(m, again)
    scan = make_scan(predicted(m).positions[:3] + 0.05, np.tile(0.01 * np.eye(2), (3, 1, 1)))
    for each in (m, again):
        each.predict(Odometry(np.array([0.1, 0.0, 0.2]), Q))
        each.update(scan, np.array([2, 0, -1]))
        each.add(scan, np.array([2]))
        each.remove(np.array([1]))
        each.end_of_step()
    assert_same(m, again)


def test_a_state_is_a_copy() -> None:
    m = used_map()
    before = m.mean
    state = state_of(m)
    state.mean[:], state.columns.ids[:] = 0.0, 0
    np.testing.assert_array_equal(m.mean, before)
    assert m.ids.any()
    again = map_of_state(KEEP, state_of(m))
    again.place([9.0, 9.0, 0.0], np.eye(3))
    np.testing.assert_array_equal(m.mean, before)


def test_a_successor_is_empty_and_its_ids_and_steps_go_on() -> None:
    m = used_map()
    fresh = successor(m)
    assert fresh.n == 0 and fresh.step == m.step and fresh.next_id == m.next_id and fresh.spec == m.spec
    np.testing.assert_array_equal(fresh.pose, np.zeros(3))
    np.testing.assert_array_equal(fresh.pose_covariance, np.zeros((3, 3)))
    fresh.add(make_scan(np.ones((1, 2)), np.eye(2)[None]), np.array([0]))
    assert fresh.ids[0] == m.next_id > m.ids.max()


def columns(**given) -> Columns:
    """Of three features, seen once each in steps 4, 5 and 6."""
    none = np.full(3, np.nan)
    plain = dict(ids=np.arange(3), seen=np.ones(3, np.int64), first_seen=np.arange(4, 7), last_seen=np.arange(4, 7))
    return Columns(**plain | dict(sizes=none, size_variances=none, kinds=np.full(3, UNKNOWN_KIND)) | given)


def test_a_feature_takes_over_what_was_known_of_its_duplicate() -> None:
    sizes, variances = np.array([0.5, np.nan, 0.8]), np.array([0.01, np.nan, 0.03])
    given = columns(sizes=sizes, size_variances=variances, kinds=np.array([2, UNKNOWN_KIND, 1]))
    fused = given.fused(np.array([0]), np.array([2]))
    assert fused.seen.tolist() == [2, 1, 1] and fused.first_seen[0] == 4 and fused.last_seen[0] == 6
    assert fused.kinds[0] == 2  # its own, where it has one
    weight = 1.0 / np.array([0.01, 0.03])
    assert fused.sizes[0] == pytest.approx((weight @ sizes[[0, 2]]) / weight.sum())
    assert fused.size_variances[0] == pytest.approx(1.0 / weight.sum())
    taught = given.fused(np.array([1]), np.array([2]))
    assert (taught.sizes[1], taught.size_variances[1], taught.kinds[1]) == (0.8, 0.03, 1)
    np.testing.assert_array_equal(given.seen, [1, 1, 1])  # the given ones stay as they are


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda state: replace(state, mean=state.mean[:-1]), "mean, covariance: shapes"),
        (lambda state: replace(state, covariance=state.covariance[:, :-1]), "mean, covariance: shapes"),
        (lambda state: replace(state, mean=np.full_like(state.mean, np.nan)), "mean, covariance: not finite"),
        (lambda state: replace(state, covariance=state.covariance * np.inf), "mean, covariance: not finite"),
        (lambda state: replace(state, covariance=-state.covariance), "pose_covariance"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_state_that_cannot_be_is_refused(spoil, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        map_of_state(KEEP, spoil(state_of(used_map())))
