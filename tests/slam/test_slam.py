"""One SLAM step: what is paired, what starts a feature, what is forgotten, what is refused."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.consistency import METHODS, LoopSpec, estimate, loop
from slam_gym.association import jcbb
from slam_gym.mapping.stochastic_map import MapSpec, StochasticMap
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, UNPAIRED, Effort, Hypothesis, Odometry, Scan

STILL = Odometry(np.zeros(3), np.diag([1e-4, 1e-4, 1e-5]))


def scan_of(points, sigma: float = 0.02) -> Scan:
    return Scan.from_points(points, sigma=sigma)


def slam_of(**settings) -> Slam:
    return Slam(SlamSpec(**settings))


def test_compatible_but_unpaired_is_discarded_and_starts_nothing() -> None:
    slam = slam_of()
    slam.step(STILL, scan_of([[2, 0]]))
    # two measurements compete for one feature: JCBB pairs the nearer, the other is compatible with it
    step = slam.step(STILL, scan_of([[2.0, 0.0], [2.03, 0.0]]))
    np.testing.assert_array_equal(step.hypothesis.features, [0, UNPAIRED])
    assert step.ids[1] == NO_ID and not step.created.any() and slam.map.n == 1


def test_locality_offers_first_what_is_near_what_was_just_paired() -> None:
    slam = slam_of(recent=1, reach=20.0)
    slam.step(STILL, scan_of([[1, 0], [2, 1]]))
    slam.step(STILL, scan_of([[10, 0], [11, 1]]))
    prediction = slam.predict(STILL, scan_of([]))
    np.testing.assert_array_equal(prediction.features, [0, 1, 2, 3])
    np.testing.assert_array_equal(prediction.near, [False, False, True, True])
    among = prediction.local(np.array([0, 1, 2]))
    np.testing.assert_array_equal(among, [[True, True, False], [True, True, False], [False, False, True]])
    slam.spec = replace(slam.spec, locality=False)
    prediction = slam.predict(STILL, scan_of([]))
    assert not prediction.has_localities and prediction.near.all()


def test_a_loaded_map_is_gone_on_in_and_what_others_have_removed_is_noticed(tmp_path) -> None:
    slam, places = slam_of(), np.random.default_rng(0).uniform(-9.0, 9.0, (300, 2))
    slam.step(STILL, scan_of(places))
    slam.map.save(tmp_path / "map.npz")
    again = slam_of(map=MapSpec(confirmations=np.int32(3), right_invariant=np.True_), recent=np.int64(5))
    again.map = StochasticMap.load(tmp_path / "map.npz")
    step = again.step(STILL, scan_of(places[::7]))
    assert step.prediction.confirmations == 3
    again.map.save(tmp_path / "map.npz")
    assert again.map.n == again.covisibility.n == 300 and np.isin(step.ids, np.arange(300)).all()
    for added in (0, 20, 30):
        other = copy.deepcopy(again)
        other.map.remove(np.arange(20))
        other.map.add(scan_of(places[:added] + 50.0), np.arange(added))
        with pytest.raises(ValueError, match="map: features were removed"):
            other.step(STILL, scan_of(places))


def test_a_robot_at_rest_learns_from_errors_that_stay_as_if_it_had_measured_once() -> None:
    places, rest, told = np.random.default_rng(0).uniform(-9.0, 9.0, (12, 2)), Odometry.from_motion([0, 0, 0], 0.0), {}
    for length in (0.0, 1.0):
        slam = slam_of(error_length=length)
        slam.step(rest, scan_of(places))
        for k in range(20):
            slam.step(rest if k else Odometry.from_motion([1.0, 0.0, 0.0], 0.2), scan_of(places - [1.0, 0.0]))
            told[length, k] = np.linalg.det(slam.map.pose_covariance) ** (1.0 / 3.0)
    assert told[0.0, 0] == told[1.0, 0]  # after a metre the errors are new
    assert told[1.0, 19] > 0.9 * told[1.0, 0] and told[0.0, 19] < 0.6 * told[0.0, 0]


def test_ten_scans_on_a_metre_tell_as_much_as_one_where_errors_stay_that_long() -> None:
    places, variances = np.random.default_rng(0).uniform(-9.0, 9.0, (12, 2)), []
    for steps in (1, 10):
        slam = slam_of(error_length=1.0)
        slam.step(Odometry.from_motion([0, 0, 0], 0.0), scan_of(places))
        for k in range(steps):
            motion = Odometry.from_motion([1.0 / steps, 0.0, 0.0], 0.0 if k else 0.2)
            slam.step(motion, scan_of(places - [(k + 1.0) / steps, 0.0]))
        variances.append(np.linalg.det(slam.map.pose_covariance) ** (1.0 / 3.0))
    assert variances[1] == pytest.approx(variances[0], rel=0.2)
    before, more = slam_of(error_length=1.0), np.vstack([places, [[3.0, 20.0]]])
    for shown in (places, more):  # a new feature is as certain as its measurement
        before.step(Odometry.from_motion([0, 0, 0], 0.0), scan_of(shown))
    np.testing.assert_allclose(before.map.covariances[12], scan_of(more).covariances[12])


@pytest.mark.parametrize("first", [[], [[0.5, 0.0]], [[np.nan, 1.0]]])
def test_features_of_a_loaded_map_are_linked_however_little_the_first_scan_shows(first) -> None:
    slam, places = slam_of(), np.random.default_rng(0).uniform(-4.0, 4.0, (12, 2))
    slam.map.add(scan_of(places), np.arange(12))
    if np.isnan(first).any():
        with pytest.raises(ValueError, match="not finite"):
            slam.step(STILL, scan_of(first))
    else:
        slam.step(STILL, scan_of(first), lambda scan, prediction: Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0))
    step = slam.step(STILL, scan_of(places))
    assert step.hypothesis.pairings == 12 and len(slam.covisibility.edges().counts) == 66


def test_a_hypothesis_that_does_not_fit_is_refused_by_name() -> None:
    slam, twice = slam_of(), Hypothesis(np.array([1, 1]), 0.0, 0, Effort())
    slam.step(STILL, scan_of([[1, 0], [2, 1]]))
    with pytest.raises(ValueError, match=r"associator <lambda>: .*feature 1 is paired twice"):
        slam.step(STILL, scan_of([[1, 0], [2, 1]]), lambda scan, prediction: twice)
    assert slam.map.n == 2 and (slam.map.seen == 1).all()


def test_a_name_in_place_of_a_function_is_refused_and_an_error_says_whose_it_is() -> None:
    with pytest.raises(ValueError, match=r"spec: MapSpec.*, expected a SlamSpec"):
        Slam(MapSpec())  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"SlamSpec\.locality='False': expected True or False"):
        SlamSpec(locality="False")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="relocate: 'gcbb' is not a function; relocate_by"):
        Slam(relocate="gcbb")  # type: ignore[arg-type]
    with pytest.raises(ZeroDivisionError) as raised:
        slam_of().step(STILL, scan_of([[1, 0]]), lambda scan, prediction: 1 // 0)
    assert raised.value.__notes__ == ["raised by associator <lambda>"]


def test_odometry_alone_is_no_scan() -> None:
    slam = slam_of(map=MapSpec(unconfirmed_age=2))
    for tick in range(31):
        step = slam.step(STILL, scan_of([] if tick % 10 else [[9, 0], [2, 1]]))
        assert len(step.ids) == len(step.created) == (0 if tick % 10 else 2) and step.prediction.near.all()
    assert slam.map.step == 4 and slam.map.n == 2 and (slam.map.seen == 4).all()


def test_a_reach_shorter_than_the_sensor_s_is_warned_of() -> None:
    slam = slam_of(reach=6.0)
    with pytest.warns(UserWarning, match="reach"):
        slam.step(STILL, scan_of([[9, 0], [2, 1]]))


def test_a_stranger_can_change_neither_the_scan_nor_the_prediction() -> None:
    scan, slam = scan_of([[1, 0], [2, 1]]), slam_of()
    slam.step(STILL, scan)

    def writing(seen: Scan, prediction) -> Hypothesis:
        for array in (seen.points, seen.covariances, prediction.positions, prediction.covariances, prediction.features):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
        return jcbb(seen, prediction)

    assert slam.step(STILL, scan, writing).hypothesis.pairings == 2


SEEN = [[1.0, 0.0], [2.0, 1.0]]


@pytest.mark.parametrize(
    ("odometry", "scan", "message"),
    [
        (STILL, scan_of([[1.0, 0.0], [np.nan, 1.0]]), "measurement 1: points are not finite"),
        (STILL, Scan.from_points(SEEN, np.diag([1.0, -1.0])), "measurement 0: covariance is not PSD"),
        (Odometry(np.array([np.nan, 0, 0]), np.eye(3)), scan_of(SEEN), "odometry"),
        (Odometry(np.zeros(3), np.diag([1.0, -1.0, 1.0])), scan_of(SEEN), "odometry"),
        (Odometry(np.zeros(3), np.full((3, 3), np.inf)), scan_of(SEEN), "odometry"),
        (scan_of(SEEN), STILL, "odometry: Scan, expected Odometry"),
        ([1, 0, 0], scan_of([[1, 2]]), r"odometry: list, .*Odometry\.from_motion"),
        (Odometry.from_motion([1, 0, 0], 0.1), [[1, 2]], r"scan: list, .*Scan\.from_points"),
    ],
)
def test_bad_input_is_refused_by_name_and_changes_nothing(odometry, scan, message) -> None:
    slam = slam_of()
    slam.step(STILL, scan_of(SEEN))
    mean, covariance = slam.map.mean, slam.map.covariance
    with pytest.raises(ValueError, match=message):
        slam.step(odometry, scan)
    np.testing.assert_array_equal(slam.map.mean, mean)
    np.testing.assert_array_equal(slam.map.covariance, covariance)


@pytest.mark.parametrize("new", [None, np.array([False, True])])
def test_learning_from_a_bad_measurement_changes_nothing(new) -> None:
    slam = Slam(relocate=relocate_by("gcbb"))
    slam.step(STILL, scan_of(SEEN))
    prediction, tracker = slam.predict(STILL, scan_of(SEEN)), copy.deepcopy(vars(slam.tracker))
    mean, covariance, seen = slam.map.mean, slam.map.covariance, slam.map.seen
    decided, bad = Hypothesis(np.array([0, UNPAIRED]), 0.0, 2, new=new), scan_of([SEEN[0], [np.nan, 1.0]])
    with pytest.raises(ValueError, match="measurement 1: points are not finite"):
        slam.learn(bad, prediction, decided)
    np.testing.assert_equal(vars(slam.tracker), tracker)
    np.testing.assert_array_equal(slam.map.mean, mean)
    np.testing.assert_array_equal(slam.map.covariance, covariance)
    np.testing.assert_array_equal(slam.map.seen, seen)


def test_a_prediction_is_of_no_use_once_the_map_has_changed() -> None:
    slam, scan = slam_of(), scan_of(SEEN)
    prediction = slam.predict(STILL, scan)
    with pytest.raises(ValueError, match="odometry"):
        slam.map.predict(Odometry(np.full(3, np.nan), np.eye(3)))
    slam.learn(scan, prediction, Hypothesis(np.full(2, UNPAIRED), 0.0, 0))  # the map has not changed
    *_, stale = (slam.step(STILL, scan).prediction for _ in range(2))
    for use in (lambda: jcbb(scan, stale), lambda: stale.local(np.arange(2)), lambda: stale.joint(np.arange(2))):
        with pytest.raises(RuntimeError, match="map has changed"):
            use()
    with pytest.raises(RuntimeError, match="map has changed"):
        slam.learn(scan, stale, Hypothesis(np.arange(2), 0.0, 4))


# --- estimators on a square corridor driven round ---------------------------------------------------------------------

SHORT = LoopSpec(heading=1.0, side=12, spacing=4.0)


@pytest.mark.parametrize("method", METHODS)
def test_with_little_noise_every_estimator_is_consistent(method: str) -> None:
    quiet, associator = SHORT._replace(heading=0.1, along=0.01), "jcbb"
    runs = [estimate(loop(seed, quiet), method, associator) for seed in range(12)]
    assert all(run["duplicates"] == 0 and run["final [m]"] < 0.3 for run in runs)
    assert 0.5 < np.mean([run["ANEES"] for run in runs]) < 1.6


@pytest.mark.parametrize("method", METHODS)
def test_a_filter_that_is_told_too_little_noise_is_found_out(method: str) -> None:
    log = loop(0, SHORT)
    told = [(Odometry(o.motion, 0.01 * o.covariance), scan, truth) for o, scan, truth in log.steps]
    honest, lied = (estimate(each, method, "jcbb")["ANEES"] for each in (log, replace(log, steps=told)))
    assert lied > 3.0 > honest
