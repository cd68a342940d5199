"""Figures that several reports share, as PNG: one style, one colour a name."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, PercentFormatter

from agents.evaluation.records import Record
from agents.evaluation.tables import Sample, display_name, estimate, sample
from slam_gym.metrics.statistics import Interval
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Array

PALETTE = ("#8a97a6", "#e08e45", "#3f9b7b", "#2f6db5", "#b04a8b", "#c6a02c", "#6554a4", "#a4503e", "#4fb3bf")
INK = "#1c2733"
WIDTH, DPI = 10.4, 160  # [inches] of a figure
MARKERS = "osD^vP*X"
CURVE_POINTS = 61

matplotlib.rcParams.update({
    "font.family": "DejaVu Sans", "font.size": 10, "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": "#9aa5b1", "axes.labelcolor": "#3c4856", "xtick.color": "#5d6b7a", "ytick.color": "#5d6b7a",
    "axes.grid": True, "grid.color": "#e6ebf0", "axes.axisbelow": True,
})  # fmt: skip


def colours(names: Sequence[str]) -> dict[str, str]:
    """The colour of each name throughout a report; the ceiling is drawn in ink."""
    others = [name for name in names if name != CEILING]
    return {name: PALETTE[i % len(PALETTE)] for i, name in enumerate(others)} | {CEILING: INK}


def new_figure(height: float, width: float = WIDTH) -> Figure:
    """An empty figure of so many inches."""
    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def as_png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


class Panel(NamedTuple):
    """A number over episodes, and how its axis is scaled."""

    key: str  # in a record
    label: str
    scale: str = "linear"  # or "percent" or "log"


def dot_chart(groups: Mapping[str, Sequence[Record]], panels: Sequence[Panel]) -> bytes:
    """Every episode as a dot, with mean and interval of each name; `groups` are the records of each."""
    figure = new_figure(1.3 + 0.42 * len(groups))
    axes = figure.subplots(1, len(panels), sharey=True)
    rng, colour = np.random.default_rng(0), colours(list(groups))
    for axis, panel in zip(axes, panels):
        samples = {name: sample(records, panel.key) for name, records in groups.items()}
        for row, (name, found) in enumerate(samples.items()):
            _dots_with_interval(axis, row, found, colour[name], rng)
        _scale(axis, panel, np.concatenate([found.values for found in samples.values()]))
    name_rows(axes[0], list(groups))
    return as_png(figure)


def _dots_with_interval(axis: Axes, row: int, found: Sample, colour: str, rng: np.random.Generator) -> None:
    jitter = rng.uniform(-0.17, 0.17, len(found.values))
    if not np.isfinite(found.values).any():
        return
    middle = found.estimate
    axis.scatter(found.values, row + jitter, s=16, color=colour, alpha=0.5, linewidths=0)
    axis.plot([middle.low, middle.high], [row, row], color=colour, linewidth=3, solid_capstyle="round")
    axis.plot(middle.estimate, row, "o", color="white", markeredgecolor=colour, markersize=4.5, zorder=4)


def _scale(axis: Axes, panel: Panel, values: Array) -> None:
    axis.set_xlabel(panel.label)
    axis.grid(visible=False, axis="y")
    axis.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    if panel.scale == "percent":
        axis.xaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
        axis.set_xlim(right=min(axis.get_xlim()[1], 1.02))
    elif panel.scale == "log" and np.isfinite(values).any():
        axis.set_xscale("log")
        decades = np.log10([np.nanmin(values), np.nanmax(values)])
        axis.set_xlim(10.0 ** np.floor(decades[0]), 10.0 ** np.ceil(decades[1] + 1e-9))
        axis.xaxis.set_minor_formatter(NullFormatter())


def name_rows(axis: Axes, names: Sequence[str]) -> None:
    """One row a name, the first on top."""
    axis.set_yticks(range(len(names)), [display_name(name) for name in names])
    axis.set_ylim(len(names) - 0.5, -0.5)


def band(axis: Axes, x: Array, found: Sequence[Interval], name: str, names: Sequence[str], *, marked: bool) -> None:
    """A line of estimates with the band of their intervals; the ceiling is dashed."""
    colour, dashed = colours(names)[name], name == CEILING
    marker = MARKERS[list(names).index(name) % len(MARKERS)] if marked and not dashed else ""
    axis.plot(
        x, [value.estimate for value in found], "--" if dashed else "-", marker=marker, markersize=5, color=colour,
        linewidth=1.9, label=display_name(name),
    )  # fmt: skip
    low, high = [value.low for value in found], [value.high for value in found]
    axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)


def curve_chart(groups: Mapping[str, Sequence[Record]], panels: Sequence[Panel]) -> bytes:
    """Numbers against ticks, from the curves of the episodes, with interval bands."""
    figure = new_figure(3.9)
    axes = figure.subplots(1, len(panels))
    end = max(record["ticks"] for records in groups.values() for record in records)
    grid = np.linspace(0.0, end, CURVE_POINTS)
    for axis, panel in zip(axes, panels):
        for name, records in groups.items():
            at_grid = _resampled(records, panel.key, grid)
            found = [estimate(column, resamples=1000) for column in at_grid.T]
            band(axis, grid, found, name, list(groups), marked=False)
        axis.set_xlabel("ticks")
        axis.set_ylabel(panel.label)
        axis.set_xlim(0.0, end)
        axis.set_ylim(0.0, None)
        if panel.scale == "percent":
            axis.yaxis.set_major_formatter(PercentFormatter(1.0, decimals=0))
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=min(len(groups), 6), frameon=False)
    return as_png(figure)


def _resampled(records: Sequence[Record], key: str, grid: Array) -> Array:
    """(episodes, points): each episode's curve at the same ticks; it stays where it was once the episode is over."""
    return np.array([np.interp(grid, record["curve"]["ticks"], record["curve"][key]) for record in records])
