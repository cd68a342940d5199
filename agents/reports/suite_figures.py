"""The figures of the report on the association suite, as PNG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from agents.evaluation.tables import Rows, display_name
from agents.reports.figures import INK, MARKERS, as_png, band, colours, name_rows, new_figure
from agents.suite.numbers import LevelCurve
from slam_gym.simulation.judged import CEILING
from slam_gym.types import Array

_COLOURS = {"correct": "#3f9b7b", "silent": "#d5dbe2", "wrong": "#b0413e", "refused": "#3f9b7b", "invented": "#b0413e"}


def capability_bars(scores: Rows, names: Sequence[str]) -> bytes:
    """One group of bars per capability, one bar per name with its interval; the ceiling is the line at 1."""
    names = [name for name in names if name != CEILING] or list(names)
    groups = list(scores[names[0]])
    figure = new_figure(4.2)
    axis, colour, width = figure.subplots(), colours(names), 0.84 / len(names)
    for i, name in enumerate(names):
        x = np.arange(len(groups)) - 0.42 + (i + 0.5) * width
        found = [scores[name][group] for group in groups]
        middle = np.nan_to_num([value.estimate for value in found])
        axis.bar(x, middle, 0.92 * width, color=colour[name], label=display_name(name))
        axis.vlines(x, [value.low for value in found], [value.high for value in found], color=INK, lw=0.9, alpha=0.8)
    axis.set_xticks(range(len(groups)), groups)
    axis.tick_params(axis="x", length=0)
    axis.grid(visible=False, axis="x")
    axis.set_ylim(0.0, 1.02)
    axis.set_ylabel("score (1 = no mistake)")
    figure.legend(loc="outside upper left", ncols=4, frameon=False)
    return as_png(figure)


def reliability_chart(found: Mapping[str, Mapping[str, Array]]) -> bytes:
    """The rate at which decisions are right against what was predicted, on a scale of log-odds, one line per name."""
    figure = new_figure(4.2, width=6.4)
    axis, colour = figure.subplots(), colours(list(found))
    ticks = np.array([0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 0.999])
    axis.plot(_log_odds(ticks), _log_odds(ticks), "--", color=INK, linewidth=0.9)
    for i, (name, bins) in enumerate(found.items()):
        some = bins["decisions"] > 0
        x, y = _log_odds(bins["predicted"][some]), _log_odds(bins["right"][some])
        axis.plot(x, y, marker=MARKERS[i % len(MARKERS)], color=colour[name], label=display_name(name))
    for set_ticks in (axis.set_xticks, axis.set_yticks):
        set_ticks(_log_odds(ticks), [f"{tick:g}" for tick in ticks])
    axis.set_xlabel("mean probability of the decisions")
    axis.set_ylabel("rate right")
    figure.legend(loc="outside right upper", frameon=False)
    return as_png(figure)


def _log_odds(p: Array) -> Array:
    kept = np.clip(p, 1e-4, 1.0 - 1e-4)
    return np.log(kept / (1.0 - kept))


def radar(scores: Rows, names: Sequence[str]) -> bytes:
    """One axis per capability, one line per name."""
    groups = [group for group in scores[names[0]] if group != "all"]
    figure = new_figure(5.0, width=7.4)
    axis, colour = figure.add_subplot(projection="polar"), colours(names)
    angles = np.linspace(0.0, 2.0 * np.pi, len(groups), endpoint=False)
    for i, name in enumerate(names):
        found = np.array([scores[name][group].estimate for group in groups])
        line, marker = ("--", "") if name == CEILING else ("-", MARKERS[i % len(MARKERS)])
        axis.plot(
            np.append(angles, angles[0]), np.append(found, found[0]), line, marker=marker, markersize=4,
            color=colour[name], linewidth=1.6, label=display_name(name),
        )  # fmt: skip
    axis.set_theta_offset(np.pi / 2)  # type: ignore[attr-defined]
    axis.set_theta_direction(-1)  # type: ignore[attr-defined]
    axis.set_xticks(angles, groups)
    axis.tick_params(axis="x", pad=10)
    axis.set_ylim(0.0, 1.0)
    axis.set_yticks([0.25, 0.5, 0.75, 1.0], ["", "0.5", "", "1"])
    figure.legend(loc="outside right upper", frameon=False)
    return as_png(figure)


def level_chart(curves: Mapping[str, LevelCurve], label: str, names: Sequence[str]) -> bytes:
    """Score against the knob, level by level at equal distances, with interval bands."""
    figure = new_figure(3.5)
    axis = figure.subplots()
    for name in names:
        knobs, found = curves[name]
        band(axis, np.arange(len(knobs)), found, name, names, marked=True)
        axis.set_xticks(np.arange(len(knobs)), [f"{knob:g}" for knob in knobs])
    axis.set_ylim(-0.02, 1.04)
    axis.set_xlabel(label)
    axis.set_ylabel("score")
    figure.legend(loc="outside right upper", frameon=False)
    return as_png(figure)


def outcome_bars(rows: Rows) -> bytes:
    """What became of kidnappings inside and outside the map, as fractions."""
    figure = new_figure(1.5 + 0.4 * len(rows))
    axes = figure.subplots(1, 2, sharey=True)
    sides = (("inside the map", ("correct", "silent", "wrong")), ("in another building", ("refused", "invented")))
    for axis, (title, outcomes) in zip(axes, sides):
        counts = np.array([[row[outcome] for outcome in outcomes] for row in rows.values()], dtype=float)
        fractions = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
        left = np.zeros(len(rows))
        for outcome, fraction in zip(outcomes, fractions.T):
            bars = axis.barh(range(len(rows)), fraction, left=left, height=0.62, color=_COLOURS[outcome])
            texts = [f"{f:.0%}" if f > 0.06 else "" for f in fraction]
            axis.bar_label(bars, texts, label_type="center", color=INK if outcome == "silent" else "white", fontsize=8)
            left += fraction
        axis.set_title(title, fontsize=10, loc="left")
        axis.set_xlim(0.0, 1.0)
        axis.grid(visible=False)
        axis.set_xticks([])
        axis.spines[["left", "bottom"]].set_visible(False)
        axis.tick_params(axis="y", length=0)
    name_rows(axes[0], list(rows))
    return as_png(figure)
