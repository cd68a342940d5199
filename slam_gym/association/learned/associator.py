"""The learned associator: `marginal` with learned log odds added to every pairing.

The search, the joint density of the innovations and the decision by marginals stay what they are. A small network adds
what that model does not know: whether sizes and kinds agree, how much else competes, how often a feature was seen, how
much of the scan is strange. Its weights ship (`slam_gym.weights`); `python -m agents.reproduce associator` trains them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam_gym.association.learned.inputs import INPUTS, VERSION, inputs_of
from slam_gym.association.learned.network import Network, load_network, log_odds
from slam_gym.association.tracking.marginal import marginal
from slam_gym.association.tree import Tree
from slam_gym.types import UNKNOWN_KIND, Array, Hypothesis, Prediction, Scan

WEIGHTS = "associator"
_COST, _PROVISIONAL = 10.0, 3.0


@dataclass(frozen=True, eq=False)
class LearnedOdds:
    """Log odds of the pairings of a tree, by a network."""

    network: Network

    def __call__(self, tree: Tree, visibility: Array | None) -> Array:
        pairings = tree.pairings
        return log_odds(self.network, inputs_of(tree, visibility), pairings.measured, pairings.slots)


def learned_odds(weights: str | Path = WEIGHTS) -> LearnedOdds:
    """The odds by weights that ship, or by a `.npz` of one's own. Raises ValueError as `load_network`."""
    return LearnedOdds(load_network(weights, VERSION, INPUTS))


def learned_associator(
    scan: Scan,
    prediction: Prediction,
    *,
    cost: float = _COST,
    provisional_cost: float = _PROVISIONAL,
    weights: str | Path = WEIGHTS,
    width: int = 100,
) -> Hypothesis:
    """As `marginal`, which explains costs and `width`; with the log odds of `weights` besides.

    The network knows that what was seen once may be clutter. Probabilities that say so are calibrated, but a robot that
    went by them at full cost would never confirm what is new: hence the lower `provisional_cost`.

    Where nobody tells what is in view, and no measurement has a size or a kind, there is little but places to go by,
    which `marginal` knows all about: it decides alone, at full cost.

    Raises ValueError as `marginal`, and as `load_network` where there are no such weights.
    """
    if not _told_more(scan, prediction):
        return marginal(scan, prediction, cost=cost, width=width)
    least, odds = min(cost, provisional_cost), learned_odds(weights)
    return marginal(scan, prediction, cost=cost, provisional_cost=least, width=width, learned=odds)


def _told_more(scan: Scan, prediction: Prediction) -> bool:
    """Whether anything but places is known."""
    return bool(prediction.view is not None or np.isfinite(scan.sizes).any() or (scan.kinds != UNKNOWN_KIND).any())
