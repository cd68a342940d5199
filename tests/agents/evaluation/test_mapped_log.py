"""EKF-SLAM over a log starts where the reference does, and makes no mistake where it is told the identities."""

import math

import numpy as np
import pytest

from agents.evaluation.log_measures import compare, measure
from agents.evaluation.mapped_log import map_log, start_of
from slam_gym.metrics.trajectory import ate
from slam_gym.recordings.mrclam import mrclam
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios.registry import MRCLAM, VICTORIA_PARK
from slam_gym.types import UNLABELLED
from tests.agents.evaluation import SPEC, posts_log


@pytest.mark.parametrize("seed", range(8))
def test_true_association_makes_no_mistake_and_maps_every_post_once(seed) -> None:
    log = posts_log(60, seed, clutter=0.5)
    numbers = measure(log, map_log(log, "true_association", SPEC))
    assert numbers["precision"] == numbers["recall"] == numbers["f1"] == 1.0
    assert numbers["features"] == numbers["found"] == numbers["true_features"]
    assert numbers["duplicates"] == numbers["clutter_features"] == numbers["clutter_accepted"] == 0
    assert math.isnan(numbers["nodes"]) and numbers["landmark_rmse"] < 0.3


def test_a_map_starts_where_the_reference_does_and_stays_close_to_it() -> None:
    log = posts_log()
    mapped = map_log(log, "jcbb", SPEC)
    numbers = measure(log, mapped)
    assert mapped.in_world
    np.testing.assert_allclose(start_of(log), log.reference_poses[0], atol=1e-12)
    assert numbers["ate"] <= numbers["ate_unaligned"] < 0.5 and numbers["anees"] < 5.0
    times, estimated, reference = compare(log, mapped)
    assert numbers["ate_unaligned"] == pytest.approx(ate(estimated, reference))
    np.testing.assert_array_equal(times, log.times)


def test_a_stretch_of_the_park_with_jcbb(data_dir) -> None:
    log = victoria_park(data_dir / "victoria_park").part(0, 600)
    jcbb, truth = (measure(log, map_log(log, name, VICTORIA_PARK)) for name in ("jcbb", "true_association"))
    assert truth["precision"] == truth["recall"] == 1.0 and truth["features"] == truth["true_features"]
    assert jcbb["precision"] > 0.99 and jcbb["recall"] > 0.97 and jcbb["limits"] == 0
    assert (log.sources == UNLABELLED).any() and jcbb["ate"] < 3.0 and math.isnan(jcbb["ate_unaligned"])


@pytest.mark.parametrize("robot", [1, 4])
def test_a_robot_of_mrclam_is_placed_and_mapped_to_decimetres_where_identities_are_known(data_dir, robot) -> None:
    log = mrclam(data_dir / "mrclam" / "MRCLAM_Dataset6", robot)
    truth = measure(log, map_log(log, "true_association", MRCLAM))
    assert truth["precision"] == truth["recall"] == 1.0 and truth["features"] == truth["landmarks_compared"] == 15
    assert truth["ate"] < truth["ate_unaligned"] < 0.4 and truth["landmark_rmse"] < 0.12 and truth["anees"] < 5.0
