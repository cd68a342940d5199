"""The pictures of the benchmark of locality. The only module of it that needs matplotlib."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slam_gym.bench.locality.acceptance import RULE, Outcome, share
from slam_gym.bench.locality.bound import bound
from slam_gym.bench.locality.sweep import Cell, Reach
from slam_gym.bench.locality.tables import FIXED, JUDGED, Results
from slam_gym.bench.locality.worlds import LOCALITIES

INK, GREY = "#2f3640", "#b8bec6"
COLOURS = dict(zip(LOCALITIES, ("#2b6ca3", "#3a8a5c", "#e0a030", "#7d5ba6", "#9c755f", "#c8553d")))
MARKS = dict(zip(LOCALITIES, "os^DPX"))
NAMES = {"within 2r": "within $2r$", "two hops": "covisibility, two hops", "joined maps": "local maps, joined"}
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": GREY,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "savefig.dpi": 150,
}


def save(results: Results, folder: Path) -> None:
    """Write map_size.png, measurements.png, losses.png and answers.png."""
    pictures: dict[str, Callable[[], Figure]] = {
        "map_size": lambda: against_map(results),
        "measurements": lambda: against_measurements(results),
        "losses": lambda: losses(results.maps[1]),
        "answers": lambda: answers(results.answers),
    }
    for name, draw in pictures.items():
        with matplotlib.rc_context(STYLE):
            draw().savefig(folder / f"{name}.png")


def against_map(results: Results) -> Figure:
    """Pairing tests against n, of each search under each locality, beside the bound."""
    cells, reaches = results.maps
    names = list(dict.fromkeys(cell.search for cell in cells))
    figure, axes = _panels(len(names) + 1, 3.9)
    for ax, name in zip(axes, names):
        series(ax, [c for c in cells if c.search == name], lambda c: c.n, "tests")
        ax.set(title=f"{name}: pairing tests per scan", yscale="log")
        map_axis(ax, results.size.maps)
        slopes(ax)
    axes[1].sharey(axes[0])
    bounds(axes[-1], _searched(reaches, cells), lambda r: r.n)
    axes[-1].set_title(f"hypotheses, $m = {results.m}$")
    map_axis(axes[-1], results.size.maps)
    legend(figure, axes[0])
    return figure


def against_measurements(results: Results) -> Figure:
    """Pairing tests against m, likewise."""
    cells, reaches = results.measurements
    names = list(dict.fromkeys(cell.search for cell in cells))
    figure, axes = _panels(len(names) + 1, 3.9)
    for ax, name in zip(axes, names):
        series(ax, [c for c in cells if c.search == name], lambda c: c.m, "tests")
        ax.set(title=f"{name}: pairing tests per scan", yscale="log")
        ax.set(xlabel="measurements in the scan, $m$", xticks=results.size.measurements)
    axes[1].sharey(axes[0])
    bounds(axes[-1], _searched(reaches, cells), lambda r: r.m)
    axes[-1].set(title=f"hypotheses, $n = {results.size.fixed}$", xlabel="measurements in the scan, $m$")
    axes[-1].set_xticks(results.size.measurements)
    legend(figure, axes[0])
    return figure


def series(ax: Axes, cells: Sequence[Cell], axis: Callable[[Cell], float], name: str) -> None:
    """Mean and middle half of the scans, one line per locality. Hollow where searches ended at their limit."""
    for locality in LOCALITIES:
        line = [cell for cell in cells if cell.locality == locality]
        if not line:
            continue
        x = [axis(cell) for cell in line]
        style: dict[str, Any] = {"color": COLOURS[locality], "zorder": 3}
        low, high = (np.array([np.quantile(cell.values[name], q) for cell in line]) for q in (0.25, 0.75))
        ax.fill_between(x, np.maximum(low, 1.0), np.maximum(high, 1.0), alpha=0.12, lw=0, **style)
        ax.plot(x, [cell.mean(name) for cell in line], lw=1.6, **style)
        full = [not cell.mean("limit") for cell in line]
        for k, cell in enumerate(line):
            face = COLOURS[locality] if full[k] else "white"
            label = NAMES.get(locality, locality) if k == 0 else None
            ax.plot(
                x[k], cell.mean(name), MARKS[locality], ms=5, mfc=face, mec=COLOURS[locality], label=label, zorder=4
            )


def map_axis(ax: Axes, sizes: Sequence[int]) -> None:
    """A logarithmic axis of map sizes, with ticks at those measured: all, or every other one."""
    shown = sizes if len(sizes) < 7 else sizes[::2]
    ax.set(xscale="log", xlabel="features in the map, $n$")
    ax.set_xticks(shown, [str(n) for n in shown])
    ax.set_xticks([], minor=True)


def slopes(ax: Axes) -> None:
    """Guides that grow as n and as n², in the corner."""
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    start, end = x0 * (x1 / x0) ** 0.68, x0 * (x1 / x0) ** 0.93
    base = y0 * (y1 / y0) ** 0.06
    for power in (1, 2):
        top = base * (end / start) ** power
        ax.plot([start, end], [base, top], color=GREY, lw=1.2, zorder=1)
        ax.text(end, top, " $n$" if power == 1 else " $n^2$", va="center", color="#7a828c", fontsize=8)


def bounds(ax: Axes, reaches: Sequence[Reach], axis: Callable[[Reach], int]) -> None:
    """N_h of the unpruned tree under each locality, (9.22) by the c it is given, and (n + 1)^m."""
    for name in dict.fromkeys(r.locality for r in reaches):
        line = [r for r in reaches if r.locality == name]
        ax.plot(
            [axis(r) for r in line],
            [r.hypotheses for r in line],
            MARKS[name],
            ls="-",
            ms=4,
            lw=1.4,
            color=COLOURS[name],
        )
    line = [r for r in reaches if r.locality == "covisibility"]
    x = [axis(r) for r in line]
    for c, style, label in (
        ([r.largest_size for r in line], "--", "max $c$, covisibility"),
        ([r.mean_size for r in line], ":", "mean $c$, covisibility"),
        ([FIXED] * len(line), "-.", f"$c = {FIXED}$"),
    ):
        values = [bound(r.n, r.m, size) for r, size in zip(line, c)]
        ax.plot(x, values, style, color=INK, lw=1.1, label=f"(9.22), {label}")
    ax.set_yscale("log")
    ax.text(
        x[-1], reaches[-1].hypotheses, "$(n+1)^m$ ", ha="right", va="bottom", color=COLOURS["everything"], fontsize=8
    )
    ax.legend(loc="upper left", fontsize=8)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * (high / low) ** 0.22)


def _searched(reaches: Sequence[Reach], cells: Sequence[Cell]) -> list[Reach]:
    return [r for r in reaches if r.locality in {cell.locality for cell in cells}]


def losses(reaches: Sequence[Reach]) -> Figure:
    """What each locality loses before any test, by size of the map."""
    figure, axes = _panels(3, 3.4)
    titles = (
        ("pairs", "pairs of one scan that are not local"),
        ("pairings", "true pairings out of reach"),
        ("scans", "scans that cannot be paired whole"),
    )
    for ax, (name, title) in zip(axes, titles):
        for locality in LOCALITIES:
            line = [r for r in reaches if r.locality == locality]
            values = [100.0 * getattr(r, name) for r in line]
            label = NAMES.get(locality, locality)
            ax.plot(
                [r.n for r in line], values, MARKS[locality], ls="-", ms=5, lw=1.5, color=COLOURS[locality], label=label
            )
        ax.set(title=title, ylabel="[%]")
        map_axis(ax, sorted({r.n for r in reaches}))
        ax.set_ylim(-0.02 * max(ax.get_ylim()[1], 10.0), None)
    legend(figure, axes[0])
    return figure


def answers(found: dict[tuple[str, int], list[Outcome]]) -> Figure:
    """Right and wrong answers inside, wrong ones outside, against the least number of pairings."""
    names, sizes = (list(dict.fromkeys(key[k] for key in found)) for k in (0, 1))
    figure = Figure(figsize=(3.4 * len(sizes), 2.6 * len(names) + 0.5), layout="constrained")
    axes = figure.subplots(len(names), len(sizes), sharey=True, squeeze=False)
    for (name, m), rows in found.items():
        ax = axes[names.index(name)][sizes.index(m)]
        _answer_curves(ax, rows)
        ax.set_title(f"{name}, $m = {m}$")
        if name == names[-1]:
            ax.set_xlabel("pairings asked for")
        if m == sizes[0]:
            ax.set_ylabel("share of scans")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    figure.suptitle(f"answers under {NAMES.get(JUDGED, JUDGED)}, $n = 400$; bars: 95 %", fontsize=9)
    return figure


def _answer_curves(ax: Axes, rows: Sequence[Outcome]) -> None:
    by_count = [row for row in rows if row.least != RULE]
    rule = next(row for row in rows if row.least == RULE)
    right_end = by_count[-1].least + 1.2
    parts: list[tuple[str, str, str, Callable[[Outcome], tuple[int, int]]]] = [
        ("inside: right", "#3a8a5c", "o", lambda r: (r.right, r.inside)),
        ("inside: wrong", "#e0a030", "^", lambda r: (r.wrong, r.inside)),
        ("outside: wrong", "#c8553d", "X", lambda r: (r.wrong_outside, r.outside)),
        ("outside: wrong, at one pose only", "#7d5ba6", "s", lambda r: (r.alone_outside, r.outside)),
    ]
    for k, (label, colour, mark, counts) in enumerate(parts):
        intervals = [share(*counts(row)) for row in (*by_count, rule)]
        x = np.array([*(row.least for row in by_count), right_end]) + 0.1 * (k - 1.5)
        y = np.array([i.estimate for i in intervals])
        bars: Any = np.array([[i.estimate - i.low for i in intervals], [i.high - i.estimate for i in intervals]])
        ax.errorbar(x, y, bars, fmt=mark, ms=4, lw=1.0, color=colour, capsize=1.5, label=label)
        ax.plot(x[:-1], y[:-1], color=colour, lw=1.4)
    ax.axvline(right_end - 0.6, color=GREY, lw=0.8)
    ticks = [row.least for row in by_count]
    ax.set_xticks([*ticks, right_end], [*map(str, ticks), "rule"])
    ax.set_ylim(-0.03, 1.03)


def legend(figure: Figure, ax: Axes) -> None:
    """One for all panels, below them."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))


def _panels(count: int, height: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(3.9 * count, height), layout="constrained")
    return figure, list(np.atleast_1d(np.asarray(figure.subplots(1, count))))
