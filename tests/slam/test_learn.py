"""The compiled step is that of the paper, written out here with the map's own methods, one after the other."""

from collections import deque
from typing import Any

import numpy as np
import pytest

from slam_gym.association import jcbb
from slam_gym.association.compatibility import individual
from slam_gym.association.prediction import predict
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.learn import hold_back, unambiguous
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, UNPAIRED, Hypothesis, Odometry, Scan
from tests.rollouts import explore


class WrittenOut:
    """EKF-SLAM as the textbook has it: predict, associate, update, add, maintain."""

    def __init__(self, spec: SlamSpec) -> None:
        self.spec, self.map, self.graph = spec, StochasticMap(spec.map), CovisibilityGraph()
        self.recent: deque[Any] = deque(maxlen=spec.recent)

    def step(self, odometry: Odometry, scan: Scan, associate: Any) -> tuple[Any, ...]:
        m, graph = self.map, self.graph if self.spec.locality else None
        recent = np.concatenate(self.recent) if self.recent else np.empty(0, np.int64)
        prediction = predict(m, self.spec.reach, odometry=odometry, graph=graph, recent=recent)
        hypothesis: Hypothesis = associate(scan, prediction)
        m.update(scan, hypothesis.features)
        left = np.flatnonzero(hypothesis.features == UNPAIRED)
        starts = individual(scan, prediction, self.spec.new_confidence, measurements=left).starts
        new = left[starts[1:] == starts[:-1]] if hypothesis.new is None else np.flatnonzero(hypothesis.new)
        behind, created = hypothesis.features.copy(), np.zeros(len(scan), np.bool_)
        behind[new], created[new] = m.add(scan, new), True
        ids = np.where(behind == UNPAIRED, NO_ID, m.ids[behind])
        self.graph.add(len(new))
        self.graph.see_together(behind[behind != UNPAIRED])
        self.recent.append(behind[behind != UNPAIRED])
        removed = self._forget()
        m.end_of_step()
        return prediction, ids, created, removed

    def _forget(self) -> Any:
        m, unconfirmed = self.map, self.map.unconfirmed()
        removed, became = m.ids[unconfirmed], np.full(m.n, UNPAIRED)
        kept = m.remove(unconfirmed)
        self.graph.keep(kept)
        became[kept] = np.arange(len(kept))
        for k, features in enumerate(self.recent):
            self.recent[k] = became[features][became[features] != UNPAIRED]
        return removed


def everything_new(scan: Scan, prediction: Any) -> Hypothesis:
    """Pairs as JCBB does, and starts a feature from every other measurement."""
    found = jcbb(scan, prediction)
    return Hypothesis(found.features, found.joint_distance, found.dof, found.effort, new=found.features == UNPAIRED)


