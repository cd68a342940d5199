"""Train the learned acceptance: a logistic model of the numbers about an answer, with a penalty on its weights.

Few answers are wrong, and a wrong one is dear: what it costs is said where the odds are used, not here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from agents.learning.acceptance.answers import Answer, Asked
from slam_gym.association.learned.network import FARTHEST, Network, log_odds, network_of
from slam_gym.types import Array, BoolArray

_PENALTY = 0.001  # of the squared weights, beside the mean cross-entropy


class Outcome(NamedTuple):
    """What a way to accept comes to."""

    recall: float  # right answers, of the problems inside
    wrong: float  # wrong answers, of those
    invented: float  # answers, of the problems in other buildings


def fit(answers: Sequence[Answer]) -> dict[str, Array]:
    """The arrays of a network without hidden numbers, for log odds that an answer is right."""
    x, right = np.array([a.inputs for a in answers]), np.array([a.right for a in answers])
    if right.all() or not right.any():
        raise ValueError("all answers are right, or none is: there is nothing to learn")
    deviation = x.std(axis=0)
    centre, scale = x.mean(axis=0), np.where(deviation > 1e-6, deviation, 1.0)
    given, sign = (x - centre) / scale, np.where(right, 1.0, -1.0)
    z = np.column_stack([np.clip(given, -FARTHEST, FARTHEST), np.ones(len(x))])
    z *= 0.5 ** (np.abs(given) > FARTHEST).sum(axis=1, keepdims=True)  # as the network has it

    def loss(w: Array) -> tuple[float, Array]:
        margin = sign * (z @ w)
        slope = -sign / (1.0 + np.exp(margin)) / len(z)
        penalty = _PENALTY * np.append(w[:-1], 0.0)
        return float(np.logaddexp(0.0, -margin).mean() + penalty @ w), z.T @ slope + 2.0 * penalty

    w = minimize(loss, np.zeros(z.shape[1]), jac=True, method="L-BFGS-B").x
    return {
        "centre": centre, "scale": scale, "linear": w[:-1], "offset": w[-1:],
        "first": np.zeros((0, len(centre))), "first_offset": np.zeros(0), "second": np.zeros((0, 0)),
        "second_offset": np.zeros(0), "last": np.zeros(0),
    }  # fmt: skip


def odds_of(network: Network, answers: Sequence[Answer]) -> Array:
    """Log odds (a,) of each answer."""
    return np.array(
        [log_odds(network, a.inputs[None], np.zeros(1, np.int64), np.zeros(1, np.int64))[0] for a in answers]
    )


def outcome(asked: Sequence[Asked], accepted: Sequence[BoolArray]) -> Outcome:
    """Of problems, when the answers `accepted` of each world are given."""
    inside, outside = sum(a.inside for a in asked), sum(a.outside for a in asked)
    given = [answer for one, which in zip(asked, accepted) for answer, yes in zip(one.answers, which) if yes]
    right = sum(a.right for a in given)
    wrong = sum(a.inside and not a.right for a in given)
    return Outcome(right / max(inside, 1), wrong / max(inside, 1), sum(not a.inside for a in given) / max(outside, 1))


def by_rule(asked: Sequence[Asked]) -> Outcome:
    """What the rule of the search comes to."""
    return outcome(asked, [np.array([a.by_rule for a in one.answers], np.bool_) for one in asked])


def accepted_by(arrays: dict[str, Array], asked: Sequence[Asked], cost: float) -> list[BoolArray]:
    """Which answers the network accepts where a wrong one costs so many right ones."""
    network = network_of(arrays)
    return [odds_of(network, one.answers) > np.log(cost) for one in asked]
