"""The figures of the reports, in one style and with one colour for each name."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from agents.evaluation.tables import Column, display_name, estimate_of
from slam_gym.metrics.statistics import Interval
from slam_gym.rendering.plot import plot_episode
from slam_gym.simulation.episode import Episode
from slam_gym.simulation.judged import CEILING
from slam_gym.types import SPURIOUS, Array

PALETTE = ("#8a97a6", "#e08e45", "#3f9b7b", "#2f6db5", "#b04a8b", "#c6a02c", "#6554a4", "#a4503e", "#4fb3bf", "#7a9a2e")
INK = "#1c2733"
WIDTH, DPI = 10.4, 160  # [inches] of a figure
MARKERS = "osD^vP*X"
CURVE_POINTS = 61

matplotlib.rcParams.update({
    "font.family": "DejaVu Sans", "font.size": 10, "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": "#9aa5b1", "axes.labelcolor": "#3c4856", "xtick.color": "#5d6b7a", "ytick.color": "#5d6b7a",
    "axes.grid": True, "grid.color": "#e6ebf0", "axes.axisbelow": True, "legend.frameon": False,
})  # fmt: skip


Colours = Mapping[str, str]
"""Name → colour, see `colours`."""
Frames = Mapping[str, pd.DataFrame]
"""Name → rows of results."""


def colours(names: Sequence[str]) -> Colours:
    """The colour of each name throughout a report; the ceiling has the colour of text."""
    return dict(zip((name for name in names if name != CEILING), cycle(PALETTE))) | {CEILING: INK}


def legible(name: str) -> str:
    """A name as plots show it: without mathematics, and never with a leading `_`, which would hide it in legends."""
    shown = display_name(name).replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown


def _figure(height: float) -> Figure:
    """An empty figure of `height` [inches]."""
    return Figure(figsize=(WIDTH, height), dpi=DPI, layout="constrained")


def _line(axis: Axes, x: Array, intervals: Iterable[Interval], name: str, colour: str, **marks: Any) -> None:
    """Draw estimates, with `marks`, and the band of their intervals; the ceiling is dashed, without marks."""
    middle, low, high = np.array([(value.estimate, value.low, value.high) for value in intervals]).T
    style: dict[str, Any] = {"linestyle": "--"} if name == CEILING else marks
    axis.plot(x, middle, **style, markersize=5, color=colour, linewidth=1.9, label=legible(name))
    axis.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)


# -- episodes ----------------------------------------------------------------------------------------------------------


def dot_chart(groups: Frames, shown: Sequence[Column], colour: Colours) -> Figure:
    """Every episode as a dot, with estimate and interval for each name; `groups` are the episodes by name."""
    figure, rng = _figure(1.3 + 0.42 * len(groups)), np.random.default_rng(0)
    axes = figure.subplots(1, len(shown), sharey=True)
    for axis, column in zip(axes, shown):
        for row, (name, own) in enumerate(groups.items()):
            values, middle = own[column.key], estimate_of(own, column.key)
            jitter = rng.uniform(-0.17, 0.17, len(own))
            axis.scatter(values, row + jitter, s=16, color=colour[name], alpha=0.5, linewidths=0)
            axis.plot([middle.low, middle.high], [row, row], color=colour[name], lw=3, solid_capstyle="round")
            axis.plot(middle.estimate, row, "o", color="white", markeredgecolor=colour[name], ms=4.5, zorder=4)
        axis.set_xlabel(column.title)
        axis.grid(visible=False, axis="y")
        times = pd.concat(own[column.key].dropna() for own in groups.values())
        if column.key == "microseconds" and len(times):  # whole decades
            ends = np.floor(np.log10(times.min())), np.ceil(np.log10(times.max()) + 1e-9)
            axis.set(xscale="log", xlim=np.power(10.0, ends))
            axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_yticks(range(len(groups)), [legible(name) for name in groups])
    axes[0].set_ylim(len(groups) - 0.5, -0.5)  # the first on top
    return figure


def curve_chart(groups: Frames, shown: Sequence[Column], colour: Colours) -> Figure:
    """Numbers against ticks, from the curves of the episodes, with interval bands."""
    figure = _figure(3.9)
    axes = figure.subplots(1, len(shown))
    end = max(own["ticks"].max() for own in groups.values())
    grid = np.linspace(0.0, end, CURVE_POINTS)
    for axis, column in zip(axes, shown):
        for (name, own), marker in zip(groups.items(), cycle(MARKERS)):
            curves = [json.loads(cell) for cell in own["curve"]]
            # after the end of an episode, its curve stays constant
            at_grid = pd.DataFrame([np.interp(grid, curve["ticks"], curve[column.key]) for curve in curves], own.index)
            frame = own[["setting", "episode"]].join(at_grid)
            bands = [estimate_of(frame, k, resamples=1000) for k in at_grid]
            _line(axis, grid, bands, name, colour[name], marker=marker, markevery=10, clip_on=False)
        axis.set(xlabel="ticks", ylabel=column.title, xlim=(0.0, end), ylim=(0.0, None))
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=min(len(groups), 6))
    return figure


def final_map(episode: Episode) -> Figure:
    """The final map of an episode: walls black, explored ones light blue, features grey, mapped features blue, the path
    red, and yellow lines from true features to their positions in the map."""
    figure = Figure(figsize=(5.2, 4.2), dpi=DPI, layout="constrained")
    axis = plot_episode(episode, figure.subplots(subplot_kw={"frameon": False}), errors=True)
    axis.set(xticks=[], yticks=[], xlabel="", ylabel="", title=f"map error {episode.map_error():.2f}")
    return figure


# -- the suite ---------------------------------------------------------------------------------------------------------


def capability_bars(scores: Mapping[str, Mapping[str, Interval]], colour: Colours) -> Figure:
    """A group of bars for each capability, with a bar and interval for each name; the ceiling is left out."""
    names = [name for name in scores if name != CEILING] or list(scores)
    estimates, low, high = (
        pd.DataFrame({name: {of: getattr(v, end) for of, v in scores[name].items()} for name in names})
        for end in ("estimate", "low", "high")
    )
    figure = _figure(4.2)
    axis = figure.subplots()
    errors = np.abs(np.stack([estimates - low, high - estimates], axis=1)).transpose(2, 1, 0)  # (names, 2, groups)
    style: dict[str, Any] = {"width": 0.84, "rot": 0, "legend": False, "ecolor": INK}
    estimates.rename(columns=legible).plot.bar(ax=axis, yerr=errors, color=[colour[n] for n in names], **style)
    axis.tick_params(axis="x", length=0)
    axis.grid(visible=False, axis="x")
    axis.set(ylim=(0.0, 1.02), ylabel="score (1 = no mistake)")
    figure.legend(loc="outside upper left", ncols=4)
    return figure


def level_chart(curves: Mapping[str, Mapping[float, Interval]], label: str, colour: Colours) -> Figure:
    """Score against the knob, with levels at equal distances and interval bands; `curves` are name → knob → score."""
    figure = _figure(3.5)
    axis, knobs = figure.subplots(), list(max(curves.values(), key=len))  # an unfinished curve has not all of them
    for (name, curve), marker in zip(curves.items(), cycle(MARKERS)):
        _line(axis, np.array([knobs.index(knob) for knob in curve]), curve.values(), name, colour[name], marker=marker)
    axis.set_xticks(range(len(knobs)), [f"{knob:g}" for knob in knobs])
    axis.set(xlabel=label, ylabel="score", ylim=(-0.02, 1.04))
    figure.legend(loc="outside right upper")
    return figure


# -- recordings --------------------------------------------------------------------------------------------------------


def maps(errors: Frames, features: Frames, reference: Array, landmarks: Array, colour: Colours) -> Figure:
    """One panel per associator, with its path over the reference, and its features by kind.

    `errors` and `features` are the files of each associator, see `agents.evaluation.mapped_log`; `reference` (R, 2) [m]
    are all positions of the reference, and `landmarks` (L, 2) [m] the true positions, if known.
    """
    drawn = [reference, *(own[["x", "y"]] for own in errors.values())]
    drawn += [own[["aligned_x", "aligned_y"]] for own in features.values()]
    low, high = _bounds(drawn, landmarks)
    shape = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.35, 1.8))  # height / width of a panel
    across = min(len(errors), 3)
    down = math.ceil(len(errors) / across)
    figure = _figure(0.9 + down * (0.3 + (WIDTH / across - 0.35) * shape))
    axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
    handles: dict[str, Any] = {}
    for axis, (name, error) in zip(axes, errors.items()):
        axis.plot(*reference.T, color="#d3dae1", linewidth=3.0, label="reference")
        axis.plot(error["x"], error["y"], color=colour[name], linewidth=0.9)
        _draw_features(axis, features[name], landmarks)
        axis.set_title(legible(name), fontsize=10, loc="left", color=colour[name])
        axis.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        handles = dict(zip(*reversed(axis.get_legend_handles_labels()))) | handles
    for axis in axes[max(len(errors) - across, 0) : len(errors)]:
        axis.tick_params(labelbottom=True)
    for axis in axes[len(errors) :]:
        axis.set_visible(False)
    figure.supxlabel("x [m]", fontsize=10)
    figure.supylabel("y [m]", fontsize=10)
    figure.legend(list(handles.values()), list(handles), loc="outside upper left", ncols=6)
    return figure


def _bounds(drawn: Iterable[Any], landmarks: Array) -> tuple[Array, Array]:
    """Corners of the axes, which contain the landmarks and all but the outermost of the points, since a GPS jumps."""
    ends = np.array([np.quantile(points, [0.003, 0.997], axis=0) for points in drawn if len(points)])
    low, high = np.vstack([ends[:, 0], landmarks]).min(axis=0), np.vstack([ends[:, 1], landmarks]).max(axis=0)
    room = 0.05 * (high - low).max() + 1e-9
    return low - room, high + room


def _draw_features(axis: Axes, features: pd.DataFrame, landmarks: Array) -> None:
    """Draw features as dots: the first of each landmark, duplicates, and features without a landmark."""
    shown = features[features["confirmed"] > 0]
    identity, first = shown["identity"], ~shown["identity"].duplicated()
    if len(landmarks):
        axis.plot(*landmarks.T, "+", color=INK, markersize=8, markeredgewidth=1.0, label="landmark of the reference")
    kinds = {
        "landmark": (first & (identity >= 0), "#2f6db5"),
        "duplicate": (~first & (identity >= 0), "#b0413e"),
        "from clutter": (identity == SPURIOUS, "#e0a35c"),
        "unlabelled": (identity < SPURIOUS, "#8a97a6"),
    }
    for label, (rows, colour) in kinds.items():
        if rows.any():
            chosen = shown[rows]
            axis.plot(chosen["aligned_x"], chosen["aligned_y"], ".", color=colour, markersize=4.5, label=label)


def errors_over_time(errors: Frames, colour: Colours) -> Figure:
    """Distance to the reference after alignment, over the time of the log."""
    figure = _figure(3.6)
    axis = figure.subplots()
    for (name, error), marker in zip(errors.items(), cycle(MARKERS)):
        look: dict[str, Any] = {"color": colour[name], "marker": marker, "markevery": 0.1, "markersize": 5}
        axis.plot(error["time"], error["error"], linewidth=1.1, label=legible(name), **look)
    every = np.concatenate([error["error"] for error in errors.values()])
    far = every.max() > 4.0 * np.quantile(every, 0.95)  # a reference that jumps, or an associator that got lost
    axis.set(yscale="log" if far else "linear", ylim=(0.5 * np.quantile(every, 0.05) + 1e-9 if far else 0.0, None))
    axis.set(xlabel="time [s]", ylabel="position error [m]")
    figure.legend(loc="outside upper left", ncols=4)
    return figure
