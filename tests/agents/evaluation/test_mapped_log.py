"""EKF-SLAM over a log: it starts where the reference does, makes no mistake where it is told the identities, and its
numbers and files agree with counts by hand."""

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.mapped_log import (
    compare,
    final_ids,
    logs_of,
    map_and_measure,
    map_log,
    measure,
    start_of,
    surveyed,
    write_mapped_log,
)
from agents.options import Recorded
from agents.reports.pages import FURTHER_LOG_COLUMNS, LOG_COLUMNS, log_means, log_tables
from slam_gym.geometry import compose, compose_jacobians
from slam_gym.metrics.map_quality import ate, landmark_rmse
from slam_gym.recordings import open_recordings
from slam_gym.recordings.mrclam import mrclam
from slam_gym.recordings.recording import Recording, interpolate, save
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios import MRCLAM, VICTORIA_PARK
from slam_gym.slam.atlas import AtlasSpec, FusionRecord
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam
from slam_gym.types import NO_ID, SPURIOUS, UNLABELLED
from tests.agents.evaluation import SPEC
from tests.recordings import drive

NOBODY, NOWHERE = np.empty(0), np.empty((0, 3))
UNSURVEYED = dict(landmark_ids=NOBODY, landmarks=NOWHERE[:, 1:], reference_times=NOBODY, reference_poses=NOWHERE)


@functools.cache
def informed(seed: int) -> dict[str, float]:
    """Numbers of a short log, every measurement of which is paired with its post."""
    return measure(map_log(drive(seed), "true_association", SPEC))


def test_true_association_makes_no_mistake_and_maps_every_post_once() -> None:
    for seed in range(4):
        numbers = informed(seed)
        assert numbers["precision"] == numbers["recall"] == numbers["f1"] == 1.0
        assert numbers["features"] == numbers["found"] == numbers["true_features"]
        assert numbers["duplicates"] == numbers["clutter_features"] == numbers["clutter_accepted"] == 0
        assert math.isnan(numbers["nodes"]) and numbers["landmark_rmse"] < 0.3


def test_batch_least_squares_with_the_same_pairings_stands_beside_the_filter() -> None:
    filtered, batch = (
        np.mean([[informed(seed)[name + of] for name in ("ate", "landmark_rmse")] for seed in range(6)], axis=0)
        for of in ("", "_batch")
    )
    assert (batch < 1.05 * filtered).all()
    log = drive(steps=120, **UNSURVEYED)
    at_rest = replace(log, motion_covariances=log.motion_covariances * (np.arange(120) != 40)[:, None, None])
    for each in (log, at_rest, replace(log, times=np.floor(log.times))):
        assert measure(map_log(surveyed(each), "true_association", SPEC))["ate_batch"] < 0.01
    exact = replace(drive(steps=120), covariances=np.zeros_like(log.covariances))
    assert math.isnan(measure(map_log(exact, "jcbb", SPEC))["ate_batch"])


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
    return drive(steps=120)


@pytest.fixture(scope="module")
def mapped(log):
    return map_log(log, "jcbb", SPEC)


def test_a_map_starts_where_the_reference_does_and_stays_close_to_it(log, mapped) -> None:
    numbers, (times, estimated, reference) = measure(mapped), compare(log, mapped.poses)
    assert mapped.in_world
    np.testing.assert_allclose(compose(start_of(log), log.motions[0]), log.reference_poses[0], atol=1e-12)
    assert numbers["ate"] <= numbers["ate_unaligned"] < 0.5 and numbers["anees"] < 5.0
    assert numbers["ate_unaligned"] == pytest.approx(ate(estimated, reference))
    np.testing.assert_array_equal(times, log.times)


def test_numbers_agree_with_counts_by_hand(log) -> None:
    mapped = map_log(log, "nearest_neighbour", SPEC)
    numbers = measure(mapped)
    paired, feature = mapped.measurements["paired"], mapped.measurements["feature_source"]
    real, spurious = log.sources >= 0, log.sources == SPURIOUS
    right = sum(1 for i in np.flatnonzero(paired & real) if feature[i] == log.sources[i])
    assert numbers["clutter"] == spurious.sum()
    assert numbers["clutter_accepted"] == (paired & spurious).sum()
    assert numbers["clutter_on_landmarks"] == (paired & spurious & (feature >= 0)).sum()
    assert right == mapped.tally.tp + mapped.tally.fp_duplicate
    landmarks = mapped.features.loc[mapped.features["confirmed"] > 0, "identity"]
    assert numbers["duplicates"] + numbers["found"] == (landmarks >= 0).sum()
    assert numbers["features"] == numbers["duplicates"] + numbers["found"] + numbers["clutter_features"]


