"""The density of every hypothesis over a scan, by the formula, in the dullest way."""

import dataclasses
import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from slam_gym.association.prediction import Prediction
from slam_gym.navigation.visibility import NOTHING_EXPLORED, ViewsFrom, probabilities_in_view
from slam_gym.types import UNPAIRED, Array, Scan
from tests.oracles.association import compatible, problem, stacked


class Rates(NamedTuple):
    """What a density is made of beside the innovations."""

    detection: float  # P_D
    density: float  # [1/m²] λ
    unseen: float = 0.05  # least visibility of a paired feature


SIGHT = ViewsFrom(1.2, 1.6)
"""A sensor that sees a part of the small problems, over space in which nothing hides a feature."""


def looking(prediction: Prediction, sight: ViewsFrom | None = SIGHT, moves: bool = True) -> Prediction:
    """The same for a robot that knows what its sensor shows."""
    nobody = ((0.0, 0.0, 0.0, 0.0), tuple(NOTHING_EXPLORED))
    seen = nobody if sight is None else sight.arrays
    return dataclasses.replace(prediction, expected=prediction.expected._replace(sight=seen, view_moves=moves))


def dressed(prediction: Prediction, seed: int) -> Prediction:
    """With no view, with a fixed one, or with one that depends on where a hypothesis puts the robot."""
    if seed % 4 == 0:
        return prediction
    if seed % 4 == 1:
        return prediction.with_visibility(np.random.default_rng(seed).uniform(0.0, 1.0, len(prediction)))
    return looking(prediction, moves=seed % 4 == 2)


def log_density(scan: Scan, prediction: Prediction, rows: list[int], rates: Rates) -> float:
    """Of the hypothesis that pairs measurement i with row rows[i], or UNPAIRED."""
    pairs = [(i, int(j)) for i, j in enumerate(rows) if j != UNPAIRED]
    total = (len(rows) - len(pairs)) * math.log(rates.density) + fit(scan, prediction, pairs)
    v, paired = visibilities(scan, prediction, pairs), [j for _, j in pairs]
    if v is None:
        return total + len(pairs) * math.log(rates.detection)
    for j in range(len(prediction)):
        seen = rates.detection * v[j]
        total += math.log(rates.detection * max(v[j], rates.unseen)) if j in paired else math.log(1.0 - seen)
    return total


def fit(scan: Scan, prediction: Prediction, pairs: list[tuple[int, int]]) -> float:
    """log N(ν_H; 0, S_H)."""
    if not pairs:
        return 0.0
    nu, S = stacked(scan, prediction, pairs)
    return float(-0.5 * nu @ np.linalg.solve(S, nu) - 0.5 * np.linalg.slogdet(2.0 * np.pi * S)[1])


def in_view(sight: ViewsFrom, positions: Array, covariances: Array, pose: Array | None = None) -> Array:
    """(k,) probability that each feature, given in R, is in view from `pose` (3,)."""
    at = np.zeros(3) if pose is None else pose
    found = probabilities_in_view(positions, covariances, sight.arrays, at)
    assert np.isfinite(found).all()
    return found


def visibilities(scan: Scan, prediction: Prediction, pairs: list[tuple[int, int]]) -> Array | None:
    """v_j of every row, from where the hypothesis puts the robot; None where nobody knows."""
    fixed = prediction.visibility()
    if fixed is None or len(prediction.expected.visible):
        return fixed
    n = len(prediction)
    positions, P = prediction.positions.ravel(), prediction.joint(np.arange(n)) if n else np.zeros((0, 0))
    if pairs and prediction.expected.view_moves:
        nu, S = stacked(scan, prediction, pairs)
        entries = np.array([2 * j + a for _, j in pairs for a in range(2)])
        gain = P[:, entries] @ np.linalg.inv(S)
        positions, P = positions + gain @ nu, P - gain @ P[entries]
    blocks = np.array([P[2 * j : 2 * j + 2, 2 * j : 2 * j + 2] for j in range(n)]).reshape(n, 2, 2)
    return in_view(SIGHT, positions.reshape(n, 2), blocks)


def every_hypothesis(
    scan: Scan,
    prediction: Prediction,
    *,
    allowed: Array | None = None,
    given: list[int] | None = None,
    related: Array | None = None,
) -> list[list[int]]:
    """Rows of every hypothesis over candidates within a gate of .999; arguments as in `association.best_path`."""
    given = [UNPAIRED] * len(scan) if given is None else given
    options = [
        [given[i]] if given[i] != UNPAIRED else [UNPAIRED, *(j for _, j in found if allowed is None or allowed[j])]
        for i, found in enumerate(compatible(scan, prediction, 0.999))
    ]
    out = []
    for rows in itertools.product(*options):
        paired = [j for j in rows if j != UNPAIRED]
        new = [j for i, j in enumerate(rows) if j != UNPAIRED and given[i] == UNPAIRED]
        # which pairing is the first is up to the order of the search, so every one must be local to every other
        local = related is None or all(related[a, b] for a in new for b in new)
        if len(set(paired)) == len(paired) and local:
            out.append(list(rows))
    return out


WIDE = {"width": 3000, "margin": 1e9}
"""Search options under which no hypothesis of a small problem is dropped."""


def bare_problem(seed: int, **options: Any) -> tuple[Scan, Prediction]:
    """So small that every hypothesis can be enumerated; without a view."""
    rng = np.random.default_rng(seed)
    m, n = int(rng.integers(0, 5)), int(rng.integers(0, 6))
    return problem(rng, m, n, spread=float(rng.choice([1.0, 1.5, 2.0])), **options)


def small_problem(seed: int, **options: Any) -> tuple[Scan, Prediction]:
    """Most have a view, and it does not move: hypotheses that agree in what they see may share a view that does."""
    scan, prediction = bare_problem(seed, **options)
    return scan, dressed(prediction, (0, 1, 3, 3)[seed % 4])
