"""Recordings as scenarios of `Associate-v0`: windows, identities, rewards, and what a user is told where data lack."""

import math
from dataclasses import replace

import numpy as np
import pytest

from slam_gym.association import jcbb, nearest_neighbour
from slam_gym.geometry import relative
from slam_gym.recordings import save
from slam_gym.simulation.recorded_logs import reference_poses, windows
from slam_gym.types import SPURIOUS, UNLABELLED
from tests.envs.test_associate import Playing, by_truth, refuse, total
from tests.recordings import drive
from tests.rollouts import associate, at_random, episode


@pytest.fixture
def arc(tmp_path) -> str:
    save(drive(), tmp_path / "arc.npz")
    return f"recording:{tmp_path / 'arc.npz'}"


# -- windows -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("every", [1, 2, 3])
@pytest.mark.parametrize("split", ["train", "test"])
def test_windows_are_pieces_of_their_part_of_the_log_and_start_where_the_robot_stands(split, every) -> None:
    recording, starts = drive(), set()
    thinned = recording.every(every)
    cut = round(0.7 * len(thinned))
    steps = range(cut) if split == "train" else range(cut, len(thinned))
    log, step_of = windows(recording, split, 5, every), {thinned.scan(k).points.tobytes(): k for k in steps}
    for seed in range(400):
        looks = list(log.scans(np.random.default_rng(seed)))
        assert len(looks) == log.length == 5
        first = step_of[looks[0][1].points.tobytes()]
        starts.add(first)
        for k, (odometry, scan, truth) in enumerate(looks):
            np.testing.assert_array_equal(scan.points, thinned.scan(first + k).points)
            np.testing.assert_array_equal(truth.sources, thinned.sources_of(first + k))
            expected = thinned.motions[first + k] if k else np.zeros(3)
            np.testing.assert_array_equal(odometry.motion, expected)
            assert k or not odometry.covariance.any()
    assert starts == set(steps[: len(steps) - 4])


def test_reference_poses_are_read_between_their_neighbours_and_across_the_cut_of_the_circle() -> None:
    recording = drive()
    every_third = replace(
        recording, reference_times=recording.reference_times[::3], reference_poses=recording.reference_poses[::3]
    )
    poses, true = reference_poses(every_third), recording.reference_poses
    for k in range(58):  # the last one given is that of step 57
        error = relative(true[k], poses[k])
        assert np.hypot(*error[:2]) < 0.05 and abs(error[2]) < 1e-9
        assert -math.pi < poses[k, 2] <= math.pi
    assert np.isnan(poses[58:]).all()
    assert np.isnan(reference_poses(drive(headings=False))[:, 2]).all()
    nothing = replace(recording, reference_times=np.empty(0), reference_poses=np.empty((0, 3)))
    assert np.isnan(reference_poses(nothing)).all()


# -- the environment -----------------------------------------------------------------------------------------------


def test_refusing_everything_earns_nothing_and_the_truth_the_maximum(arc) -> None:
    for seed in range(5):
        env = associate(f"{arc}?looks=30", candidates=8)
        steps = list(episode(env, choose=refuse, seed=seed))
        assert all(step[1] == 0.0 for step in steps) and steps[-1][4]["score"] == 0.0
        steps = list(episode(env, choose=by_truth, seed=seed))
        tally = env.run.identities.total
        assert tally.fp == 0 and tally.tp > 40
        assert steps[-1][4]["score"] == pytest.approx(tally.recall) and tally.recall > 0.9
        for player in (Playing(nearest_neighbour), Playing(jcbb), at_random(seed)):
            assert total(episode(env, choose=player, seed=seed)) <= total(steps)


def test_sources_that_nobody_knows_earn_nothing_and_spurious_ones_cost() -> None:
    for source, earns in ((UNLABELLED, 0.0), (SPURIOUS, -1.0)):
        log = drive()
        env = associate(windows(replace(log, sources=np.full_like(log.sources, source)), "train"), wrong_cost=2.0)
        steps = list(episode(env))
        assert len(steps) > 100 and np.sign(total(steps)) == earns
        tally = env.run.identities.total
        assert (tally.fp_spurious > 50) == (source == SPURIOUS) and tally.fp == tally.fp_spurious and tally.tp == 0
        assert steps[-1][4]["score"] == pytest.approx(-2.0 * tally.fp)


