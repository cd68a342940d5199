"""Evaluating associators on recordings: a drive past posts made by hand, and short parts of the public logs."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from agents.evaluate_association import main
from agents.evaluation.recording_files import ERROR_FIELDS, MAP_FIELDS, read_columns, stem, write_tum
from agents.evaluation.recording_measures import compare, measure
from agents.evaluation.recording_run import run, start_of
from agents.evaluation.recordings import COLUMNS, MORE, Log, RecordingRun, shown_columns, tables
from slam_gym.geometry import compose, compose_jacobians, observe, relative
from slam_gym.mapping.stochastic_map import MapSpec
from slam_gym.metrics.trajectory import ate
from slam_gym.recordings import Recording, save
from slam_gym.recordings.catalogue import open_recordings
from slam_gym.recordings.mrclam import mrclam
from slam_gym.recordings.recording import interpolate
from slam_gym.recordings.victoria_park import victoria_park
from slam_gym.scenarios.recorded import GENERIC, MRCLAM, VICTORIA_PARK, slam_for
from slam_gym.slam.slam import SlamSpec
from slam_gym.types import NONE, UNKNOWN

SPEC = SlamSpec(MapSpec(unconfirmed_age=10), reach=8.0, new_confidence=1.0 - 1e-6)


def drive(steps: int = 120, seed: int = 0, clutter: float = 0.1, surveyed: bool = True) -> Recording:
    """Round and round among posts, with noise that the covariances tell; W is turned and moved against the start."""
    rng = np.random.default_rng(seed)
    posts = rng.uniform(-6.0, 6.0, (14, 2))
    true, poses, motions, points, sources, starts = np.array([2.0, -3.0, 0.7]), [], [], [], [], [0]
    motion_covariance, covariance = np.diag([4e-4, 1e-4, 1e-4]), 2.5e-3 * np.eye(2)
    for k in range(steps):
        step = np.array([0.25, 0.0, 0.07]) if k else np.zeros(3)
        true = compose(true, step + (rng.standard_normal(3) * np.sqrt(np.diag(motion_covariance)) if k else 0.0))
        poses.append(true)
        motions.append(step)
        seen = observe(true, posts)
        near = np.flatnonzero((np.hypot(*seen.T) < 5.0) & (rng.random(len(posts)) < 0.8))
        false = rng.random() < clutter
        points += [*(seen[near] + 0.05 * rng.standard_normal((len(near), 2))), *rng.uniform(-5, 5, (int(false), 2))]
        sources += [*near.tolist(), *[NONE] * int(false)]
        starts.append(len(points))
    unknown = np.full(len(points), np.nan)
    reference = np.array(poses)
    return Recording(
        name="drive", source="the test", terms="any", times=0.5 * np.arange(steps), motions=np.array(motions),
        motion_covariances=np.concatenate([1e-12 * np.eye(3)[None], np.tile(motion_covariance, (steps - 1, 1, 1))]),
        starts=np.array(starts), points=np.array(points), covariances=np.tile(covariance, (len(points), 1, 1)),
        sizes=unknown, size_variances=unknown.copy(), sources=np.array(sources),
        reference_times=0.5 * np.arange(steps),
        reference_poses=reference if surveyed else np.column_stack([reference[:, :2], np.full(steps, np.nan)]),
        landmark_ids=np.arange(14), landmarks=posts, range=8.0, field_of_view=2.0 * math.pi,
    )  # fmt: skip


@pytest.fixture(scope="module")
def log() -> Recording:
    return drive()


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory, log):
    """The command on the drive, as somebody would type it."""
    folder = tmp_path_factory.mktemp("recording")
    save(log, folder / "drive.npz")
    command = ["--recording", str(folder / "drive.npz"), "--associators", "nearest_neighbour", "jcbb",
               "true_association", "--jobs", "1", "--out", str(folder / "out")]  # fmt: skip
    assert main(command) == 0
    return folder / "out", command


@pytest.mark.parametrize("seed", range(8))
def test_true_association_makes_no_mistake_and_maps_every_post_once(seed) -> None:
    log = drive(60, seed, clutter=0.5)
    numbers = measure(log, run(log, "true_association", SPEC))
    assert numbers["precision"] == numbers["recall"] == numbers["f1"] == 1.0
    assert numbers["features"] == numbers["found"] == numbers["true_features"]
    assert numbers["duplicates"] == numbers["clutter_features"] == numbers["clutter_accepted"] == 0
    assert math.isnan(numbers["nodes"]) and numbers["landmark_rmse"] < 0.3


def test_numbers_agree_with_counts_by_hand(log) -> None:
    done = run(log, "nearest_neighbour", SPEC)
    numbers = measure(log, done)
    paired = (done.ids != NONE) & ~done.created
    real = log.sources >= 0
    right = sum(1 for i in np.flatnonzero(paired & real) if done.behind[i] == log.sources[i])
    assert numbers["clutter"] == (log.sources == NONE).sum()
    assert numbers["clutter_accepted"] == (paired & ~real).sum()
    assert numbers["clutter_on_landmarks"] == (paired & ~real & (done.behind >= 0)).sum()
    assert right == done.tally.tp + done.tally.fp_duplicate
    landmarks = done.identities[done.confirmed]
    assert numbers["duplicates"] + numbers["found"] == (landmarks >= 0).sum()
    assert numbers["features"] == numbers["duplicates"] + numbers["found"] + numbers["clutter_features"]


def test_a_run_starts_where_the_reference_does_and_stays_close_to_it(log) -> None:
    done = run(log, "jcbb", SPEC)
    numbers = measure(log, done)
    assert done.surveyed
    np.testing.assert_allclose(start_of(log), log.reference_poses[0], atol=1e-12)
    assert numbers["ate"] <= numbers["ate_unaligned"] < 0.5 and numbers["anees"] < 5.0
    times, estimated, reference = compare(log, done)
    assert numbers["ate_unaligned"] == pytest.approx(ate(estimated, reference))
    np.testing.assert_array_equal(times, log.times)


def test_where_headings_are_unknown_only_alignment_compares() -> None:
    log = drive(surveyed=False)
    done = run(log, "jcbb", SPEC)
    numbers = measure(log, done)
    assert not done.surveyed and start_of(log) is None
    assert math.isnan(numbers["ate_unaligned"]) and math.isnan(numbers["anees"])
    assert numbers["ate"] == pytest.approx(measure(drive(), run(drive(), "jcbb", SPEC))["ate"], rel=1e-6)


def test_instants_are_those_of_whichever_knows_fewer(log) -> None:
    done = run(log, "jcbb", SPEC)

    fine = np.linspace(-3.0, 70.0, 1000)
    dense = replace(log, reference_times=fine, reference_poses=interpolate(log.times, log.reference_poses, fine))
    np.testing.assert_array_equal(compare(dense, done)[0], log.times)
    sparse = replace(log, reference_times=log.times[1::7] + 0.2, reference_poses=log.reference_poses[1::7])
    times, estimated, _ = compare(sparse, done)
    kept = log.times[1::7] + 0.2
    np.testing.assert_array_equal(times, kept[kept <= log.times[-1]])
    np.testing.assert_allclose(estimated, interpolate(log.times, done.poses, times))
    gap = replace(log, reference_times=np.array([0.0, 0.3, 50.0, 59.5]), reference_poses=log.reference_poses[:4])
    assert compare(replace(gap, times=log.times * 4.0), done)[0].tolist() == [0.0, 50.0]  # on a step; else 2 s apart


@pytest.mark.parametrize("count", [1, 2, 3, 7, 500])
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


def test_every_kth_step_ends_where_the_whole_log_does(log) -> None:
    whole, thin = (np.zeros(3) for _ in range(2))
    for motion in log.motions[: len(log.every(7)) * 7 - 6]:
        whole = compose(whole, motion)
    for motion in log.every(7).motions:
        thin = compose(thin, motion)
    np.testing.assert_allclose(relative(whole, thin), 0.0, atol=1e-9)


def test_what_is_spurious_can_be_left_out_and_neighbours_be_one(log) -> None:
    clean = log.without_spurious()
    assert (clean.sources != NONE).all() and len(clean.points) == (log.sources != NONE).sum()
    for k in (0, 50, len(log) - 1):
        np.testing.assert_array_equal(clean.scan(k).points, log.scan(k).points[log.sources_of(k) != NONE])
    np.testing.assert_array_equal(log.merged(0.0).sources, log.sources)
    one = log.merged(100.0)
    assert one.landmark_ids.tolist() == [0] and set(one.sources.tolist()) == {0, NONE}
    np.testing.assert_allclose(one.landmarks[0], log.landmarks.mean(axis=0))
    grown = one.covariances[0] - log.covariances[0]
    np.testing.assert_allclose(grown, 0.5 * np.trace(np.cov(log.landmarks.T, bias=True)) * np.eye(2), atol=1e-12)
    with pytest.raises(ValueError, match="no landmark has a place"):
        replace(log, landmark_ids=np.empty(0, np.int64), landmarks=np.empty((0, 2))).merged(1.0)


def test_table_json_and_csv_say_the_same(evaluated) -> None:
    out, _ = evaluated
    results = json.loads((out / "results.json").read_text(encoding="utf-8"))
    rows = list(csv.DictReader((out / "records.csv").open(encoding="utf-8")))
    assert results["complete"] and [row["associator"] for row in rows] == list(results["table"]["drive"])
    for row in rows:
        for column in COLUMNS:
            told = results["table"]["drive"][row["associator"]][column.key]
            assert (told is None) == (row[column.key] == "nan")
            assert told is None or told == float(row[column.key])
    assert results["table"]["drive"]["true_association"]["precision"] == 1.0


def test_the_terminal_has_room_for_the_table(log, evaluated, capsys, monkeypatch) -> None:
    _, command = evaluated
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*command, "--resume"]) == 0  # everything is in the journal already
    printed = capsys.readouterr().out
    assert "0/0" in printed
    table = printed[printed.index("drive, 120 scans") :]
    assert all(name in table for name in ("nearest", "jcbb", "true association", "ATE₀", "ANEES"))
    assert all(len(line) <= 80 for line in table.splitlines() if "report:" not in line)


def test_the_report_has_its_tables_and_pictures(evaluated) -> None:
    out, _ = evaluated
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2 and "the test" in page
    for name in ("nearest neighbour", "jcbb", "true association"):
        assert name in page
    assert "http" not in page.replace("http-equiv", "")


def test_files_hold_the_run(evaluated, log) -> None:
    out, _ = evaluated
    base = out / "runs" / stem("drive", "jcbb")
    features, errors = (read_columns(base.with_name(f"{base.name}.{kind}.csv")) for kind in ("map", "errors"))
    assert tuple(features) == MAP_FIELDS and tuple(errors) == ERROR_FIELDS
    table = json.loads((out / "results.json").read_text(encoding="utf-8"))["table"]["drive"]["jcbb"]
    assert features["confirmed"].sum() == table["features"]
    assert math.sqrt((errors["error"] ** 2).mean()) == pytest.approx(table["ate"], rel=1e-6)


def test_evo_reads_the_trajectories_and_finds_the_same_error(evaluated) -> None:
    pytest.importorskip("evo")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    out, _ = evaluated
    table = json.loads((out / "results.json").read_text(encoding="utf-8"))["table"]["drive"]["jcbb"]
    reference, estimate = (
        file_interface.read_tum_trajectory_file(str(out / "runs" / name))
        for name in ("drive.reference.tum", "drive.jcbb.tum")
    )
    reference, estimate = sync.associate_trajectories(reference, estimate, max_diff=1e-3)
    for aligned, key in ((False, "ate_unaligned"), (True, "ate")):
        if aligned:
            estimate.align(reference, correct_scale=False)
        error = metrics.APE(metrics.PoseRelation.translation_part)
        error.process_data((reference, estimate))
        assert error.get_statistic(metrics.StatisticsType.rmse) == pytest.approx(table[key], rel=1e-3)


def test_headings_survive_the_tum_format(tmp_path) -> None:
    evo = pytest.importorskip("evo.tools.file_interface")
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.normal(size=(50, 2)), rng.uniform(-math.pi, math.pi, 50)])
    write_tum(tmp_path / "a.tum", np.arange(50.0), poses)
    read = evo.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    for pose, matrix in zip(poses, read.poses_se3):
        assert math.atan2(matrix[1, 0], matrix[0, 0]) == pytest.approx(pose[2], abs=1e-6)
        np.testing.assert_allclose(matrix[:2, 3], pose[:2], atol=1e-7)


def test_interrupted_evaluations_go_on(tmp_path, log, evaluated) -> None:
    whole, command = evaluated
    out = tmp_path / "out"
    argv = [*command[:-1], str(out)]
    assert main(argv) == 0
    lines = (out / "records.jsonl").read_text(encoding="utf-8").splitlines()
    (out / "records.jsonl").write_text(lines[0] + "\n", encoding="utf-8")
    with pytest.raises(ValueError, match="holds an evaluation already"):
        main(argv)
    with pytest.raises(ValueError, match="was evaluated with every 1, not 2"):
        main([*argv, "--resume", "--every", "2"])
    assert main([*argv, "--resume"]) == 0
    tables = [json.loads((folder / "results.json").read_text())["table"]["drive"] for folder in (whole, out)]
    for name, row in tables[0].items():
        for key in ("precision", "ate", "features", "anees"):
            assert tables[1][name][key] == row[key]


def test_of_several_logs_there_is_a_mean() -> None:
    records = [
        {"setting": setting, "associator": name, **{c.key: value for c in (*COLUMNS, *MORE)}}
        for setting, value in (("a", 1.0), ("b", 3.0))
        for name in ("jcbb", "singles")
    ]
    found = tables(records, ["jcbb", "singles"])
    assert list(found) == ["a", "b", "mean"] and found["mean"]["jcbb"]["ate"] == 2.0
    assert list(tables(records[:3], ["jcbb", "singles"])["mean"]) == ["jcbb"]
    assert [c.key for c in shown_columns({"x": {c.key: math.nan for c in COLUMNS} | {"ate": 1.0}})] == ["ate"]


@pytest.mark.parametrize(
    ("argv", "error", "message"),
    [
        (["--recording", "victoria_park"], FileNotFoundError, "not part of this package.*SLAM_GYM_DATA.*Cite: Guivant"),
        (["--recording", "mrclam"], FileNotFoundError, "not part of this package.*Cite: Leung"),
        (["--recording", "victoria_park", "--data", "nowhere"], FileNotFoundError, "nowhere is no folder.*Cite"),
        (["--recording", "park"], ValueError, "unknown recording 'park'; known: victoria_park, mrclam, FILE.npz"),
        (["--recording", "park.npz"], FileNotFoundError, "park.npz: not there"),
        (["--recording", "mrclam", "--every", "0"], ValueError, "--every must be at least 1"),
        (["--recording", "victoria_park", "--robots", "1"], ValueError, "--robots is for mrclam"),
        (["--recording", "victoria_park", "--suite"], ValueError, "give one of them"),
    ],
)  # fmt: skip
def test_what_cannot_be_evaluated_is_said(argv, error, message, monkeypatch) -> None:
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    with pytest.raises(error, match=message):
        main(argv)


def test_logs_have_the_settings_of_their_kind(log) -> None:

    assert slam_for(replace(log, name="mrclam/MRCLAM_Dataset6/robot1")) is MRCLAM
    assert slam_for(replace(log, name="victoria_park")) is VICTORIA_PARK
    assert slam_for(log).reach == log.range and slam_for(log).map == GENERIC.map


def test_a_stretch_of_the_park_with_jcbb(data_dir) -> None:
    log = victoria_park(data_dir / "victoria_park").part(0, 600)
    jcbb, truth = (measure(log, run(log, name, VICTORIA_PARK)) for name in ("jcbb", "true_association"))
    assert truth["precision"] == truth["recall"] == 1.0 and truth["features"] == truth["true_features"]
    assert jcbb["precision"] > 0.99 and jcbb["recall"] > 0.97 and jcbb["limits"] == 0
    assert (log.sources == UNKNOWN).any() and jcbb["ate"] < 3.0 and math.isnan(jcbb["ate_unaligned"])


@pytest.mark.parametrize("robot", [1, 4])
def test_a_robot_of_mrclam_is_placed_and_mapped_to_decimetres_where_identities_are_known(data_dir, robot) -> None:
    log = mrclam(data_dir / "mrclam" / "MRCLAM_Dataset6", robot)
    truth = measure(log, run(log, "true_association", MRCLAM))
    assert truth["precision"] == truth["recall"] == 1.0 and truth["features"] == truth["landmarks_compared"] == 15
    assert truth["ate"] < truth["ate_unaligned"] < 0.4 and truth["landmark_rmse"] < 0.12 and truth["anees"] < 5.0


def test_names_of_public_logs_stand_for_their_files(data_dir) -> None:
    found = open_recordings("mrclam", data_dir / "mrclam", [2, 4])
    assert [log.name for log in found] == ["mrclam/MRCLAM_Dataset6/robot2", "mrclam/MRCLAM_Dataset6/robot4"]
    again = open_recordings("mrclam", data_dir / "mrclam" / "MRCLAM_Dataset6", [4])[0]
    np.testing.assert_array_equal(again.points, found[1].points)
    task = RecordingRun("jcbb", Log("mrclam", str(data_dir / "mrclam"), 4, every=10), found[1].name)
    record = task.run()[0]
    assert record["steps"] == math.ceil(len(again) / 10) and record["setting"] == found[1].name
