"""The tables of the benchmark of locality."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slam_gym.bench.locality.acceptance import RULE, Outcome, text
from slam_gym.bench.locality.bound import bound
from slam_gym.bench.locality.sweep import Cell, Reach, growth, power
from slam_gym.bench.locality.worlds import LOCALITIES
from slam_gym.metrics.statistics import Interval

LARGE = 800  # features: exponents are fitted from here
FIXED = 50  # features: the one c of the bound that does not change with the map
JUDGED = "two hops"  # locality under which answers are judged

Table = tuple[list[str], list[list[str]]]
"""Columns and rows."""


@dataclass(frozen=True)
class Size:
    """How much is run."""

    maps: tuple[int, ...]
    measurements: tuple[int, ...]
    fixed: int  # features while m varies
    scans: int
    tests: float  # pairing tests per cell
    judged: int  # scans inside, and as many outside, for each m
    judged_measurements: tuple[int, ...] = (6, 8, 10)


@dataclass
class Results:
    """All that a run of the benchmark finds."""

    size: Size
    m: int
    bound: list[dict[str, Any]] = field(default_factory=list)
    maps: tuple[list[Cell], list[Reach]] = ([], [])
    measurements: tuple[list[Cell], list[Reach]] = ([], [])
    settings: list[tuple[str, Cell]] = field(default_factory=list)
    answers: dict[tuple[str, int], list[Outcome]] = field(default_factory=dict)


def tables(results: Results) -> list[tuple[str, list[str], list[list[str]]]]:
    """Title, columns and rows of each table to print."""
    cells, reaches = results.maps
    more, further = results.measurements
    return [
        ("Equation 9.22 against hypotheses counted one by one", *_bound_table(results.bound)),
        (
            f"Localities, m = {results.m}: size, hypotheses of the unpruned tree, true pairings lost",
            *_reach_table(reaches),
        ),
        (f"Effort against the size of the map, m = {results.m}; means per scan{_ends(cells)}", *_effort_table(cells)),
        (f"Exponents in n, from n = {LARGE}, with 95 % intervals", *_exponents(cells)),
        ("Exponents in n of what the unpruned tree holds", *_bound_exponents(reaches, results.m)),
        (f"Effort against the number of measurements, n = {results.size.fixed}{_ends(more)}", *_effort_table(more)),
        ("Growth in m", *_growth(more, further)),
        (
            f"Gates, and the order of measurements, n = {results.size.fixed}, m = {results.m}",
            *_settings_table(results.settings),
        ),
        (f"Answers by the least number of pairings, n = 400, {JUDGED}", *_answers_table(results.answers)),
    ]


def _bound_table(rows: list[dict[str, Any]]) -> Table:
    shown = [row for row in rows if row["m"] == max(row["m"] for row in rows)]
    return list(shown[0]), [[_number(value) for value in row.values()] for row in shown]


def _reach_table(reaches: list[Reach]) -> Table:
    columns = ["locality", "n", "mean c", "max c", "N_h", "9.22 mean c", "9.22 max c", f"9.22 c={FIXED}", "(n+1)^m"]
    rows = [
        [
            r.locality,
            str(r.n),
            f"{r.mean_size:.1f}",
            f"{r.largest_size:.0f}",
            *(f"{v:.1e}" for v in (r.hypotheses, bound(r.n, r.m, r.mean_size), bound(r.n, r.m, r.largest_size))),
            *(f"{v:.1e}" for v in (bound(r.n, r.m, FIXED), (r.n + 1.0) ** r.m)),
            *(f"{100.0 * v:.1f} %" for v in (r.pairs, r.pairings, r.scans, r.anyhow)),
        ]
        for r in sorted(reaches, key=lambda r: LOCALITIES.index(r.locality))
    ]
    return [*columns, "pairs", "pairings", "scans", "anyhow"], rows


def _ends(cells: list[Cell]) -> str:
    """Which series were ended, since even a few scans more would have cost too much or searches hit their limit."""
    last = max((cell.n, cell.m) for cell in cells)
    reached = {(cell.search, cell.locality): (cell.n, cell.m) for cell in cells}
    ended = [f"{search}, {name}: n = {n}, m = {m}" for (search, name), (n, m) in reached.items() if (n, m) != last]
    return "\nended, as the next cell would cost too much: " + "; ".join(ended) if ended else ""


def _effort_table(cells: list[Cell]) -> Table:
    columns = ["search", "locality", "n", "m", "scans", "hypotheses", "nodes", "pairing tests", "median ms"]
    order = sorted(cells, key=lambda c: (c.search, LOCALITIES.index(c.locality)))
    rows = [
        [
            *(c.search, c.locality, str(c.n), str(c.m), str(len(c))),
            f"{c.mean('hypotheses'):.1f}",
            f"{c.mean('nodes'):.0f}",
            f"{c.mean('tests'):.3g}",
            f"{np.median(c.array('ms')):.2f}",
            *(f"{v:.2f}" for v in (c.recall, c.whole, c.mean("found"))),
            f"{c.mean('limit'):.2f}" if c.mean("limit") else "",
        ]
        for c in order
    ]
    return [*columns, "pairings found", "all found", "pose found", "limit hit"], rows


def _exponents(cells: list[Cell]) -> Table:
    rng, rows = np.random.default_rng(0), []
    for search in dict.fromkeys(c.search for c in cells):
        for name in LOCALITIES:
            series = [c for c in cells if (c.search, c.locality) == (search, name) and c.n >= LARGE]
            if len(series) > 1:
                fits = [power(series, lambda c: c.n, measure, rng) for measure in ("nodes", "tests", "ms")]
                rows.append([search, name, f"{series[0].n} … {series[-1].n}", *(_interval(fit) for fit in fits)])
    return ["search", "locality", "n", "nodes", "pairing tests", "time"], rows


def _bound_exponents(reaches: list[Reach], m: int) -> Table:
    rows = []
    for name in LOCALITIES:
        series = [r for r in reaches if r.locality == name and r.n >= LARGE]
        if len(series) > 1:
            x = np.log([r.n for r in series])
            fit = [np.polyfit(x, np.log(y), 1)[0] for y in _allowed(series, m)]
            rows.append([name, f"{series[0].n} … {series[-1].n}", *(f"{f:.2f}" for f in fit)])
    return ["locality", "n", "N_h", "9.22, mean c", "9.22, max c", "9.22, one c"], rows


def _allowed(series: list[Reach], m: int) -> list[list[float]]:
    return [
        [r.hypotheses for r in series],
        [bound(r.n, m, r.mean_size) for r in series],
        [bound(r.n, m, r.largest_size) for r in series],
        [bound(r.n, m, FIXED) for r in series],
    ]


def _growth(cells: list[Cell], reaches: list[Reach]) -> Table:
    rng, rows = np.random.default_rng(0), []
    for search in dict.fromkeys(c.search for c in cells):
        for name in LOCALITIES:
            series = [c for c in cells if (c.search, c.locality) == (search, name)]
            if len(series) > 1:
                fits = [growth(series, measure, rng) for measure in ("nodes", "tests")]
                exponent = power(series, lambda c: c.m, "tests", rng)
                span = f"{series[0].m} … {series[-1].m}"
                rows.append([search, name, span, *(_interval(fit) for fit in (*fits, exponent))])
    for name in LOCALITIES:
        series_ = [r for r in reaches if r.locality == name]
        if len(series_) > 1:
            m = np.array([r.m for r in series_])
            y = np.log([r.hypotheses for r in series_])
            fit = (math.exp(np.polyfit(m, y, 1)[0]), np.polyfit(np.log(m), y, 1)[0])
            rows.append(["N_h", name, f"{m[0]} … {m[-1]}", f"{fit[0]:.2f}", "", f"{fit[1]:.2f}"])
    return ["search", "locality", "m", "nodes: factor per measurement", "pairing tests: factor", "exponent in m"], rows


def _settings_table(rows: list[tuple[str, Cell]]) -> Table:
    shown = [
        [
            *(c.search, label, c.locality, str(len(c)), f"{c.mean('nodes'):.0f}", f"{c.mean('tests'):.3g}"),
            *(f"{np.median(c.array('ms')):.2f}", f"{c.recall:.2f}", f"{c.whole:.2f}", f"{c.mean('accepted'):.2f}"),
        ]
        for label, c in sorted(rows, key=lambda row: (row[1].search, LOCALITIES.index(row[1].locality)))
    ]
    columns = ["search", "setting", "locality", "scans", "nodes", "pairing tests", "median ms"]
    return [*columns, "pairings found", "all found", "accepted"], shown


def _answers_table(answers: dict[tuple[str, int], list[Outcome]]) -> Table:
    columns = ["search", "m", "pairings", "right", "wrong", "none", "right of inside", "wrong of inside"]
    rows = [
        [
            *(name, str(m), "rule" if o.least == RULE else f">= {o.least}"),
            *(str(count) for count in (o.right, o.wrong, o.silent)),
            *(text(o.right, o.inside), text(o.wrong, o.inside)),
            *(str(o.wrong_outside), str(o.silent_outside), text(o.wrong_outside, o.outside)),
            text(o.alone_outside, o.outside),
        ]
        for (name, m), found in answers.items()
        for o in found
    ]
    return [*columns, "outside: wrong", "none", "wrong of outside", "at one pose"], rows


def _interval(fit: Interval) -> str:
    return f"{fit.estimate:.2f} [{fit.low:.2f}, {fit.high:.2f}]"


def _number(value: Any) -> str:
    return (
        {True: "yes", False: "NO"}[value]
        if isinstance(value, bool)
        else f"{value:.6g}"
        if isinstance(value, float)
        else str(value)
    )


def show(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, its columns as wide as they need to be."""
    widths = [max(len(row[k]) for row in (columns, *rows)) for k in range(len(columns))]
    words = [all(not row[k][:1].isdigit() for row in rows) for k in range(len(columns))]
    print(f"\n{title}")
    for row in (columns, *rows):
        cells = [text.ljust(w) if word else text.rjust(w) for text, w, word in zip(row, widths, words)]
        print("  ".join(cells).rstrip())
