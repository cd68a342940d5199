"""What goes into the kernels and comes out of them, against formulas written down anew."""

import math

import numpy as np
import pytest

from slam_gym.association.compatibility import chi2_gate
from slam_gym.association.triangles.arguments import (
    check_features,
    effort_of,
    kinds_as_numbers,
    pose_of,
    search_gates,
)
from slam_gym.association.triangles.verify import BINARY, JOINT, LEAVES, LIMIT, NODES, TRIES
from slam_gym.types import UNKNOWN_KIND


def test_kinds_are_numbers_and_those_unknown_are_none() -> None:
    np.testing.assert_array_equal(kinds_as_numbers([3, UNKNOWN_KIND, 0]), [3.0, math.nan, 0.0])
    assert math.isnan(kinds_as_numbers(None))


@pytest.mark.parametrize("confidence", [0.9, 0.99])
def test_gates_are_those_of_one_and_two_and_then_of_each_number_of_pairings(confidence: float) -> None:
    gates = search_gates(9, confidence)
    assert len(gates) == 10
    assert gates[0] == chi2_gate(1, confidence) and gates[1] == chi2_gate(2, confidence)
    for k in range(2, 10):
        assert gates[k] == chi2_gate(2 * k - 3, confidence)


@pytest.mark.parametrize(
    ("position", "covariance", "named"),
    [
        ([np.nan, 0.0], np.eye(2), "positions: feature 2"),
        ([0.0, np.inf], np.eye(2), "positions: feature 2"),
        ([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], "covariances: that of feature 2"),
        ([0.0, 0.0], [[-1.0, 0.0], [0.0, 1.0]], "covariances: that of feature 2"),
        ([0.0, 0.0], [[1.0, 0.5], [0.0, 1.0]], "covariances: that of feature 2"),
        ([0.0, 0.0], [[np.nan, 0.0], [0.0, 1.0]], "covariances: that of feature 2"),
    ],
)
def test_the_first_bad_feature_is_refused_by_name(position: list, covariance: list, named: str) -> None:
    positions, covariances = np.zeros((4, 2)), np.tile(np.eye(2), (4, 1, 1))
    check_features(positions, covariances)
    positions[2], covariances[2] = position, covariance
    with pytest.raises(ValueError, match=named):
        check_features(positions, covariances)
    with pytest.raises(ValueError, match="covariances: shape"):
        check_features(positions, covariances[:3])


def test_effort_has_each_count_under_its_name_and_a_map_cut_short_is_a_limit() -> None:
    spent = np.zeros(6, np.int64)
    spent[[NODES, BINARY, JOINT, LEAVES, TRIES]] = [1, 2, 3, 4, 5]
    effort = effort_of(spent, False, 0.25)
    assert (effort.nodes, effort.binary_tests, effort.joint_tests, effort.leaves, effort.tries) == (1, 2, 3, 4, 5)
    assert effort.seconds == 0.25 and not effort.limit_hit and effort_of(spent, True, 0.25).limit_hit
    spent[LIMIT] = 1
    assert effort_of(spent, False, 0.25).limit_hit


def test_the_pose_of_a_fit_puts_its_centre_where_the_fit_does_with_the_covariance_moved_along() -> None:
    rng = np.random.default_rng(31)
    for _ in range(20):
        theta, t, o = rng.uniform(-np.pi, np.pi), rng.uniform(-9.0, 9.0, 2), rng.uniform(-9.0, 9.0, 2)
        half = rng.standard_normal((3, 3))
        P = half @ half.T
        fit = np.array([*t, np.cos(theta), np.sin(theta), *o, P[0, 0], P[0, 1], P[1, 1], P[0, 2], P[1, 2], P[2, 2]])
        pose, covariance = pose_of(fit)
        R = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        np.testing.assert_allclose(pose, [*(t - R @ o), theta], atol=1e-12)
        turned = np.array([[0.0, -1.0], [1.0, 0.0]]) @ R @ o  # of t − R(θ)o, −∂R/∂θ o is the column of θ
        J = np.array([[1.0, 0.0, -turned[0]], [0.0, 1.0, -turned[1]], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(covariance, J @ P @ J.T, rtol=1e-9, atol=1e-9)
