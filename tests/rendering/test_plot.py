"""Plots for users: what is in the map, the scan and the hypothesis is in the picture, at its place."""

import sys
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from slam_gym import Odometry, Scan, Slam, jcbb
from slam_gym.association.compatibility import individual
from slam_gym.association.prediction import Prediction
from slam_gym.association.tree import interpretation_tree
from slam_gym.rendering.plot import plot_episode, plot_map, plot_scan, plot_tree

POSTS = np.array([[8.0, 1.0], [6.0, -2.0], [7.0, 3.0]])


@pytest.fixture
def slam():
    slam = Slam()
    for metre in range(3):
        odometry = Odometry.from_motion([1.0, 0.0, 0.0], sigmas=[0.05, 0.02, 0.01])
        step = slam.step(odometry, Scan.from_points(POSTS - [metre + 1.0, 0.0], sigma=0.05), "jcbb")
    return slam, step


def points(ax):
    return np.concatenate([np.asarray(line.get_xydata()) for line in ax.lines])


def test_a_map_is_drawn_where_it_lies_with_its_ellipses(slam):
    ax = plot_map(slam[0].map, colour="#123456")
    there = [*slam[0].map.positions, slam[0].map.pose[:2]]
    assert all((np.abs(points(ax) - p).max(axis=1) < 1e-12).any() for p in there)
    assert len(ax.collections[0].get_offsets()) == 3 and ax.lines[0].get_markeredgecolor() == "#123456"
    sigmas = np.linalg.eigvalsh(slam[0].map.covariances) ** 0.5
    assert np.allclose(ax.collections[0]._widths, 2.0 * sigmas[:, 1]) and ax.get_aspect() == 1.0  # half of the widths


def test_a_scan_is_drawn_with_an_arrow_for_each_pairing(slam):
    _, step = slam
    prediction = Slam().predict(
        Odometry.from_motion([0.0, 0.0, 0.0], sigmas=[0.1, 0.1, 0.1]), Scan.from_points(POSTS, sigma=0.05)
    )
    assert not plot_scan(Scan.from_points(POSTS, sigma=0.05), prediction).texts
    scan = Scan.from_points(POSTS - [3.0, 0.0], sigma=0.05)
    ax = plot_scan(scan, step.prediction, step.hypothesis)
    assert len(ax.texts) == 3 and sorted(t.xy[0] for t in ax.texts) == sorted(scan.points[:, 0])


def test_an_exploration_is_drawn_in_the_frame_of_the_world():
    env = gym.make("slam_gym/Explore-v0", scenario="office-small", action="twist").unwrapped
    env.reset(seed=0)
    for _ in range(5):
        env.step(np.array([0.5, 0.1], np.float32))
    ax, episode = plot_episode(env.episode), env.episode
    assert np.allclose(ax.lines[-2].get_xydata(), np.array(episode.poses)[:, :2])
    assert np.hypot(*(ax.lines[-1].get_xydata()[-1] - episode.poses[-1][:2])) < 0.2
    given = ax.figure.add_subplot(xlabel="east [m]")
    plot_episode(episode, given)
    assert (given.get_xlabel(), given.get_ylabel()) == ("east [m]", "y [m]")


def test_without_matplotlib_the_error_names_the_extra(slam, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match=r"slam_gym\[agents\]"):
        plot_map(slam[0].map)


def test_pairings_that_are_wrong_are_told_by_their_lines_too(slam):
    _, step = slam
    scan = Scan.from_points(POSTS - [3.0, 0.0], sigma=0.05)
    right = replace(step.hypothesis, features=step.hypothesis.features[[1, 0, 2]])
    drawn = plot_scan(scan, step.prediction, step.hypothesis, right=right).texts
    assert [text.arrow_patch.get_linestyle() for text in drawn] == ["--", "--", "-"]


def test_a_tree_is_drawn_with_every_branch_and_the_paths_of_answers(slam):
    scan = Scan.from_points(POSTS - [3.0, 0.0], sigma=0.05)
    prediction = slam[0].predict(Odometry.from_motion([0.0, 0.0, 0.0], sigmas=[0.1, 0.1, 0.1]), scan)
    tree, answer = interpretation_tree(scan, prediction, individual(scan, prediction)), jcbb(scan, prediction)
    ax = plot_tree(tree, {"answer": answer, "nothing": replace(answer, features=np.full(3, -1))})
    names = [text.get_text() for text in ax.texts]
    assert names.count("*") == 7 and len(names) == 14  # two branches a node: its feature, or nothing
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["answer", "nothing"]


def test_a_tree_that_nobody_could_look_at_is_refused():
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (9, 2))
    scan = Scan.from_points(points, sigma=0.1)
    prediction = Prediction.from_gaussian(points, 0.1 * np.eye(18))
    with pytest.raises(ValueError, match="more than 400 branches"):
        plot_tree(interpretation_tree(scan, prediction, individual(scan, prediction)))
