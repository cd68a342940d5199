"""Maps side by side: the right one wins, what was decided is decided anew, and the books are those of probability."""

import copy
import functools

import numpy as np
import pytest
from scipy.special import logsumexp

from slam_gym.association import deferred, jcbb, marginal
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.simulation.judged import JudgedSlam
from slam_gym.slam.deferred import Branches, followed
from slam_gym.slam.slam import Slam, SlamSpec, send
from slam_gym.types import UNPAIRED, Hypothesis, Odometry, Scan, Truth
from tests.oracles import densities
from tests.oracles.densities import MODEL, RATES
from tests.simulation.episodes import circle

FEATURES = np.array([[4.0, 0.0], [4.0, 0.8], [-2.0, 3.0], [1.0, -4.0]])
NUDGED = Odometry(np.zeros(3), np.diag([0.09, 0.09, 1e-6]))  # by how much, the wheels do not say
STILL = Odometry(np.zeros(3), np.diag([1e-4, 1e-4, 1e-6]))
AT = np.array([0.0, 0.5])  # where it is pushed to
RIGHT = [[1], [3], [0, 1, 2, 3]]  # what the scans after that show


def scan_of(features) -> Scan:
    return Scan.from_points(FEATURES[features] - AT, sigma=0.03)


def known() -> Slam:
    """A robot at the origin that knows the four features."""
    slam = Slam(SlamSpec(MapSpec(unconfirmed_age=None), reach=8.0))
    for _ in range(3):
        slam.step(STILL, Scan.from_points(FEATURES, sigma=0.03), marginal)
    return slam


def first_choice(scan, prediction):
    """Decides at once for the most probable place."""
    return deferred(scan, prediction).alternatives[0]


def test_the_right_map_wins_where_who_decides_at_once_stays_wrong() -> None:
    """The one feature in view is more probably the other one; the next scan tells."""
    greedy, branches, told = known(), Branches(known()), known()
    for number, features in enumerate(RIGHT):
        motion, scan = NUDGED if number == 0 else STILL, scan_of(features)
        greedy.step(motion, scan, first_choice)
        branches.step(motion, scan, deferred)
        if number == 0:
            wrong, right = branches.kept
            assert wrong.log_weight > right.log_weight and wrong.step.hypothesis.features.tolist() == [0]
            assert right.step.hypothesis.features.tolist() == [1]
        asking = told.asking_step(motion, scan)
        next(asking)
        send(asking, Hypothesis(np.array(features), 0.0, 2 * len(features)))
    assert np.hypot(*(greedy.map.pose[:2] - AT)) > 0.6 and greedy.map.n > 4
    assert len(branches.kept) == 1 and np.hypot(*(branches.slam.map.pose[:2] - AT)) < 0.1
    np.testing.assert_array_equal(branches.slam.map.mean, told.map.mean)  # as if it had never been otherwise
    np.testing.assert_array_equal(branches.slam.map.seen, told.map.seen)
    assert branches.slam.covisibility.edges().counts.tolist() == told.covisibility.edges().counts.tolist()


def test_weights_are_those_of_every_sequence_of_hypotheses() -> None:
    """Over two scans with every hypothesis an alternative; sequences that come to one pose are one map."""
    every = functools.partial(deferred, cost=1.0, factor=1e9, apart=1e-9, **MODEL, width=3000, margin=1e9)
    branches = Branches(known(), maps=30)
    scans, poses, weights = [scan_of([1]), Scan.from_points([[3.9, 0.35]], sigma=0.03)], [], []
    for scan in scans:
        branches.step(NUDGED, scan, every)
    for first in hypotheses(known(), scans[0]):
        for second in hypotheses(first[0], scans[1]):
            poses.append(second[0].map.pose)
            weights.append(first[1] + second[1])
    share = np.exp(np.array(weights) - logsumexp(weights))
    assert len(branches.kept) > 3
    for branch in branches.kept:
        at_it = [np.hypot(*(pose - branch.slam.map.pose)[:2]) < 0.1 for pose in poses]
        assert np.exp(branch.log_weight) == pytest.approx(share[at_it].sum(), abs=2e-3)


def hypotheses(slam: Slam, scan: Scan) -> list[tuple[Slam, float]]:
    """What every hypothesis makes of a map, and its log density."""
    out = []
    for rows in densities.every_hypothesis(scan, next(slam_copy(slam).asking_step(NUDGED, scan))):
        after = slam_copy(slam)
        asking = after.asking_step(NUDGED, scan)
        prediction = next(asking)
        log_density = densities.log_density(scan, prediction, rows, RATES)
        features = np.array([prediction.features[j] if j != UNPAIRED else UNPAIRED for j in rows])
        send(asking, Hypothesis(features, 0.0, 0, new=features == UNPAIRED))
        out.append((after, log_density))
    return out