def test_where_headings_are_unknown_only_alignment_compares(mapped) -> None:
    log = drive(steps=120, headings=False)
    numbers = measure(map_log(log, "jcbb", SPEC))
    assert start_of(log) is None and math.isnan(numbers["ate_unaligned"]) and math.isnan(numbers["anees"])
    assert numbers["ate"] == pytest.approx(measure(mapped)["ate"], rel=1e-6)


def test_a_log_without_a_survey_is_held_against_the_batch_solution_of_its_identities() -> None:
    log = drive()
    found = surveyed(drive(**UNSURVEYED))
    assert surveyed(log) is log and len(found.landmarks) == len(np.unique(log.sources[log.sources >= 0]))
    true = log.landmarks[np.searchsorted(log.landmark_ids, found.landmark_ids)]
    assert landmark_rmse(found.landmarks, true, aligned=True) < 0.1
    numbers = measure(map_log(found, "true_association", SPEC))
    assert numbers["ate_batch"] < 1e-3 < numbers["ate"] < 0.2 and math.isnan(numbers["anees"])


def test_poses_are_compared_where_the_reference_has_no_gap_and_as_surely_as_it_is_known(mapped) -> None:
    log, t = mapped.log, np.arange(5.0, 64.0, 0.25)
    t = t[(t < 20.0) | (t > 23.0)]
    gap = replace(log, reference_times=t, reference_poses=interpolate(log.times, log.reference_poses, t))
    compared = compare(gap, mapped.poses).times
    assert not ((compared > 19.8) & (compared < 23.2)).any() and {19.0, 24.0} <= set(compared.tolist())
    off = log.reference_poses + np.array([0.005, 0.0, 0.0])
    sure = replace(mapped, poses=off, pose_covariances=np.zeros((len(log), 3, 3)))
    assert measure(sure)["anees"] == pytest.approx(1 / 3)
    second = np.arange(len(log)) > 100  # a second map, whose frame is not that of the reference
    lost = replace(sure, poses=off + 9.0 * second[:, None], in_base=~second)
    assert measure(lost)["anees"] == pytest.approx(1 / 3)
    alone = replace(log, reference_times=log.reference_times[:2], reference_poses=log.reference_poses[:2])
    assert math.isnan(measure(replace(mapped, log=alone))["ate"])


def test_a_log_of_rare_scans_is_compared_as_one_of_frequent_scans(mapped) -> None:
    log = mapped.log
    slow = replace(log, times=20.0 * log.times, reference_times=20.0 * log.reference_times)
    one, other = compare(log, mapped.poses), compare(slow, mapped.poses)
    np.testing.assert_allclose(other.times, 20.0 * one.times)
    assert (
        measure(replace(mapped, log=slow))["anees"] == pytest.approx(measure(mapped)["anees"]) and len(one.times) > 50
    )


def test_ids_are_followed_through_fusions() -> None:
    slam = Slam(relocate=relocate_by("gcbb"), atlas=AtlasSpec())
    slam.atlas.fusions += [FusionRecord("loop", step, np.array([pair])) for step, pair in enumerate(([1, 4], [0, 1]))]
    assert final_ids(slam, np.array([4, 1, 2, NO_ID])).tolist() == [0, 0, 2, NO_ID]


# -- files -------------------------------------------------------------------------------------------------------------


def test_files_hold_the_run(tmp_path, mapped) -> None:
    thin = mapped.log.every(5)
    write_mapped_log(tmp_path, "jcbb", replace(mapped, log=thin, poses=mapped.poses[::5]))
    assert len(pd.read_csv(tmp_path / "arc.reference.csv")) > 4 * len(thin)  # the reference keeps all its positions
    write_mapped_log(tmp_path, "jcbb", mapped)
    features, errors = (pd.read_csv(tmp_path / f"arc.jcbb.{kind}.csv") for kind in ("map", "errors"))
    numbers = measure(mapped)
    assert features["confirmed"].sum() == numbers["features"]
    assert math.sqrt((errors["error"] ** 2).mean()) == pytest.approx(numbers["ate"], rel=1e-6)
    known = features[(features["confirmed"] == 1) & (features["identity"] >= 0)].drop_duplicates("identity")
    landmarks = pd.read_csv(tmp_path / "arc.landmarks.csv").to_numpy()[known["identity"]]
    assert np.hypot(*(known[["aligned_x", "aligned_y"]].to_numpy() - landmarks).T).max() < 0.5


