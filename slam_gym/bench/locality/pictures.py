"""The pictures of the benchmark of locality."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from slam_gym.bench.figures import BLUE, BROWN, GREEN, GREY, INK, PURPLE, RED, YELLOW, legend_below, panels, proportions
from slam_gym.bench.locality.effort_tables import FIXED
from slam_gym.bench.locality.fields import LOCALITIES
from slam_gym.bench.locality.hypothesis_count import bound
from slam_gym.bench.locality.sweep import Sweep
from slam_gym.bench.records import Record, column, grouped
from slam_gym.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = dict(zip(LOCALITIES, (BLUE, GREEN, YELLOW, PURPLE, BROWN, RED)))
MARKS = dict(zip(LOCALITIES, "os^DPX"))
NAMES = {"within 2r": "within $2r$", "two hops": "covisibility, two hops", "joined maps": "local maps, joined"}
WIDTH = 3.9  # [inches] of a panel


def effort(found: Sweep, axis: str, fixed: str) -> Figure:
    """Pairing tests against n or m, of each search under each locality, beside the bound."""
    searches = grouped(found.attempts, "search")
    figure, axes = panels(1, len(searches) + 1, (WIDTH * (len(searches) + 1), 3.9))
    ticks = sorted({row[axis] for row in found.localities})
    for ax, (key, attempts) in zip(axes[0], searches):
        series(ax, attempts, axis, "pairing tests")
        ax.set(title=f"{key['search']}: pairing tests per scan", yscale="log")
        size_axis(ax, axis, ticks)
        if axis == "n":
            slopes(ax)
    axes[0][1].sharey(axes[0][0])
    searched = {attempt["locality"] for attempt in found.attempts}
    bounds(axes[0][-1], [row for row in found.localities if row["locality"] in searched], axis)
    axes[0][-1].set_title(f"hypotheses, {fixed}")
    size_axis(axes[0][-1], axis, ticks)
    legend_below(figure, axes[0][0])
    return figure


def series(ax: Axes, attempts: Sequence[Record], axis: str, name: str) -> None:
    """Mean and middle half of the scans, one line per locality. Hollow where searches ended at their limit."""
    for key, line in grouped(attempts, "locality"):
        locality, points = key["locality"], grouped(line, axis)
        colour, x = COLOURS[locality], [of[axis] for of, _ in points]
        low, mean, high = np.array([_spread(column(group, name)) for _, group in points]).T
        ax.fill_between(x, np.maximum(low, 1.0), np.maximum(high, 1.0), alpha=0.12, lw=0, color=colour, zorder=3)
        ax.plot(x, mean, lw=1.6, color=colour, zorder=3)
        for k, (_, group) in enumerate(points):
            face = "white" if column(group, "limit hit").any() else colour
            label = NAMES.get(locality, locality) if k == 0 else None
            ax.plot(x[k], mean[k], MARKS[locality], ms=5, mfc=face, mec=colour, label=label, zorder=4)


def _spread(values: Array) -> tuple[float, float, float]:
    low, high = np.quantile(values, [0.25, 0.75])
    return float(low), float(values.mean()), float(high)


def size_axis(ax: Axes, axis: str, sizes: Sequence[int]) -> None:
    """Ticks at what was measured: of measurements all, of map sizes, on a logarithmic axis, all or every other one."""
    if axis == "m":
        ax.set(xlabel="measurements in the scan, $m$", xticks=sizes)
        return
    shown = sizes if len(sizes) < 7 else sizes[::2]
    ax.set(xscale="log", xlabel="features in the map, $n$")
    ax.set_xticks(shown, [str(n) for n in shown])
    ax.set_xticks([], minor=True)


def slopes(ax: Axes) -> None:
    """Guides that grow as n and as n², in the corner."""
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    start, end = x0 * (x1 / x0) ** 0.68, x0 * (x1 / x0) ** 0.93
    base = y0 * (y1 / y0) ** 0.06
    for power, label in ((1, " $n$"), (2, " $n^2$")):
        top = base * (end / start) ** power
        ax.plot([start, end], [base, top], color=GREY, lw=1.2, zorder=1)
        ax.text(end, top, label, va="center", color="#7a828c", fontsize=8)


def bounds(ax: Axes, localities: Sequence[Record], axis: str) -> None:
    """N_h of the unpruned tree under each locality, (9.22) by the c it is given, and (n + 1)^m."""
    lines = {key["locality"]: line for key, line in grouped(localities, "locality")}
    for name, line in lines.items():
        style: dict[str, Any] = {"marker": MARKS[name], "ls": "-", "ms": 4, "lw": 1.4, "color": COLOURS[name]}
        ax.plot([row[axis] for row in line], [row["N_h"] for row in line], **style)
    line = lines["covisibility"]
    x = [row[axis] for row in line]
    for name, dashes, label in (
        ("max c", "--", "max $c$, covisibility"),
        ("mean c", ":", "mean $c$, covisibility"),
        ("", "-.", f"$c = {FIXED}$"),
    ):
        values = [bound(row["n"], row["m"], row[name] if name else FIXED) for row in line]
        ax.plot(x, values, dashes, color=INK, lw=1.1, label=f"(9.22), {label}")
    ax.set_yscale("log")
    words: dict[str, Any] = {"ha": "right", "va": "bottom", "color": COLOURS["everything"], "fontsize": 8}
    ax.text(x[-1], localities[-1]["N_h"], "$(n+1)^m$ ", **words)
    ax.legend(loc="upper left", fontsize=8)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high * (high / low) ** 0.22)


def losses(localities: Sequence[Record]) -> Figure:
    """What each locality loses before any test, by size of the map."""
    titles = {
        "pairs": "pairs of one scan that are not local",
        "pairings": "true pairings out of reach",
        "scans": "scans that cannot be paired whole",
    }
    figure, axes = panels(1, len(titles), (WIDTH * len(titles), 3.4))
    for ax, (name, title) in zip(axes[0], titles.items()):
        for key, line in grouped(localities, "locality"):
            style: dict[str, Any] = {"ls": "-", "ms": 5, "lw": 1.5, "color": COLOURS[key["locality"]]}
            label = NAMES.get(key["locality"], key["locality"])
            values = [100.0 * row[name] for row in line]
            ax.plot([row["n"] for row in line], values, MARKS[key["locality"]], label=label, **style)
        ax.set(title=title, ylabel="[%]")
        size_axis(ax, "n", sorted({row["n"] for row in localities}))
        ax.set_ylim(-0.02 * max(ax.get_ylim()[1], 10.0), None)
    legend_below(figure, axes[0][0])
    return figure


CURVES = (
    ("right of inside", "inside: right", GREEN, "o"),
    ("wrong of inside", "inside: wrong", YELLOW, "^"),
    ("wrong of outside", "outside: wrong", RED, "X"),
    ("at one pose", "outside: wrong, at one pose only", PURPLE, "s"),
)
"""Fractions of answers, with their name, colour and mark."""


def answers(counts: Sequence[Record], title: str) -> Figure:
    """Right and wrong answers inside, wrong ones outside, by the number of pairings asked for."""
    names, sizes = ([key[of] for key, _ in grouped(counts, of)] for of in ("search", "m"))
    size = (3.4 * len(sizes), 2.6 * len(names) + 0.5)
    figure, axes = panels(len(names), len(sizes), size, sharey=True)
    for key, rows in grouped(counts, "search", "m"):
        ax = axes[names.index(key["search"])][sizes.index(key["m"])]
        for k, (name, label, colour, mark) in enumerate(CURVES):
            proportions(ax, rows, name, shift=0.1 * (k - 1.5), color=colour, marker=mark, label=label)
        ax.set(title=f"{key['search']}, $m = {key['m']}$", ylim=(-0.03, 1.03))
    for ax in axes[-1]:
        ax.set_xlabel("pairings asked for")
    for row in axes:
        row[0].set_ylabel("fraction of scans")
    legend_below(figure, axes[0][0])
    figure.suptitle(f"{title}; bars: 95 %", fontsize=9)
    return figure
