"""A robot that is lost: what is not learned, when the search is asked, and how the step goes on from its answer."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import jcbb
from slam_gym.geometry import compose, observe
from slam_gym.mapping.covisibility import CovisibilityGraph
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.visibility import ViewsFrom
from slam_gym.scenarios import LOG_SETTINGS
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import LOCALITIES, SEARCH, locality_of, relocate_by
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import UNPAIRED, Effort, Experience, Odometry, Relocation, Scan
from tests.slam.test_slam import scan_of
from tests.slam.test_tracker import AHEAD, FEATURES, doubts, facing, paired

STILL = Odometry.from_motion([0, 0, 0], [0.01, 0.01, 0.003])


def found(features: list[int], pose: np.ndarray) -> Relocation:
    return Relocation(np.array(features), pose, 1e-4 * np.eye(3), 0.0, 1, 2, False, 0, Effort())


def test_the_search_is_asked_once_too_many_scans_were_doubted_and_only_then() -> None:
    calls = []

    def relocate(scan: Scan, m: StochasticMap, *_: object) -> Relocation:
        calls.append(m.step)
        return found([1, 0], m.pose)

    slam = Slam(SlamSpec(lost_scans=3, min_expected=2), relocate=relocate)
    here = scan_of([[1, 0], [2, 1]])
    for _ in range(5):
        slam.step(STILL, here)
    assert not calls and not slam.lost
    # a different place each time, so that what the last scan started is no help
    places = [np.array([[4, 4], [5, 3]]) + 3.0 * turn for turn in range(3)]
    paired = [slam.step(STILL, scan_of(place)).hypothesis.features.tolist() for place in places]
    assert calls == [7] and slam.relocations == 1 and not slam.lost
    assert paired == [[UNPAIRED, UNPAIRED], [UNPAIRED, UNPAIRED], [1, 0]]


def test_a_doubted_scan_leaves_the_map_as_the_odometry_does() -> None:
    slam, plain = Slam(SlamSpec(min_expected=2), relocate=lambda *_: None), Slam(SlamSpec(min_expected=2))
    for each in (slam, plain):
        for _ in range(3):
            each.step(STILL, scan_of([[1, 0], [2, 1]]))
    slam.step(STILL, scan_of([[4, 4], [5, 3]]))
    plain.map.predict(STILL)
    assert slam.doubted and slam.map.n == 2
    np.testing.assert_array_equal(slam.map.mean, plain.map.mean)
    np.testing.assert_array_equal(slam.map.covariance, plain.map.covariance)


def test_after_relocation_new_features_are_those_that_fit_nothing_at_the_new_pose() -> None:
    here, moved = scan_of([[1, 0], [3, 0]]), Odometry(np.array([0.8, 0.0, 0.0]), 1e-4 * np.eye(3))
    spec = SlamSpec(lost_scans=1, min_expected=2, reach=20.0)
    slam = Slam(spec, relocate=lambda *_: found([0, UNPAIRED], np.zeros(3)))
    slam.step(STILL, here)
    slam.step(STILL, here)
    step = slam.step(moved, here)
    assert not step.created.any() and slam.map.n == 2  # the second measurement fits feature 1, once relocated


@pytest.mark.parametrize("turn", [0.02, 1.5])
def test_wheels_that_slip_are_noticed_by_any_associator_and_the_robot_is_where_it_is(turn: float) -> None:
    """In one of eight steps of 0.5 m the wheels slip by 30 σ, mostly ahead, before the robot turns [rad]."""
    other = Experience(1.0, 1.0, np.zeros(2))  # of a form that `marginal` does not know
    for associator in ("nearest_neighbour", "jcbb", "marginal", lambda *_: replace(jcbb(*_), experience=other)):
        rng, posts = np.random.default_rng(0), np.random.default_rng(1).uniform(-4.0, 14.0, (60, 2))
        slam, pose = Slam(relocate=lambda *_: None), np.zeros(3)
        for step in range(24):
            moved, sigmas = np.array([0.5, 0.0, turn]) * (step > 0), np.array([0.03, 3e-4, 5e-4])
            pose = compose(pose, moved)
            slip = (30.0 if step % 8 == 4 else 1.0) * sigmas * rng.choice([-1.0, 1.0], 3)
            seen = observe(pose, posts)
            seen = seen[(np.hypot(*seen.T) < 6.0) & (seen[:, 0] > 0.0)]
            scan = scan_of(seen + 0.02 * rng.standard_normal(seen.shape))
            slam.step(Odometry.from_motion(moved + slip, sigmas), scan, associator)
        assert np.hypot(*(slam.map.pose - pose)[:2]) < 0.2, associator
        assert slam.tracker.slips >= 2 and not slam.doubted


@pytest.mark.parametrize("factor", [1.0, 25.0])
def test_a_motion_that_is_an_outlier_is_noticed_where_the_view_is_known(factor: float) -> None:
    """The odometry of the last step is wrong by five standard deviations, far more than the gates allow."""
    posts, sigmas = np.random.default_rng(1).uniform(-6.0, 10.0, (50, 2)), np.array([0.1, 0.003, 0.002])
    slam, pose = Slam(SlamSpec(outlier_factor=factor), ViewsFrom(6.28, 6.0), relocate=lambda *_: None), np.zeros(3)
    for step in range(6):
        moved, error = np.array([0.5, 0.0, 0.02]) * (step > 0), np.array([0.5, 0.0, 0.0]) * (step == 5)
        pose = compose(pose, moved)
        seen = observe(pose, posts)
        slam.step(Odometry.from_motion(moved + error, sigmas), scan_of(seen[np.hypot(*seen.T) < 6.0]))
    assert slam.tracker.slips == (factor > 1.0) and slam.doubted == (factor == 1.0)
    assert (np.hypot(*(slam.map.pose - pose)[:2]) < 0.1) == (factor > 1.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_of_short_sight_is_not_lost_because_most_of_what_it_paired_is_out_of_view(seed: int) -> None:
    """It sees 2.5 m and moves by 1 m from scan to scan."""
    rng, slam, doubts = np.random.default_rng(seed), Slam(LOG_SETTINGS, relocate=relocate_by(SEARCH)), 0
    landmarks = np.indices((66, 7)).reshape(2, -1).T - 3.0 + rng.uniform(-0.4, 0.4, (462, 2))
    for metre in range(60):
        seen = landmarks - [metre, 0.0]
        seen = seen[(np.hypot(*seen.T) < 2.5) & (rng.random(len(seen)) < 0.8)]
        sigmas = np.array([0.05, 0.01, 0.035])
        odometry = Odometry.from_motion([1.0, 0.0, 0.0] + sigmas * rng.standard_normal(3), sigmas)
        slam.step(odometry, scan_of(seen + 0.05 * rng.standard_normal(seen.shape), 0.05), "marginal")
        doubts += slam.doubted
    assert doubts <= 1 and len(slam.map) > 200


def test_after_relocation_the_count_of_scans_that_chance_may_explain_starts_again() -> None:
    pairings = [0, 1, *[UNPAIRED] * (FEATURES - 2)]
    spec = SlamSpec(lost_scans=1, min_expected=2)
    slam = Slam(spec, relocate=lambda *_: found(pairings, np.zeros(3)))
    for _ in range(3):
        slam.step(STILL, scan_of(AHEAD))
    slam.tracker.forget()
    assert not any(doubts(slam.tracker, facing(AHEAD), paired(2)) for _ in range(7))
    slam.step(STILL, scan_of(np.add(AHEAD, [8.0, 5.0])))
    assert slam.relocations == 1 and not doubts(slam.tracker, facing(AHEAD), paired(2))  # not the eighth in a row


def test_a_robot_that_is_elsewhere_in_a_loaded_map_is_found(tmp_path) -> None:
    rng, arc = np.random.default_rng(0), np.array([0.5, 0.0, 0.05])  # in a circle of 10 m
    features, motion = rng.uniform(-20.0, 20.0, (60, 2)), Odometry.from_motion(arc, [0.05, 0.02, 0.01])

    def drive(slam: Slam, pose: np.ndarray, steps: int) -> np.ndarray:
        for _ in range(steps):
            pose = compose(pose, arc)
            seen = observe(pose, features)
            seen = seen[np.hypot(*seen.T) < 10.0]
            slam.step(motion, scan_of(seen + rng.normal(0.0, 0.05, seen.shape), 0.05))
        return pose

    slam, again = (Slam(LOG_SETTINGS, relocate=relocate_by(SEARCH), atlas=AtlasSpec()) for _ in range(2))
    drive(slam, np.zeros(3), 120)
    slam.map.save(tmp_path / "map.npz")
    again.map = StochasticMap.load(tmp_path / "map.npz")
    pose = drive(again, drive(Slam(), np.zeros(3), 40), 25)
    assert again.relocations >= 1 and len(again.maps) == 1 and np.hypot(*(again.map.pose - pose)[:2]) < 0.5


@pytest.mark.parametrize(
    ("features", "pose", "message"),
    [
        ([0, 7], np.zeros(3), r"hypothesis.features\[1\]: 7, expected −1 … 1"),
        ([1, 1], np.zeros(3), "feature 1 is paired twice"),
        ([0], np.zeros(3), r"expected \(2,\) signed integers"),
        ([0, 1], np.full(3, np.nan), "pose: expected 3 finite numbers"),
    ],
)
def test_an_answer_that_cannot_be_is_refused_and_the_robot_is_not_moved(features, pose, message: str) -> None:
    slam = Slam(SlamSpec(lost_scans=1, min_expected=2), relocate=lambda *_: found(features, pose))
    still = Odometry(np.zeros(3), np.zeros((3, 3)))
    for _ in range(3):
        slam.step(still, scan_of([[1, 0], [2, 1]]))
    mean, covariance = slam.map.mean, slam.map.covariance
    with pytest.raises(ValueError, match=message):
        slam.step(still, scan_of([[4, 4], [5, 3]]))
    np.testing.assert_array_equal(slam.map.mean, mean)
    np.testing.assert_array_equal(slam.map.covariance, covariance)
    assert slam.relocations == 0


@pytest.mark.parametrize("kind", [*LOCALITIES, None])
def test_localities_are_named(kind) -> None:
    """A row of features 1 m apart, seen three at a time by a sensor that reaches 2 m."""
    graph, positions = CovisibilityGraph(), np.column_stack([np.arange(12.0), np.zeros(12)])
    graph.add(12)
    for first in range(0, 10):
        graph.see_together(np.arange(first, first + 3))
    locality = locality_of(graph, positions, 2.0, kind)
    reach = {"covisibility": 2, "two-hop covisibility": 4, "distance": 4, None: None}[kind]
    if reach is None:
        assert locality is None
    else:
        for j in range(12):
            assert locality.of(j).tolist() == [i for i in range(12) if abs(i - j) <= reach]


def test_only_answers_that_explain_the_scan_and_cannot_be_chance_are_believed() -> None:
    points = np.random.default_rng(0).uniform(-6, 6, (12, 2))
    slam, scan = Slam(), scan_of(points)
    for _ in range(2):
        slam.step(STILL, scan)
    every = np.arange(12)
    believed = {
        "all": found(every.tolist(), np.zeros(3)),
        "ambiguous": replace(found(every.tolist(), np.zeros(3)), ambiguous=True),
        "chance": found(np.where(every < 2, every, UNPAIRED).tolist(), np.zeros(3)),
        "too little of the scan": found(np.where(every < 5, every, UNPAIRED).tolist(), np.zeros(3)),
    }
    asked = []
    for name, answer in believed.items():

        def answered(*problem: object, answer: Relocation = answer) -> Relocation:
            asked.append(problem)
            return answer

        search = relocate_by(answered)
        assert (search(scan, slam.map, slam.covisibility, slam.reach, None) is answer) is (name == "all"), name
        shown, landmarks, locality = asked[-1]
        assert not shown.points.flags.writeable and len(landmarks) == len(locality) == slam.map.n == 12


def test_of_two_rooms_that_are_alike_neither_is_believed_though_one_fits_better() -> None:
    rng, graph = np.random.default_rng(0), CovisibilityGraph()
    relocate = pickle.loads(pickle.dumps(relocate_by("gcbb")))
    room, answers = rng.uniform(0.0, 12.0, (25, 2)), {}
    graph.add(25)
    graph.see_together(np.arange(25))
    for rooms in (1, 2):
        places = np.vstack([room + np.array([40.0 * k, 0.0]) for k in range(rooms)])
        m = StochasticMap()
        m.add(Scan.from_points(rng.normal(places, 0.03), sigma=0.03), np.arange(len(places)))
        scans = [rng.permutation(25)[:9] for _ in range(20)]
        shown = [Scan.from_points(rng.normal(observe([6.0, 6.0, 1.0], room[rows]), 0.03), sigma=0.03) for rows in scans]
        answers[rooms] = [relocate(scan, m, graph, 12.0, None) for scan in shown]
        graph.add(25)
        graph.see_together(np.arange(25, 50))
    assert all(answer is None for answer in answers[2])
    poses = np.array([answer.pose for answer in answers[1] if answer is not None])
    assert len(poses) == 20 and np.abs(poses - [6.0, 6.0, 1.0]).max() < 0.2


@pytest.mark.parametrize(
    "wrong",
    [{"pose": np.array([1e200, 0.0, 0.0])}, {"covariance": -np.eye(3)}, {"covariance": None}, {"min_pairings": "3"}],
)
def test_an_answer_that_cannot_be_is_refused_before_the_robot_is_moved(wrong) -> None:
    scan, answer = scan_of([[1, 0], [2, 1]]), replace(found([0, 1], np.zeros(3)), **wrong)
    slam = Slam(relocate=lambda *_: answer)
    slam.step(STILL, scan)
    prediction, slam.tracker.doubted = slam.predict(STILL, scan), slam.tracker.scans
    before = slam.map.mean
    with pytest.raises(ValueError, match=r"pose|covariance|min_pairings"):
        slam.relocate(scan, prediction)
    np.testing.assert_array_equal(slam.map.mean, before)


def test_a_search_or_a_locality_that_nobody_knows_is_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown relocator 'oracle'; known: .*gcbb"):
        relocate_by("oracle")
    with pytest.raises(ValueError, match="locality: 'rooms' is none of covisibility, "):
        relocate_by("gcbb", locality="rooms")