@pytest.mark.parametrize("associate", [jcbb, everything_new])
@pytest.mark.parametrize(
    "spec",
    [
        SlamSpec(reach=6.0),
        SlamSpec(reach=6.0, locality=False, new_confidence=0.999, map=MapSpec(right_invariant=False, iterations=1)),
        SlamSpec(reach=6.0, map=MapSpec(confirmations=3, unconfirmed_age=5)),
        SlamSpec(reach=6.0, map=MapSpec(unconfirmed_age=None)),
    ],
)
def test_a_step_is_the_one_that_is_written_out(spec, associate) -> None:
    env, rng = explore("office", action="twist"), np.random.default_rng(0)
    env.reset(seed=4, options={"world": 2})
    ours, theirs = Slam(spec), WrittenOut(spec)
    for _ in range(90):
        episode = env.episode
        step = ours.step(episode.odometry, episode.scan, associate)
        prediction, *told = theirs.step(episode.odometry, episode.scan, associate)
        for name in ("features", "positions", "covariances", "sizes", "kinds", "ages", "near", "sightings"):
            np.testing.assert_array_equal(getattr(step.prediction, name), getattr(prediction, name))
        for given, expected in zip((step.ids, step.created, step.removed), told):
            np.testing.assert_array_equal(given, expected)
        env.step(np.clip(rng.normal([0.6, 0.1], 0.4), -1.0, 1.0).astype(np.float32))
    one, other = ours.map.state, theirs.map.state
    np.testing.assert_allclose(one.mean, other.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(one.covariance, other.covariance, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(one.counted, other.counted)
    np.testing.assert_array_equal(one.sized, other.sized)
    for given, expected in zip(ours.covisibility.edges(), theirs.graph.edges()):
        np.testing.assert_array_equal(given, expected)
    assert one.step == other.step == 90 and one.next_id == other.next_id > 20


def test_a_scan_larger_than_any_before_finds_room() -> None:
    """In the map, in the graph, and among what recent scans have seen."""
    slam, rng = Slam(SlamSpec(reach=50.0)), np.random.default_rng(1)
    points = rng.uniform(-20.0, 20.0, (150, 2))
    still = Odometry(np.zeros(3), 1e-8 * np.eye(3))
    for count in (3, 150, 150):
        step = slam.step(still, Scan.from_points(points[:count], sigma=0.01))
        assert (step.ids != NO_ID).all()
    assert slam.map.n == 150 and len(slam.covisibility.neighbours(7)) == 149
    np.testing.assert_allclose(slam.map.positions, points, atol=0.05)


GATE = 9.21  # χ² of two degrees of freedom at .99


def rows_of(rng: np.random.Generator, n: int = 14) -> tuple[Any, ...]:
    """A map of n features that were measured from poses less and less certain, and all it predicts."""
    m, half = StochasticMap(MapSpec()), n // 2
    for count in (half, n - half):
        points = rng.uniform(-6.0, 6.0, (count, 2))
        points[1] = points[0] + [0.8, 0.1]  # as a door has two jambs
        m.add(Scan.from_points(points, sigma=0.03), np.arange(count))
        m.predict(Odometry(np.array([1.0, 0.0, 0.1]), np.diag([0.2, 0.2, 0.02]) ** 2 * rng.uniform(0.0, 3.0)))
    prediction, near = predict(m, 30.0), rng.random(n) < 0.4
    return m, np.array(prediction.features), near, np.array(prediction.positions), np.array(prediction.covariances)


def test_what_others_may_be_taken_for_is_what_the_definition_says() -> None:
    worth, most, left = 10.0, 0.5, []
    for seed in range(40):
        m, features, near, at, _ = rows_of(np.random.default_rng(seed))
        near &= seed % 4 > 0  # now and then none
        amid = None
        if near.any():
            centre = at[near].mean(axis=0)
            amid = features[near][np.hypot(*(at[near] - centre).T).argmin()]
        expected = []
        for row, feature in enumerate(features):
            others = 0.0
            if amid is not None:
                P = m.covariance_of(np.array([amid, feature]))
                others = worth * np.sqrt(max(np.linalg.det(P[:2, :2] + P[2:, 2:] - P[:2, 2:] - P[2:, :2]), 0.0))
            if near[row] or others <= most:
                expected.append(row)
        kept = np.empty(len(features), np.int64)
        count = unambiguous(near, at, features, m.arrays, worth, most, kept)
        assert kept[:count].tolist() == expected, f"seed {seed}"
        left.append(len(features) - count)
    assert 0 in left and max(left) > 4


def test_pairings_with_old_features_stand_if_chance_does_not_bring_so_many() -> None:
    stood = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        m, features, near, at, covariances = rows_of(rng)
        paired = np.append(rng.permutation(len(features))[:4], UNPAIRED)
        decisions = np.where(paired == UNPAIRED, UNPAIRED, features[paired])
        noise = np.array([np.diag(rng.uniform(0.01, 0.4, 2)) ** 2 for _ in paired])
        chance = 1.0
        for row, R in zip(paired, noise):
            if row != UNPAIRED and not near[row]:
                W = np.linalg.inv(covariances[row] + R)
                apart = at[:, None] - at[None]
                within = np.einsum("abi,ij,abj->ab", apart, W, apart) < GATE
                chance *= min(1.0, (within.sum() - len(at)) / len(at))
        old = (paired != UNPAIRED) & ~near[paired]
        held = decisions.copy()
        number = hold_back(held, (features, near, at, covariances), m.arrays[2], noise, GATE, 1, 0.05)
        stands = not old.any() or chance <= 0.05
        assert number == (0 if stands else old.sum()), f"seed {seed}"
        np.testing.assert_array_equal(held, np.where(old & (not stands), UNPAIRED, decisions))
        stood.append(stands)
    assert 10 < sum(stood) < 50
