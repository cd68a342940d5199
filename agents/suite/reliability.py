"""Does what an associator calls probable come true so often? Its decisions in bins of the probability it gives them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from agents.evaluation.records import Record
from agents.evaluation.tables import Column, Table, Value, by_name, estimate
from slam_gym.metrics.statistics import mean
from slam_gym.types import Array, Hypothesis, IntArray

EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 0.99, 0.999, 1.0)
"""Of the bins: narrow where most decisions lie, and where mistakes are dear."""

COLUMNS = (
    Column("decisions", "decisions", 0), Column("predicted", "mean probability", 3), Column("right", "rate right", 3),
)  # fmt: skip

_PROMISE = ("promised", "kept")
PROMISE_COLUMNS = (Column("promised", "probability", 3), Column("kept", "right", 3))
_CEILING = "mean probability of the best hypothesis of a scan, and how often it is right"


def binned(answers: Sequence[Hypothesis], right: Sequence[IntArray]) -> dict[str, list[float]]:
    """The decisions of hypotheses that say how probable each is, held against the right ones (m,), `*` included."""
    told = [(h.posterior.marginals, h.features == r) for h, r in zip(answers, right)
            if h.posterior is not None and h.posterior.marginals is not None]  # fmt: skip
    p: Array = np.concatenate([np.empty(0), *(marginals for marginals, _ in told)])
    hit = np.concatenate([np.empty(0, np.bool_), *(agreed for _, agreed in told)])
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
    return {"promised": float(np.mean(p)), "kept": float(np.mean(hit))} if p else dict.fromkeys(_PROMISE, math.nan)


def promise_tables(records: Sequence[Record]) -> list[Table]:
    """One an associator that says how probable its hypotheses are: a row an experiment, and each level of drift."""
    found = []
    for name, own in by_name(records, "associator").items():
        told = [r for r in own if math.isfinite(r.get("promised") or math.nan)]
        groups = {e: [r for r in told if r["experiment"] == e] for e in dict.fromkeys(r["experiment"] for r in told)}
        drifts = dict.fromkeys(r["setting"] for r in told if r["experiment"] == "drift")
        groups |= {level: [r for r in told if r["setting"] == level] for level in drifts}
        rows: dict[str, dict[str, Value]] = {
            group: {key: estimate(np.array([r[key] for r in some], dtype=float), statistic=mean) for key in _PROMISE}
            for group, some in groups.items()
        }
        if rows:
            found.append(Table(f"ceiling by the word of {name}", "scans", PROMISE_COLUMNS, rows, _CEILING))
    return found


def together(records: Sequence[Record]) -> dict[str, Array]:
    """The bins (8,) of all records: number of decisions, mean probability and rate right, NaN in an empty bin."""
    sums = {key: np.zeros(len(EDGES) - 1) for key in ("decisions", "predicted", "right")}
    for record in records:
        for key, values in (record.get("reliability") or {}).items():
            sums[key] += np.array(values)
    count = np.where(sums["decisions"] > 0, sums["decisions"], math.nan)
    return {"decisions": sums["decisions"], "predicted": sums["predicted"] / count, "right": sums["right"] / count}


def by_associator(records: Sequence[Record]) -> dict[str, dict[str, Array]]:
    """`together` of each associator that says how probable its decisions are."""
    found = {name: together(own) for name, own in by_name(records, "associator").items()}
    return {name: bins for name, bins in found.items() if bins["decisions"].any()}


def tables(records: Sequence[Record]) -> list[Table]:
    """One an associator: a row a bin."""
    found = []
    for name, bins in by_associator(records).items():
        rows: dict[str, dict[str, Value]] = {
            f"{low:g} to {high:g}": {key: float(values[k]) for key, values in bins.items()}
            for k, (low, high) in enumerate(pairwise(EDGES))
            if bins["decisions"][k]
        }
        found.append(Table(f"reliability of {name}", "probability", COLUMNS, rows, "of all decisions, `*` included"))
    return found
