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
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, UNPAIRED, Hypothesis, Odometry, Scan
from tests.rollouts import explore


class WrittenOut:
    """EKF-SLAM as the textbook has it: predict, associate, update, add, maintain."""

    def __init__(self, spec: SlamSpec) -> None:
        self.spec, self.map, self.graph = spec, StochasticMap(spec.map), CovisibilityGraph()
        self.learned_at: deque[int] = deque(maxlen=spec.recent)

    def step(self, odometry: Odometry, scan: Scan, associate: Any) -> tuple[Any, ...]:
        m, graph = self.map, self.graph if self.spec.locality else None
        since = self.learned_at[0] if self.learned_at else m.step
        prediction = predict(m, self.spec.reach, odometry=odometry, graph=graph, since=since)
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
        self.learned_at.append(m.step)
        removed = self._forget()
        m.end_of_step()
        return prediction, ids, created, removed

    def _forget(self) -> Any:
        m, age = self.map, self.map.spec.unconfirmed_age
        unconfirmed = np.flatnonzero(m.provisional & (m.first_seen < m.step - (m.step if age is None else age)))
        removed = m.ids[unconfirmed]
        self.graph.keep(m.remove(unconfirmed))
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
