"""RightAnswers decision by decision are those of the tally that judges whole scans."""

import numpy as np
import pytest

from slam_gym.association.tracking.walk import Walk
from slam_gym.metrics.association import Decision
from slam_gym.simulation.judged import JudgedSlam, RightAnswers, decisions
from slam_gym.slam.slam import Slam
from slam_gym.types import SPURIOUS, UNLABELLED, UNPAIRED, Truth
from tests.recordings import looks

IDENTITIES = np.array([5, 3, SPURIOUS, 5, UNLABELLED, 7])


def answers_on(*sources: int) -> RightAnswers:
    return RightAnswers.of(Truth(np.zeros(3), np.array(sources)), IDENTITIES)


def test_right_is_the_oldest_feature_of_the_source() -> None:
    answers = answers_on(5, 3, 4, SPURIOUS, UNLABELLED)
    assert answers.right.tolist() == [0, 1, UNPAIRED, UNPAIRED, UNPAIRED]
    assert answers.known == 2


@pytest.mark.parametrize(
    ("source", "feature", "verdict"),
    [
        (5, 0, (1, 0)),
        (5, 3, (0, 1)),  # a duplicate
        (5, 1, (0, 1)),
        (5, 2, (0, 1)),  # a feature that there is not
        (4, 1, (0, 1)),
        (SPURIOUS, 0, (0, 1)),
        (SPURIOUS, 2, (0, 1)),
        (UNLABELLED, 0, (0, 0)),
        (5, 4, (0, 0)),
    ],
)
def test_a_pairing_is_right_wrong_or_nobody_knows(source: int, feature: int, verdict: tuple[int, int]) -> None:
    assert answers_on(source).judge(0, feature) == verdict


@pytest.mark.parametrize("seed", range(3))
def test_decisions_and_right_actions_along_walks_agree_with_the_tally(seed: int) -> None:
    """A walk that takes any branch; all that the walk refuses and the map does not know starts a feature."""
    judged, rng = JudgedSlam(Slam()), np.random.default_rng(seed)
    right = wrong = 0
    for odometry, scan, truth in looks(seed, 12, noise=3.0):
        prediction = judged.slam.predict(odometry, scan)
        answers = RightAnswers.of(truth, judged.identities.source_of(judged.slam.map.ids))
        walk = Walk(scan, prediction, compatibility="individual")
        while not walk.done:
            measurement, best = walk.measurement, answers.right_action(walk)
            action = int(rng.choice(np.flatnonzero(walk.mask))) if rng.random() < 0.3 or best < 0 else best
            if truth.sources[measurement] == UNLABELLED:
                assert best == -1
            elif action == best:
                row = walk.K if action == walk.K else walk.rows[action]
                feature = UNPAIRED if action == walk.K else prediction.features[row]
                assert feature == answers.right[measurement]
            walk.take(action)
        told, hypothesis = decisions(walk, answers), walk.hypothesis()
        before = judged.identities.total.in_map
        judged.learn(scan, prediction, hypothesis, truth)
        paired = hypothesis.features != UNPAIRED
        judgement = judged.identities.decisions
        spurious = paired & (judgement == Decision.SPURIOUS)  # which a picture tells apart, and a reward does not
        np.testing.assert_array_equal(told[paired & ~spurious], judgement[paired & ~spurious])
        assert (told[spurious] == Decision.WRONG).all() and (told[~paired] == Decision.DISCARDED).all()
        pairs = [answers.judge(int(i), int(hypothesis.features[i])) for i in np.flatnonzero(paired)]
        right, wrong = right + sum(r for r, _ in pairs), wrong + sum(w for _, w in pairs)
        assert answers.known >= judged.identities.total.in_map - before
    assert (right, wrong) == (judged.tally.tp, judged.tally.fp) and wrong > 3 < right


def test_what_is_not_decided_yet_is_told_apart_from_what_is_refused() -> None:
    (first, *_), (odometry, scan, truth), *_ = looks(0, 3)
    slam = Slam()
    slam.step(first, scan)
    walk = Walk(scan, slam.predict(odometry, scan))
    answers = RightAnswers.of(truth, np.arange(slam.map.n))
    undecided = decisions(walk, answers)
    assert (undecided[walk.candidates.measurements[walk.level :]] == -1).all()
    refused = walk.measurement
    walk.take(walk.K)
    assert decisions(walk, answers)[refused] == Decision.DISCARDED
