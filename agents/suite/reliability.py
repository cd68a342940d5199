"""Does what an associator calls probable come true so often? Its decisions in bins of the probability it gives them."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pandas as pd

from agents.evaluation.tables import Column, Table, by_name
from slam_gym.types import Array, Hypothesis, IntArray

EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 0.99, 0.999, 1.0)
"""Of the bins: narrow where most decisions lie, and where mistakes are dear."""

COLUMNS = (
    Column("decisions", "decisions", 0), Column("predicted", "mean probability", 3), Column("right", "rate right", 3),
)  # fmt: skip


def binned(answers: Sequence[Hypothesis], right: Sequence[IntArray]) -> dict[str, list[float]]:
    """The decisions of hypotheses that say how probable each is, held against the right ones (m,), `*` included."""
    decisions = [(h.posterior.marginals, h.features == r) for h, r in zip(answers, right)
            if h.posterior is not None and h.posterior.marginals is not None]  # fmt: skip
    p: Array = np.concatenate([np.empty(0), *(marginals for marginals, _ in decisions)])
    hit = np.concatenate([np.empty(0, np.bool_), *(agreed for _, agreed in decisions)])
    number = np.clip(np.searchsorted(EDGES, p, side="right") - 1, 0, len(EDGES) - 2)
    weights = {"decisions": np.ones(len(p)), "predicted": p, "right": hit.astype(np.float64)}
    return {key: np.bincount(number, value, len(EDGES) - 1).tolist() for key, value in weights.items()}


def promised(answers: Sequence[Hypothesis], right: Sequence[IntArray]) -> dict[str, float]:
    """Of scans: the mean probability of the best hypothesis, and the rate at which it is right, `*` included; NaN where
    nobody says how probable it is.

    Where the posterior is calibrated the two agree, and no matcher of single scans is exact more often.
    """
    p, hit = [], []
    for h, r in zip(answers, right):
        if h.posterior is not None:
            own = h.posterior.probability >= h.posterior.runner_up_probability
            best = h.features if own else h.posterior.runner_up
            p.append(max(h.posterior.probability, h.posterior.runner_up_probability))
            hit.append(bool((best == r).all()))
    return (
        {"promised": float(np.mean(p)), "kept": float(np.mean(hit))} if p else {"promised": math.nan, "kept": math.nan}
    )


def reliability(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Associator → a row for each bin in which it has decisions: their number, mean probability and rate right.

    Without those that do not say how probable their decisions are.
    """
    bins, found = [f"{low:g} to {high:g}" for low, high in pairwise(EDGES)], {}
    for name, own in by_name(frame).items():
        total = sum(pd.DataFrame(json.loads(cell), bins) for cell in own["reliability"])
        if (known := total[total["decisions"] > 0]).size:
            found[name] = known.div(known["decisions"], axis=0).assign(decisions=known["decisions"])
    return found


def reliability_tables(frame: pd.DataFrame) -> list[Table]:
    """One an associator: a row a bin."""
    caption = "of all decisions, `*` included"
    return [
        Table(f"reliability of {name}", "probability", COLUMNS, bins.to_dict("index"), caption)
        for name, bins in reliability(frame).items()
    ]
