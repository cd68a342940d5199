"""The figures of a report, as PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter
from numpy.typing import NDArray

from agents.evaluation.results import Record, estimate, values_of

COLOURS = ("#8a97a6", "#e08e45", "#3f9b7b", "#2f6db5", "#b04a8b", "#c6a02c", "#6554a4", "#a4503e")
POINTS = 61  # of a curve

matplotlib.rcParams.update({
    "font.family": "DejaVu Sans", "font.size": 10, "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": "#9aa5b1", "axes.labelcolor": "#3c4856", "xtick.color": "#5d6b7a", "ytick.color": "#5d6b7a",
    "axes.grid": True, "grid.color": "#e6ebf0", "axes.axisbelow": True,
})  # fmt: skip


def colour_of(agents: Sequence[str], agent: str) -> str:
    """The colour of an agent throughout a report."""
    return COLOURS[list(agents).index(agent) % len(COLOURS)]


def interval_chart(records: Sequence[Record], agents: Sequence[str]) -> bytes:
    """Every episode as a dot, with mean and interval of each agent, for map error and coverage."""
    figure = Figure(figsize=(10.4, 1.3 + 0.48 * len(agents)), dpi=160, layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    rng = np.random.default_rng(0)
    for axis, (key, label) in zip(axes, (("map_error", "map error (lower is better)"), ("coverage", "coverage"))):
        for row, agent in enumerate(agents):
            values, strata = values_of(records, agent, key)
            colour, middle = colour_of(agents, agent), estimate(values, strata)
            axis.scatter(
                values, row + rng.uniform(-0.17, 0.17, len(values)), s=9, color=colour, alpha=0.35, linewidths=0
            )
            axis.plot(
                [middle.low, middle.high], [row, row], color=colour, linewidth=6, alpha=0.9, solid_capstyle="round"
            )
            axis.plot(middle.estimate, row, "o", color="white", markersize=4.5, zorder=4)
        axis.set_xlabel(label)
        axis.grid(visible=False, axis="y")
    axes[1].xaxis.set_major_formatter(PercentFormatter(1.0))
    axes[1].xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axes[0].set_yticks(range(len(agents)), list(agents))
    axes[0].set_ylim(len(agents) - 0.5, -0.5)
    return as_png(figure)


def curves(records: Sequence[Record], agents: Sequence[str]) -> bytes:
    """Map error and coverage against ticks, with interval bands."""
    figure = Figure(figsize=(10.4, 3.9), dpi=160, layout="constrained")
    axes = figure.subplots(1, 2)
    end = max(record["ticks"] for record in records)
    grid = np.linspace(0.0, end, POINTS)
    for axis, (key, label) in zip(axes, (("map_error", "map error"), ("coverage", "coverage"))):
        for agent in agents:
            _band(axis, grid, _resampled(records, agent, key, grid), agent, colour_of(agents, agent))
        axis.set_xlabel("ticks")
        axis.set_ylabel(label)
        axis.set_xlim(0.0, end)
        axis.set_ylim(0.0, None)
    axes[1].yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=min(len(agents), 6), frameon=False
    )
    return as_png(figure)


def _resampled(records: Sequence[Record], agent: str, key: str, grid: NDArray[np.float64]) -> NDArray[np.float64]:
    """(episodes, points): each episode's curve at the same ticks; it stays where it was once the episode is over."""
    own = [record["curve"] for record in records if record["agent"] == agent]
    return np.array([np.interp(grid, curve["ticks"], curve[key]) for curve in own])


def _band(axis: Axes, grid: NDArray[np.float64], values: NDArray[np.float64], label: str, colour: str) -> None:
    estimates = [estimate(column, resamples=1000) for column in values.T]
    axis.plot(grid, [e.estimate for e in estimates], color=colour, linewidth=2.0, label=label)
    low, high = [e.low for e in estimates], [e.high for e in estimates]
    axis.fill_between(grid, low, high, color=colour, alpha=0.18, linewidth=0)


def as_png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()