def test_a_map_is_scored_against_the_landmarks_wherever_the_window_starts(arc) -> None:
    errors = []
    for seed in range(5):
        env = associate(f"{arc}?looks=30", reward="map_error")
        steps = list(episode(env, choose=Playing(jcbb), seed=seed))
        assert total(steps) == pytest.approx(steps[0][4]["map_error"] - steps[-1][4]["map_error"])
        errors.append(steps[-1][4]["map_error"])
    assert max(errors) < 0.9  # a map in another frame would be worse than none


def test_without_known_places_no_map_is_scored() -> None:
    for recording in (drive(headings=False), drive(landmark_ids=np.empty(0, np.int64), landmarks=np.empty((0, 2)))):
        log = windows(recording, "train", 5)
        with pytest.raises(ValueError, match="nobody knows where the features of 'arc' are; known: truth"):
            associate(log, reward="map_error")
        env = associate(log, render_mode="rgb_array")
        for _, _, _, _, info in episode(env):
            assert info["map_error"] == 1.0
        assert env.render().shape == (720, 960, 3)


# -- names ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("recording:atlantis", ValueError, "unknown recording 'atlantis'; known: victoria_park, mrclam"),
        ("recording:nowhere.npz", FileNotFoundError, "nowhere.npz: not there"),
        ("recording:mrclam", ValueError, "known: mrclam/1, "),
        ("recording:mrclam/6", ValueError, "known: mrclam/1, "),
        ("recording:victoria_park", FileNotFoundError, "(?s)SLAM_GYM_DATA.*Cite"),
        ("recording:mrclam/1", FileNotFoundError, "(?s)SLAM_GYM_DATA.*Cite"),
        ("recording:victoria_park?look=3", ValueError, "looks=NUMBER"),
        ("recording:victoria_park?looks=few", ValueError, "looks=NUMBER"),
        ("recording:victoria_park?", ValueError, "looks=NUMBER"),
        ("recordings", ValueError, "recording:FILE, recording:victoria_park"),
    ],
)
def test_names_without_a_recording_are_refused_with_what_to_do(name, error, message, monkeypatch) -> None:
    monkeypatch.delenv("SLAM_GYM_DATA", raising=False)
    with pytest.raises(error, match=message):
        associate(name)


def test_numbers_out_of_range_are_refused(arc) -> None:
    for query, message in (("looks=0", "looks=0"), ("every=0", "every 0"), ("every=60", "'arc': 1 steps are too few")):
        with pytest.raises(ValueError, match=message):
            associate(f"{arc}?{query}")
    with pytest.raises(ValueError, match="split='valid'; known: train, test"):
        windows(drive(), "valid")


# -- the published logs --------------------------------------------------------------------------------------------


def test_victoria_park_ranks_nearest_neighbour_below_jcbb_below_the_truth(data_dir, monkeypatch) -> None:
    monkeypatch.setenv("SLAM_GYM_DATA", str(data_dir))
    park = "recording:victoria_park?looks=100&every=10"
    env = associate(park, split="test", compatibility="individual", candidates=8)
    assert env.scenario.name == "victoria_park"
    returns = {}
    for name, player in (("nn", Playing(nearest_neighbour)), ("jcbb", Playing(jcbb)), ("truth", by_truth)):
        returns[name] = np.mean([total(episode(env, choose=player, seed=seed)) for seed in range(4)])
    assert returns["nn"] + 0.1 < returns["jcbb"] < 0.8 < returns["truth"] <= 1.0


def test_mrclam_is_set_6_of_the_robot_that_was_asked_for(data_dir, monkeypatch) -> None:
    monkeypatch.setenv("SLAM_GYM_DATA", str(data_dir))
    env = associate("recording:mrclam/3?looks=60", reward="map_error")
    assert env.scenario.name == "mrclam/MRCLAM_Dataset6/robot3" and env.scenario.targets.shape == (15, 2)
    assert min(total(episode(env, choose=by_truth, seed=seed)) for seed in range(4)) > 0.0