def slam_copy(slam: Slam) -> Slam:
    return copy.deepcopy(slam)


def first_two(odometry, scan, truth):
    """A step of a robot that slips, and of its scan what comes first."""
    Q = odometry.covariance + np.diag([0.2, 0.2, 0.03]) ** 2
    few = [getattr(scan, name)[:2] for name in ("points", "covariances", "sizes", "size_variances", "kinds")]
    return Odometry(odometry.motion, Q), Scan(*few), Truth(truth.pose, truth.sources[:2])


LOG = [first_two(*step) for step in circle(40, spurious=0.2)]


def test_no_more_than_so_many_are_kept_and_their_weights_are_probabilities() -> None:
    most = [0, 0]
    for k, maps in enumerate((2, 8)):
        branches = Branches(Slam(), maps)
        for odometry, scan, _ in LOG:
            step = branches.step(odometry, scan, functools.partial(deferred, factor=1e3, apart=0.5))
            weights = np.exp([branch.log_weight for branch in branches.kept])
            assert 1 <= len(weights) <= maps and weights.sum() == pytest.approx(1.0)
            assert (np.diff(weights) <= 0.0).all() and weights[-1] >= 1e-3 * weights[0]
            assert step is branches.kept[0].step and branches.slam is branches.kept[0].slam
            assert len({id(branch.slam.map) for branch in branches.kept}) == len(weights)
            most[k] = max(most[k], len(weights))
    assert most[0] == 2 < most[1]


@pytest.mark.parametrize("options", [{"maps": 1}, {"apart": 1e9}])
def test_with_one_map_or_one_place_it_is_marginal_to_the_last_bit(options) -> None:
    apart = {"apart": options["apart"]} if "apart" in options else {}
    branches, slam = Branches(Slam(), maps=options.get("maps", 8)), Slam()
    for odometry, scan, _ in LOG[:15]:
        ours = branches.step(odometry, scan, functools.partial(deferred, **apart))
        theirs = slam.step(odometry, scan, "marginal")
        np.testing.assert_array_equal(ours.ids, theirs.ids)
    np.testing.assert_array_equal(branches.slam.map.mean, slam.map.mean)
    np.testing.assert_array_equal(branches.slam.map.covariance, slam.map.covariance)


def test_twins_go_the_same_way_and_their_judgement_is_that_of_the_map_that_won() -> None:
    open_minded = functools.partial(deferred, factor=1e3, apart=0.5)
    one, other = JudgedSlam(Slam(), open_minded), JudgedSlam(Slam(), open_minded)
    for odometry, scan, truth in LOG:
        one.step(odometry, scan, truth)
        other.step(odometry, scan, truth)
        assert one.slam is one.kept[0].slam and one.tally == other.tally
        assert [branch.log_weight for branch in one.kept] == [branch.log_weight for branch in other.kept]
        assert one.identities.source_of(one.slam.map.ids).shape == (one.slam.map.n,)
    np.testing.assert_array_equal(one.slam.map.mean, other.slam.map.mean)
    assert one.tally.scans == sum(len(scan) > 0 for _, scan, _ in LOG)


def test_who_leaves_nothing_open_decides_for_the_most_probable_map() -> None:
    branches = Branches(known())
    branches.step(NUDGED, scan_of([1]), deferred)
    best = branches.slam
    assert len(branches.kept) == 2
    branches.step(STILL, scan_of([1]), jcbb)
    assert len(branches.kept) == 1 and branches.slam is best and branches.kept[0].log_weight == 0.0


def test_what_goes_with_a_map_branches_with_it() -> None:
    before = [[1], [2]]
    after = followed(before, [1, 1, 0, 1])
    assert after == [[2], [2], [1], [2]] and after[0] is before[1] and after[2] is before[0]
    assert len({id(one) for one in after}) == 4


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ValueError, match="maps: 0"):
        Branches(Slam(), maps=0)
    branches = Branches(known())

    def stranger(scan, prediction):
        answer = deferred(scan, prediction)
        bad = Hypothesis(np.array([99]), 0.0, 2, posterior=answer.alternatives[0].posterior)
        return Hypothesis(answer.features, 0.0, 0, alternatives=(bad,))

    with pytest.raises(ValueError, match="expected −1 … 3"):
        branches.step(NUDGED, scan_of([1]), stranger)
    with pytest.raises(ValueError, match="no posterior"):
        unweighed = Hypothesis(np.array([0]), 0.0, 2)
        branches.step(
            NUDGED,
            scan_of([1]),
            lambda scan, prediction: Hypothesis(np.array([UNPAIRED]), 0.0, 0, alternatives=(unweighed,)),
        )