def test_evo_reads_the_trajectories_and_finds_the_same_error(tmp_path, mapped) -> None:
    pytest.importorskip("evo")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    write_mapped_log(tmp_path, "jcbb", mapped)
    numbers = measure(mapped)
    reference, estimate = (
        file_interface.read_tum_trajectory_file(str(tmp_path / name)) for name in ("arc.reference.tum", "arc.jcbb.tum")
    )
    reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=1e-3)
    for aligned, key in ((False, "ate_unaligned"), (True, "ate")):
        if aligned:
            estimate.align(reference, correct_scale=False)
        error = metrics.APE(metrics.PoseRelation.translation_part)
        error.process_data((reference, estimate))
        assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(numbers[key], rel=1e-3)


# --- what is done to a log before it is mapped, who is run over which, and means over several -------------------------


@pytest.mark.parametrize("count", [1, 2, 7, 500])
def test_every_kth_step_compounds_the_odometry_of_the_others(log, count) -> None:
    thin = log.every(count)
    kept = list(range(0, len(log), count))
    assert len(thin) == len(kept)
    before = -1
    for row, step in enumerate(kept):
        motion, covariance = log.motions[before + 1], log.motion_covariances[before + 1]
        for k in range(before + 2, step + 1):
            a, b = compose_jacobians(motion, log.motions[k])
            covariance = a @ covariance @ a.T + b @ log.motion_covariances[k] @ b.T
            motion = compose(motion, log.motions[k])
        np.testing.assert_allclose(thin.motions[row], motion, atol=1e-12)
        np.testing.assert_allclose(thin.motion_covariances[row], covariance, atol=1e-15)
        np.testing.assert_array_equal(thin.scan(row).points, log.scan(step).points)
        np.testing.assert_array_equal(thin.sources_of(row), log.sources_of(step))
        before = step
    with pytest.raises(ValueError, match="every 0th step"):
        log.every(0)


def test_of_several_logs_there_is_a_mean_and_columns_without_numbers_are_left_out() -> None:
    numbers = [column.key for column in (*LOG_COLUMNS, *FURTHER_LOG_COLUMNS)]
    frame = pd.DataFrame([
        {"setting": setting, "name": name, **dict.fromkeys(numbers, value), "anees": math.nan, "missed_loop": value > 1}
        for setting, value in (("a", 1.0), ("b", 3.0)) for name in ("singles", "jcbb")
    ])  # fmt: skip
    assert list(log_means(frame)["ate"]) == [2.0, 2.0] and list(log_means(frame)["name"]) == ["singles", "jcbb"]
    assert list(log_means(frame[1:])["name"]) == ["jcbb"]  # the only one that was run over both
    assert [c.key for c in log_tables(frame[:2], "")[0].columns] == [c.key for c in LOG_COLUMNS if c.key != "anees"]
    sound, broken = log_tables(frame[:2], "")[0], log_tables(frame[2:], "")[0]
    assert "twice" not in sound.caption and broken.caption.endswith("mapped a place twice: singles, jcbb.")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (Recorded(reference=True), "--reference is for .g2o"),
        (Recorded(Path("data")), "--data is for victoria_park"),
        (Recorded(), "its clock another one"),
    ],
)
def test_options_that_would_be_ignored_and_a_reference_of_another_time_are_refused(tmp_path, options, message) -> None:
    log = drive(steps=9)
    save(replace(log, reference_times=log.reference_times + 1e9), tmp_path / "log.npz")
    with pytest.raises(ValueError, match=message):
        logs_of(options, str(tmp_path / "log.npz"))


def test_names_of_public_logs_stand_for_their_files(data_dir, tmp_path) -> None:
    found = open_recordings("mrclam", data_dir / "mrclam", [2, 4])
    assert [log.name for log in found] == ["mrclam/MRCLAM_Dataset6/robot2", "mrclam/MRCLAM_Dataset6/robot4"]
    (log,) = logs_of(Recorded(data_dir / "mrclam", [4], every=10), "mrclam")
    assert log.name == found[1].name
    (record,) = map_and_measure(log, "jcbb", "jcbb", None, tmp_path)
    assert record["steps"] == math.ceil(len(found[1]) / 10)
