"""EKF-SLAM over a log: it starts where the reference does, makes no mistake where it is told the identities, and its
numbers and files agree with counts by hand."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.mapped_log import compare, map_log, measure, start_of, write_mapped_log
from agents.evaluation.recordings import surveyed
from slam_gym.metrics.map_quality import ate, landmark_rmse
from slam_gym.recordings.mrclam import mrclam
from slam_gym.recordings.recording import Recording
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios.registry import MRCLAM, VICTORIA_PARK
from slam_gym.types import SPURIOUS, UNLABELLED
from tests.agents.evaluation import SPEC, posts_log


@pytest.mark.parametrize("seed", range(4))
def test_true_association_makes_no_mistake_and_maps_every_post_once(seed) -> None:
    log = posts_log(60, seed, clutter=0.5)
    numbers = measure(map_log(log, "true_association", SPEC))
    assert numbers["precision"] == numbers["recall"] == numbers["f1"] == 1.0
    assert numbers["features"] == numbers["found"] == numbers["true_features"]
    assert numbers["duplicates"] == numbers["clutter_features"] == numbers["clutter_accepted"] == 0
    assert math.isnan(numbers["nodes"]) and numbers["landmark_rmse"] < 0.3


def test_a_stretch_of_the_park_with_jcbb(data_dir) -> None:
    log = victoria_park(data_dir / "victoria_park").part(0, 600)
    jcbb, truth = (measure(map_log(log, name, VICTORIA_PARK)) for name in ("jcbb", "true_association"))
    assert truth["precision"] == truth["recall"] == 1.0 and truth["features"] == truth["true_features"]
    assert jcbb["precision"] > 0.99 and jcbb["recall"] > 0.97 and jcbb["limits"] == 0
    assert (log.sources == UNLABELLED).any() and jcbb["ate"] < 3.0 and math.isnan(jcbb["ate_unaligned"])


@pytest.mark.parametrize("robot", [1, 4])
def test_a_robot_of_mrclam_is_placed_and_mapped_to_decimetres_where_identities_are_known(data_dir, robot) -> None:
    log = mrclam(data_dir / "mrclam" / "MRCLAM_Dataset6", robot)
    truth = measure(map_log(log, "true_association", MRCLAM))
    assert truth["precision"] == truth["recall"] == 1.0 and truth["features"] == truth["landmarks_compared"] == 15
    assert truth["ate"] < truth["ate_unaligned"] < 0.4 and truth["landmark_rmse"] < 0.12 and truth["anees"] < 5.0


# -- what is measured ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def log() -> Recording:
    return posts_log()


@pytest.fixture(scope="module")
def mapped(log):
    return map_log(log, "jcbb", SPEC)


def test_a_map_starts_where_the_reference_does_and_stays_close_to_it(log, mapped) -> None:
    numbers, (times, estimated, reference) = measure(mapped), compare(log, mapped.poses)
    assert mapped.in_world
    np.testing.assert_allclose(start_of(log), log.reference_poses[0], atol=1e-12)
    assert numbers["ate"] <= numbers["ate_unaligned"] < 0.5 and numbers["anees"] < 5.0
    assert numbers["ate_unaligned"] == pytest.approx(ate(estimated, reference))
    np.testing.assert_array_equal(times, log.times)


def test_numbers_agree_with_counts_by_hand(log) -> None:
    mapped = map_log(log, "nearest_neighbour", SPEC)
    numbers = measure(mapped)
    paired, feature = mapped.measurements["paired"], mapped.measurements["feature_source"]
    real = log.sources >= 0
    right = sum(1 for i in np.flatnonzero(paired & real) if feature[i] == log.sources[i])
    assert numbers["clutter"] == (log.sources == SPURIOUS).sum()
    assert numbers["clutter_accepted"] == (paired & ~real).sum()
    assert numbers["clutter_on_landmarks"] == (paired & ~real & (feature >= 0)).sum()
    assert right == mapped.tally.tp + mapped.tally.fp_duplicate
    landmarks = mapped.features.loc[mapped.features["confirmed"] > 0, "identity"]
    assert numbers["duplicates"] + numbers["found"] == (landmarks >= 0).sum()
    assert numbers["features"] == numbers["duplicates"] + numbers["found"] + numbers["clutter_features"]


def test_where_headings_are_unknown_only_alignment_compares(mapped) -> None:
    log = posts_log(surveyed=False)
    numbers = measure(map_log(log, "jcbb", SPEC))
    assert start_of(log) is None and math.isnan(numbers["ate_unaligned"]) and math.isnan(numbers["anees"])
    assert numbers["ate"] == pytest.approx(measure(mapped)["ate"], rel=1e-6)


def test_batch_least_squares_with_the_same_pairings_stands_beside_the_filter() -> None:
    filtered, batch = [], []
    for seed in range(6):
        truth = measure(map_log(posts_log(60, seed, clutter=0.5), "true_association", SPEC))
        filtered.append([truth["ate"], truth["landmark_rmse"]])
        batch.append([truth["ate_batch"], truth["landmark_rmse_batch"]])
    assert (np.mean(batch, axis=0) < 1.05 * np.mean(filtered, axis=0)).all()
    certain = replace(posts_log(), motion_covariances=np.zeros_like(posts_log().motion_covariances))
    assert math.isnan(measure(map_log(certain, "jcbb", SPEC))["ate_batch"])


def test_a_log_without_a_survey_is_held_against_the_batch_solution_of_its_identities() -> None:
    log = posts_log(60)
    unknown = replace(
        log, reference_times=np.empty(0), reference_poses=np.empty((0, 3)), landmark_ids=np.empty(0, np.int64),
        landmarks=np.empty((0, 2)),
    )  # fmt: skip
    found = surveyed(unknown)
    assert surveyed(log) is log and len(found.landmarks) == len(np.unique(log.sources[log.sources >= 0]))
    true = log.landmarks[np.searchsorted(log.landmark_ids, found.landmark_ids)]
    assert landmark_rmse(found.landmarks, true, aligned=True) < 0.1
    numbers = measure(map_log(found, "true_association", SPEC))
    assert numbers["ate_batch"] < 1e-3 < numbers["ate"] < 0.2 and math.isnan(numbers["anees"])


# -- files -------------------------------------------------------------------------------------------------------------


def test_files_hold_the_run(tmp_path, mapped) -> None:
    write_mapped_log(tmp_path, "jcbb", mapped)
    features, errors = (pd.read_csv(tmp_path / f"drive.jcbb.{kind}.csv") for kind in ("map", "errors"))
    numbers = measure(mapped)
    assert features["confirmed"].sum() == numbers["features"]
    assert math.sqrt((errors["error"] ** 2).mean()) == pytest.approx(numbers["ate"], rel=1e-6)
    known = features[(features["confirmed"] == 1) & (features["identity"] >= 0)].drop_duplicates("identity")
    landmarks = pd.read_csv(tmp_path / "drive.landmarks.csv").to_numpy()[known["identity"]]
    assert np.hypot(*(known[["aligned_x", "aligned_y"]].to_numpy() - landmarks).T).max() < 0.5


def test_evo_reads_the_trajectories_and_finds_the_same_error(tmp_path, mapped) -> None:
    pytest.importorskip("evo")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    write_mapped_log(tmp_path, "jcbb", mapped)
    numbers = measure(mapped)
    reference, estimate = (
        file_interface.read_tum_trajectory_file(str(tmp_path / name))
        for name in ("drive.reference.tum", "drive.jcbb.tum")
    )
    reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=1e-3)
    for aligned, key in ((False, "ate_unaligned"), (True, "ate")):
        if aligned:
            estimate.align(reference, correct_scale=False)
        error = metrics.APE(metrics.PoseRelation.translation_part)
        error.process_data((reference, estimate))
        assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(numbers[key], rel=1e-3)
