"""The figures of reports about associators, as PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from agents.evaluation.associators import CEILING, short, values
from agents.evaluation.results import Record, estimate
from agents.reports.figures import COLOURS, as_png
from slam_gym.metrics.statistics import Interval
from slam_gym.types import Array

_TRUTH = "#1c2733"
_MARKERS = "osD^vP*X"
_OUTCOMES = {"correct": "#3f9b7b", "silent": "#d5dbe2", "wrong": "#b0413e", "refused": "#3f9b7b", "invented": "#b0413e"}


def colours(names: Sequence[str]) -> dict[str, str]:
    """The colour of each name throughout a report; the truth is drawn in ink."""
    others = [name for name in names if name != CEILING]
    return {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(others)} | {CEILING: _TRUTH}


def capability_bars(numbers: Mapping[str, Mapping[str, Interval]], names: Sequence[str]) -> bytes:
    """One group of bars per capability, one bar per name with its interval; the ceiling is the line at 1."""
    names = [name for name in names if name != CEILING] or list(names)
    groups = list(numbers[names[0]])
    figure = Figure(figsize=(10.4, 4.2), dpi=160, layout="constrained")
    axis, colour, width = figure.subplots(), colours(names), 0.84 / len(names)
    for i, name in enumerate(names):
        x = np.arange(len(groups)) - 0.42 + (i + 0.5) * width
        found = [numbers[name][group] for group in groups]
        middle = np.nan_to_num([value.estimate for value in found])
        axis.bar(x, middle, 0.92 * width, color=colour[name], label=short(name))
        for at, value in zip(x, found):
            axis.plot([at, at], [value.low, value.high], color="#1c2733", linewidth=0.9, alpha=0.8)
    axis.set_xticks(range(len(groups)), groups)
    axis.tick_params(axis="x", length=0)
    axis.grid(visible=False, axis="x")
    axis.set_ylim(0.0, 1.02)
    axis.set_ylabel("score (1 = no mistake)")
    figure.legend(loc="outside upper left", ncols=4, frameon=False)
    return as_png(figure)


def radar(numbers: Mapping[str, Mapping[str, Interval]], names: Sequence[str]) -> bytes:
    """One axis per capability, one line per name."""
    groups = [group for group in numbers[names[0]] if group != "all"]
    figure = Figure(figsize=(7.4, 5.0), dpi=160, layout="constrained")
    axis, colour = figure.add_subplot(projection="polar"), colours(names)
    angles = np.linspace(0.0, 2.0 * np.pi, len(groups), endpoint=False)
    for i, name in enumerate(names):
        found = np.array([numbers[name][group].estimate for group in groups])
        line, marker = ("--", "") if name == CEILING else ("-", _MARKERS[i % len(_MARKERS)])
        axis.plot(
            np.append(angles, angles[0]), np.append(found, found[0]), line, marker=marker, markersize=4,
            color=colour[name], linewidth=1.6, label=short(name),
        )  # fmt: skip
    axis.set_theta_offset(np.pi / 2)  # type: ignore[attr-defined]
    axis.set_theta_direction(-1)  # type: ignore[attr-defined]
    axis.set_xticks(angles, groups)
    axis.tick_params(axis="x", pad=10)
    axis.set_ylim(0.0, 1.0)
    axis.set_yticks([0.25, 0.5, 0.75, 1.0], ["", "0.5", "", "1"])
    figure.legend(loc="outside right upper", frameon=False)
    return as_png(figure)


def sweep(curves: Mapping[str, tuple[Array, list[Interval]]], label: str, names: Sequence[str]) -> bytes:
    """Score against the knob, level by level at equal distances, with interval bands."""
    figure = Figure(figsize=(10.4, 3.5), dpi=160, layout="constrained")
    axis, colour = figure.subplots(), colours(names)
    for i, name in enumerate(names):
        if name not in curves:
            continue
        knobs, found = curves[name]
        x, dashed = np.arange(len(knobs)), name == CEILING
        middle = [value.estimate for value in found]
        axis.plot(
            x, middle, "--" if dashed else "-", marker="" if dashed else _MARKERS[i % len(_MARKERS)], markersize=5,
            color=colour[name], linewidth=1.9, label=short(name),
        )  # fmt: skip
        low, high = [value.low for value in found], [value.high for value in found]
        axis.fill_between(x, low, high, color=colour[name], alpha=0.13, linewidth=0)
        axis.set_xticks(x, [f"{knob:g}" for knob in knobs])
    axis.set_ylim(-0.02, 1.04)
    axis.set_xlabel(label)
    axis.set_ylabel("score")
    figure.legend(loc="outside right upper", frameon=False)
    return as_png(figure)


def outcomes(counts: Mapping[str, Mapping[str, int]], names: Sequence[str]) -> bytes:
    """What became of kidnappings inside and outside the map, as shares."""
    figure = Figure(figsize=(10.4, 1.5 + 0.4 * len(names)), dpi=160, layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    sides = (("inside the map", ("correct", "silent", "wrong")), ("in another building", ("refused", "invented")))
    for axis, (title, kinds) in zip(axes, sides):
        for row, name in enumerate(names):
            total, left = max(sum(counts[name][kind] for kind in kinds), 1), 0.0
            for kind in kinds:
                share = counts[name][kind] / total
                axis.barh(row, share, left=left, height=0.62, color=_OUTCOMES[kind])
                if share > 0.06:
                    ink = "#1c2733" if kind == "silent" else "white"
                    axis.text(left + share / 2, row, f"{share:.0%}", color=ink, fontsize=8, ha="center", va="center")
                left += share
        axis.set_title(title, fontsize=10, loc="left")
        axis.set_xlim(0.0, 1.0)
        axis.grid(visible=False)
        axis.set_xticks([])
        axis.spines[["left", "bottom"]].set_visible(False)
        axis.tick_params(axis="y", length=0)
    axes[0].set_yticks(range(len(names)), [short(name) for name in names])
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    return as_png(figure)


def drives_chart(records: Sequence[Record], names: Sequence[str]) -> bytes:
    """Every episode as a dot, with mean and interval of each associator."""
    panels = (("precision", "precision"), ("recall", "recall"), ("map_error", "map error"), ("microseconds", "µs/scan"))
    figure = Figure(figsize=(10.4, 1.3 + 0.36 * len(names)), dpi=160, layout="constrained")
    axes = figure.subplots(1, len(panels), sharey=True)
    rng, colour = np.random.default_rng(0), colours(names)
    for axis, (key, label) in zip(axes, panels):
        for row, name in enumerate(names):
            _interval(axis, row, *values(records, name, None, key), colour[name], rng)
        axis.set_xlabel(label)
        axis.grid(visible=False, axis="y")
        axis.xaxis.set_major_locator(MaxNLocator(4))
    times = values(records, names[0], None, "microseconds")[0]
    for name in names[1:]:
        times = np.append(times, values(records, name, None, "microseconds")[0])
    if np.isfinite(times).any():
        axes[-1].set_xscale("log")
        decades = np.log10([np.nanmin(times), np.nanmax(times)])
        axes[-1].set_xlim(10.0 ** np.floor(decades[0]), 10.0 ** np.ceil(decades[1] + 1e-9))
        axes[-1].xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_yticks(range(len(names)), [short(name) for name in names])
    axes[0].set_ylim(len(names) - 0.5, -0.5)
    return as_png(figure)


def _interval(axis: Axes, row: int, found: Array, strata: np.ndarray, colour: str, rng: np.random.Generator) -> None:
    jitter = rng.uniform(-0.17, 0.17, len(found))
    if not np.isfinite(found).any():
        return
    middle = estimate(found, strata)
    axis.scatter(found, row + jitter, s=8, color=colour, alpha=0.35, linewidths=0)
    axis.plot([middle.low, middle.high], [row, row], color=colour, linewidth=6, alpha=0.9, solid_capstyle="round")
    axis.plot(middle.estimate, row, "o", color="white", markersize=4.0, zorder=4)
