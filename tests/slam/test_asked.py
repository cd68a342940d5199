"""Strangers' associators are asked as the package's own are, but cannot write to what they are handed."""

from dataclasses import fields

import numpy as np
import pytest

from slam_gym.association import ASSOCIATORS, jcbb, nearest_neighbour
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.slam.asked import asked, locked
from slam_gym.slam.slam import Slam
from slam_gym.types import UNPAIRED, Effort, Hypothesis, Odometry, Prediction, Scan
from tests.oracles.association import problem
from tests.slam.strangers import reachable, writable

STILL = Odometry.from_motion([0, 0, 0], [0.01, 0.01, 0.003])
HERE = Scan.from_points([[1, 0], [2, 1], [0, -3]], sigma=0.02)


def refuse_all(scan: Scan, prediction: Prediction) -> Hypothesis:
    return Hypothesis(np.full(len(scan), UNPAIRED), 0.0, 0, Effort())


def arrays_of(value) -> list[str]:
    return [f.name for f in fields(value) if isinstance(getattr(value, f.name), np.ndarray)]


@pytest.mark.parametrize("what", ["scan", "prediction"])
def test_a_stranger_cannot_write_to_any_array(what: str) -> None:
    refused = []

    def vandal(scan: Scan, prediction: Prediction) -> Hypothesis:
        thing = {"scan": scan, "prediction": prediction}[what]
        for name in arrays_of(thing):
            with pytest.raises(ValueError, match="read-only"):
                getattr(thing, name)[...] = 0
            refused.append(name)
        return refuse_all(scan, prediction)

    slam = Slam()
    slam.step(STILL, HERE)
    slam.step(STILL, HERE, vandal)
    expected = {"scan": {"points", "kinds"}, "prediction": {"positions", "near", "ages", "heading_covariances"}}
    assert expected[what] < set(refused)


def test_a_stranger_finds_no_array_of_the_map_that_it_could_write_to() -> None:
    """However it comes by it: what could be written to shares no memory with the map, the scan or the prediction."""
    found: list[object] = []

    def spy(scan: Scan, prediction: Prediction) -> Hypothesis:
        found.extend(reachable(scan, prediction))
        return refuse_all(scan, prediction)

    slam, scan = Slam(), Scan.from_points([[1, 0], [2, 1], [0, -3]], sigma=0.02)
    for _ in range(3):
        slam.step(STILL, scan, "jcbb")
    step = slam.step(STILL, scan, spy)
    theirs = [thing for thing in found if isinstance(thing, np.ndarray)]
    ours = [thing for thing in reachable(slam, scan, step.prediction) if isinstance(thing, np.ndarray)]
    assert len(theirs) > 15 and not any(isinstance(thing, (Slam, StochasticMap)) for thing in found)
    assert any(np.may_share_memory(a, b) for a in theirs for b in ours)  # nothing is copied to be handed on
    assert not any(writable(a) and np.may_share_memory(a, b) for a in theirs for b in ours)


def test_the_package_s_own_get_plain_arrays_under_their_name_and_as_they_are() -> None:
    for name, function in ASSOCIATORS.items():
        assert asked(name) is asked(function) is function


def test_strangers_are_guarded_once_and_lambdas_and_names_of_modules_are_strangers() -> None:
    guarded = asked(refuse_all)
    assert guarded is not refuse_all and asked(guarded) is guarded
    assert asked(f"{__name__}:refuse_all") == guarded
    with pytest.raises(ValueError, match=r"unknown associator 'oracle'; known: .*jcbb"):
        asked("oracle")


@pytest.mark.parametrize("associator", [jcbb, nearest_neighbour])
@pytest.mark.parametrize("locality", [False, True])
def test_a_guarded_associator_gives_the_same_answers(associator, locality: bool) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        scan, prediction = problem(rng, 5, 6, locality=locality)
        plain = asked(associator)(scan, prediction)
        guarded = asked(lambda *given: associator(*given))(scan, prediction)
        np.testing.assert_array_equal(guarded.features, plain.features)
        assert (guarded.joint_distance, guarded.dof, guarded.effort) == (plain.joint_distance, plain.dof, plain.effort)


def test_a_locked_prediction_tells_the_same() -> None:
    slam = Slam()
    for _ in range(2):
        slam.step(STILL, HERE)
    prediction = slam.predict_features(HERE)
    shown, rows = locked(prediction), np.array([2, 0])
    for name in arrays_of(prediction):
        np.testing.assert_array_equal(getattr(shown, name), getattr(prediction, name))
        assert not writable(getattr(shown, name)) and getattr(prediction, name).flags.writeable
    np.testing.assert_array_equal(shown.joint(rows), prediction.joint(rows))
    np.testing.assert_array_equal(shown.local(rows), prediction.local(rows))
    assert shown.confidence == prediction.confidence and shown.visibility() is None
    slam.map.predict(STILL)
    with pytest.raises(RuntimeError, match="changed"):
        shown.joint(rows)
