"""The tables of the benchmark of locality, and how effort grows: exponents and factors, with intervals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slam_gym.bench.answers import ACCEPTED, count_answers
from slam_gym.bench.locality.hypothesis_count import bound
from slam_gym.bench.locality.sweep import Sweep
from slam_gym.bench.records import Group, Record, column, grouped, means, medians
from slam_gym.metrics.statistics import Interval
from slam_gym.types import Array

_RESAMPLES = 2000
FIXED = 50  # features: the one c of the bound that does not change with the map


class Table(NamedTuple):
    """Rows to be read."""

    title: str
    rows: list[Record]


def localities_table(localities: Sequence[Record]) -> Table:
    """Size, hypotheses of the unpruned tree, and losses."""
    rows = []
    for (name, n, m), group in _points(localities):
        row = group[0]
        sizes = {"mean c": row["mean c"], "max c": row["max c"], f"c={FIXED}": FIXED}
        bounds = {f"9.22 {label}": bound(n, m, c) for label, c in sizes.items()}
        lost = {label: row[label] for label in ("pairs", "pairings", "scans", "anyhow")}
        of_size = {label: row[label] for label in ("mean c", "max c", "N_h")}
        rows.append({"locality": name, "n": n, **of_size, **bounds, "(n+1)^m": (n + 1.0) ** m, **lost})
    return Table("Localities: size, hypotheses of the unpruned tree, fractions of the truth that are lost", rows)


def _points(localities: Sequence[Record]) -> list[tuple[tuple[str, int, int], list[Record]]]:
    return [((k["locality"], k["n"], k["m"]), group) for k, group in grouped(localities, "locality", "n", "m")]


def effort_table(title: str, attempts: Sequence[Record], *settings: str) -> Table:
    """Means per scan, point by point."""
    groups = grouped(attempts, "search", *settings, "locality", "n", "m")
    return Table(f"{title}; means per scan{_ended(attempts)}", [group.key | effort(group.records) for group in groups])


def effort(attempts: list[Record]) -> Record:
    """What scans took and how many were right."""
    right, true = (float(column(attempts, name).sum()) for name in ("right pairings", "true pairings"))
    rates = {"all found": "all right", "pose found": "right", "accepted": "accepted", "limit hit": "limit hit"}
    return {
        "scans": len(attempts),
        **means(attempts, "hypotheses", "nodes", "pairing tests"),
        **medians(attempts, "ms"),
        "pairings found": right / max(true, 1.0),
        **{heading: float(column(attempts, name).mean()) for heading, name in rates.items()},
    }


def _ended(attempts: Sequence[Record]) -> str:
    """Which series were ended, since even a few scans more would have cost too much or searches hit their limit."""
    last = max((a["n"], a["m"]) for a in attempts)
    series = grouped(attempts, "search", "locality")
    reached = {" under ".join(key.values()): max((a["n"], a["m"]) for a in group) for key, group in series}
    ended = [f"{name}: n = {n}, m = {m}" for name, (n, m) in reached.items() if (n, m) != last]
    return "\nended, as the next point would cost too much: " + "; ".join(ended) if ended else ""


def _series(records: Sequence[Record], axis: str, *names: str) -> list[Group]:
    """Records by `names` and with the span of the axis, where there are two points at least."""
    spans = []
    for key, group in grouped(records, *names):
        points = sorted({record[axis] for record in group})
        if len(points) > 1:
            spans.append(Group({**key, axis: f"{points[0]} … {points[-1]}"}, group))
    return spans


def exponents_table(found: Sweep, fitted_from: int) -> Table:
    """Exponents in n: of what was counted, and of what the unpruned tree holds."""
    rng, rows = np.random.default_rng(0), []
    for key, group in _series([a for a in found.attempts if a["n"] >= fitted_from], "n", "search", "locality"):
        rows.append(key | {name: power(group, "n", name, rng) for name in ("nodes", "pairing tests", "ms")})
    for key, group in _series([row for row in found.localities if row["n"] >= fitted_from], "n", "locality"):
        n = [row["n"] for row in group]
        held = {"N_h": [row["N_h"] for row in group]}
        for label in ("mean c", "max c"):
            held[f"9.22, {label}"] = [bound(row["n"], row["m"], row[label]) for row in group]
        held["9.22, one c"] = [bound(row["n"], row["m"], FIXED) for row in group]
        rows.append({"search": "unpruned", **key} | {name: exponent(n, values) for name, values in held.items()})
    return Table(f"Exponents in n, from n = {fitted_from}, with 95 % intervals", rows)


def growth_table(found: Sweep) -> Table:
    """Factors and exponents in m."""
    headings = ("nodes: factor per measurement", "pairing tests: factor", "exponent in m")
    rng, rows = np.random.default_rng(0), []
    for key, group in _series(found.attempts, "m", "search", "locality"):
        factors = [growth(group, "m", name, rng) for name in ("nodes", "pairing tests")]
        rows.append(key | dict(zip(headings, (*factors, power(group, "m", "pairing tests", rng)))))
    for key, group in _series(found.localities, "m", "locality"):
        m, held = [row["m"] for row in group], [row["N_h"] for row in group]
        factor = math.exp(np.polyfit(m, np.log(held), 1)[0])
        rows.append({"search": "N_h", **key, headings[0]: factor, headings[2]: exponent(m, held)})
    return Table("Growth in m", rows)


def answers_table(title: str, judged: Sequence[Record]) -> Table:
    """Right, wrong and none by search, m, and the number of pairings asked for."""
    groups = grouped(judged, "search", "m")
    return Table(title, [
        key | count_answers(group, asked) for key, group in groups for asked in (ACCEPTED, *range(2, key["m"] + 1))
    ])  # fmt: skip


def power(attempts: Sequence[Record], axis: str, name: str, rng: np.random.Generator) -> Interval:
    """Exponent p of the means ∝ axis^p, by least squares on logarithms; 95 % by resampling the scans of each point."""
    points = grouped(attempts, axis)
    return _slope(np.log([float(key[axis]) for key, _ in points]), [column(g, name) for _, g in points], rng)


def growth(attempts: Sequence[Record], axis: str, name: str, rng: np.random.Generator) -> Interval:
    """Factor by which the means grow with each step of one along the axis, likewise."""
    points = grouped(attempts, axis)
    slope = _slope(np.array([float(key[axis]) for key, _ in points]), [column(g, name) for _, g in points], rng)
    return Interval(math.exp(slope.estimate), math.exp(slope.low), math.exp(slope.high))


def exponent(x: Sequence[float], y: Sequence[float]) -> float:
    """p of y ∝ x^p, by least squares on logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _slope(x: Array, values: Sequence[Array], rng: np.random.Generator) -> Interval:
    """Of the logarithms of the means over x; NaN for fewer than two points."""
    if len(x) < 2:
        return Interval(math.nan, math.nan, math.nan)
    resampled = [v[rng.integers(0, len(v), (_RESAMPLES, len(v)))].mean(axis=1) for v in values]
    centred = x - x.mean()
    weights = centred / (centred @ centred)
    drawn = weights @ np.log(np.maximum(resampled, 1e-12))
    estimate = weights @ np.log([max(v.mean(), 1e-12) for v in values])
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Interval(float(estimate), float(low), float(high))
