"""The associator that reinforcement learning taught: a network scores the branches of the interpretation tree.

Proximal policy optimisation (Schulman et al. 2017) on `Associate-v0` from random weights: `slam-gym train associate`
trains it, and writes such weights. With r_k the row of candidate k in the observation, r_* that of `*` (`legal` 1, all
else 0), and q the rest of the observation,

    e_k = max(0, B max(0, A r_k + a) + b),   s = (max(0, C q + c), max over legal k of e_k),
    score_k = wᵀ max(0, D (e_k, s) + d) + w₀,

and the legal branch of the greatest score is taken. Every candidate passes through the same weights, so there may be
any number of them. It runs as plain numpy: no learning library is needed.
"""

import functools
from pathlib import Path

import numpy as np

from slam_gym.association.policy import from_policy
from slam_gym.association.prediction import Associator, Prediction
from slam_gym.association.tracking.walk import CANDIDATE_FIELDS, COMPATIBILITIES, MEASUREMENT_FIELDS, PATH_FIELDS
from slam_gym.association.walks import ORDERS, Observation
from slam_gym.types import Array, BoolArray, Hypothesis, Scan
from slam_gym.weights import cached, load

VERSION = 2
INPUTS = tuple(
    f"{part}: {field}"
    for part, fields in (("candidate", CANDIDATE_FIELDS), ("measurement", MEASUREMENT_FIELDS), ("path", PATH_FIELDS))
    for field in fields
)
_ROW, _REST = len(CANDIDATE_FIELDS), len(MEASUREMENT_FIELDS) + len(PATH_FIELDS)
_LEGAL = CANDIDATE_FIELDS.index("legal")
SHAPES = {
    "A": (-1, _ROW), "a": (-1,), "B": (-1, -1), "b": (-1,), "C": (-1, _REST), "c": (-1,), "D": (-1, -1), "d": (-1,),
    "w": (1, -1), "w0": (1,), "walk": (3,),
}  # fmt: skip
"""The arrays of weights. `walk`: the candidates on offer, the order and the compatibility that they were trained with,
the latter two by their place in `ORDERS` and `COMPATIBILITIES`."""


def _best_branch(own: dict[str, Array], observation: Observation, mask: BoolArray) -> int:
    """The policy that takes the legal branch of the greatest score by the weights `own`."""
    rows, legal = np.zeros((len(mask), _ROW)), np.flatnonzero(mask)
    rows[:-1] = observation["candidates"].reshape(len(mask) - 1, _ROW)
    rows[-1, _LEGAL] = 1.0  # `*`
    each = _layer(own["B"], own["b"], _layer(own["A"], own["a"], rows)) * rows[:, _LEGAL, None]
    rest = _layer(own["C"], own["c"], np.concatenate([observation["measurement"], observation["path"]]))
    shared = np.broadcast_to(np.concatenate([rest, each.max(axis=0)]), (len(rows), len(rest) + each.shape[1]))
    scores = _layer(own["D"], own["d"], np.hstack([each, shared])) @ own["w"][0] + own["w0"]
    return int(legal[np.argmax(scores[legal])])


def _layer(weights: Array, offsets: Array, inputs: Array) -> Array:
    found: Array = np.maximum(inputs @ weights.T + offsets, 0.0)
    return found


def ppo(scan: Scan, prediction: Prediction, *, weights: str | Path = "ppo") -> Hypothesis:
    """The hypothesis at the end of the walk. Raises ValueError as `individual`, and as `walk_by` for bad weights."""
    return walk_by(weights)(scan, prediction)


@cached
def walk_by(weights: str | Path) -> Associator:
    """The associator of weights that ship, by name, or of a `.npz` of one's own. Raises ValueError as
    `slam_gym.weights.load`, and where its arrays do not fit together."""
    arrays = {name: np.asarray(array) for name, array in load(weights, VERSION, INPUTS, SHAPES).arrays.items()}
    candidates, order, compatibility = (int(number) for number in arrays.pop("walk"))
    h, r, s = len(arrays["a"]), len(arrays["c"]), len(arrays["d"])
    fitting = {"A": (h, _ROW), "B": (h, h), "b": (h,), "C": (r, _REST), "D": (s, 2 * h + r), "w": (1, s)}
    for name, shape in fitting.items():
        if arrays[name].shape != shape:
            raise ValueError(f"weights {weights}: {name}: shape {arrays[name].shape}, expected {shape}")
    if not (candidates >= 1 and 0 <= order < len(ORDERS) and 0 <= compatibility < len(COMPATIBILITIES)):
        raise ValueError(f"weights {weights}: walk: no such order or compatibility")
    walk = {"order": ORDERS[order], "compatibility": COMPATIBILITIES[compatibility]}
    policy = functools.partial(_best_branch, arrays)
    return from_policy(policy, candidates=candidates, **walk)  # type: ignore[arg-type]
