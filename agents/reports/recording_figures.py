"""The figures of a report about recordings, as PNG."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.evaluation.associators import short
from agents.reports.association_figures import colours
from agents.reports.figures import as_png
from slam_gym.types import NONE, Array

_REFERENCE, _DUPLICATE, _CLUTTER, _TRUE = "#aeb8c2", "#b0413e", "#e0a35c", "#1c2733"
Columns = Mapping[str, Array]


def maps(
    errors: Mapping[str, Columns], features: Mapping[str, Columns], landmarks: Array, names: Sequence[str]
) -> bytes:
    """One panel per associator: its path over the reference, and its features by what they are.

    `errors` and `features` hold the columns of the files of each run, all in the frame of the reference; `landmarks`
    (L, 2) are the true places, if known.
    """
    xy = [np.column_stack([c["x"], c["y"]]) for c in (*errors.values(), *features.values())]
    xy += [np.column_stack([c["reference_x"], c["reference_y"]]) for c in errors.values()]
    low, high = _bounds(np.concatenate(xy), landmarks)
    shape = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.35, 1.8))
    across = min(len(names), 2 if len(names) <= 4 and shape < 1.2 else 3 if shape < 1.2 else 4)
    down, width = math.ceil(len(names) / across), 10.4
    figure = Figure(
        figsize=(width, 0.6 + down * (0.3 + (width / across - 0.35) * shape)), dpi=150, layout="constrained"
    )
    axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
    colour = colours(names)
    for axis, name in zip(axes, names):
        error = errors[name]
        axis.plot(error["reference_x"], error["reference_y"], color=_REFERENCE, linewidth=2.2, label="reference")
        axis.plot(error["x"], error["y"], color=colour[name], linewidth=0.9)
        _features(axis, features[name], landmarks)
        axis.set_title(short(name), fontsize=10, loc="left", color=colour[name])
        axis.set_aspect("equal")
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    handles = {}
    for axis in axes[: len(names)]:
        for handle, label in zip(*axis.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    figure.legend(list(handles.values()), list(handles), loc="outside upper left", ncols=6, frameon=False)
    return as_png(figure)


def _bounds(points: Array, landmarks: Array) -> tuple[Array, Array]:
    """Corners of what is drawn: the landmarks, and all but the outermost of the rest, since a GPS jumps."""
    low, high = np.quantile(points, [0.003, 0.997], axis=0)
    if len(landmarks):
        low, high = np.minimum(low, landmarks.min(axis=0)), np.maximum(high, landmarks.max(axis=0))
    room = 0.05 * (high - low).max() + 1e-9
    return low - room, high + room


def _features(axis: Axes, features: Columns, landmarks: Array) -> None:
    """Dots: the first of each landmark, further ones of the same, and what no landmark is behind."""
    confirmed = features["confirmed"] > 0
    identity = features["identity"][confirmed].astype(int)
    x, y = features["x"][confirmed], features["y"][confirmed]
    first = np.zeros(len(identity), bool)
    first[np.unique(identity, return_index=True)[1]] = True
    if len(landmarks):
        axis.plot(*landmarks.T, "+", color=_TRUE, markersize=8, markeredgewidth=1.0, label="true landmark")
    kinds = (
        ("landmark", first & (identity >= 0), "#2f6db5"),
        ("duplicate", ~first & (identity >= 0), _DUPLICATE),
        ("from clutter", identity == NONE, _CLUTTER),
        ("unlabelled", identity < NONE, "#8a97a6"),
    )
    for label, rows, colour in kinds:
        if rows.any():
            axis.plot(x[rows], y[rows], ".", color=colour, markersize=4.5, label=label)


def errors_over_time(errors: Mapping[str, Columns], names: Sequence[str]) -> bytes:
    """Distance to the reference, aligned, over the time of the log."""
    figure = Figure(figsize=(10.4, 3.6), dpi=150, layout="constrained")
    axis, colour = figure.subplots(), colours(names)
    for name in names:
        axis.plot(errors[name]["time"], errors[name]["error"], color=colour[name], linewidth=1.1, label=short(name))
    every = np.concatenate([errors[name]["error"] for name in names])
    if every.max() > 4.0 * np.quantile(every, 0.95):  # a reference that jumps, or an associator that got lost
        axis.set_yscale("log")
        axis.set_ylim(bottom=0.5 * np.quantile(every, 0.05) + 1e-9)
        axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    else:
        axis.set_ylim(0.0, None)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("position error [m]")
    figure.legend(loc="outside upper left", ncols=4, frameon=False)
    return as_png(figure)
