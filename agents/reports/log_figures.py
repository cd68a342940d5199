"""The figures of a report about recordings, as PNG."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from agents.evaluation.tables import display_name
from agents.reports.figures import INK, WIDTH, as_png, colours, new_figure
from slam_gym.types import SPURIOUS, Array

_REFERENCE, _LANDMARK, _DUPLICATE, _CLUTTER, _UNLABELLED = "#aeb8c2", "#2f6db5", "#b0413e", "#e0a35c", "#8a97a6"
Columns = Mapping[str, Array]
"""Those of a file, by name."""


def maps(errors: Mapping[str, Columns], features: Mapping[str, Columns], landmarks: Array) -> bytes:
    """One panel per associator: its path over the reference, and its features by what they are.

    `errors` and `features` hold the columns of the files of each associator, all in the frame of the reference;
    `landmarks` (L, 2) are the true places, if known.
    """
    names = list(errors)
    xy = [np.column_stack([c["x"], c["y"]]) for c in (*errors.values(), *features.values())]
    xy += [np.column_stack([c["reference_x"], c["reference_y"]]) for c in errors.values()]
    low, high = _bounds(np.concatenate(xy), landmarks)
    axes = _panels(names, float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.35, 1.8)))
    colour, handles = colours(names), {}
    for axis, name in zip(axes, names):
        error = errors[name]
        axis.plot(error["reference_x"], error["reference_y"], color=_REFERENCE, linewidth=2.2, label="reference")
        axis.plot(error["x"], error["y"], color=colour[name], linewidth=0.9)
        _draw_features(axis, features[name], landmarks)
        axis.set_title(display_name(name), fontsize=10, loc="left", color=colour[name])
        axis.set_aspect("equal")
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
        for handle, label in zip(*axis.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    figure = axes[0].get_figure(root=True)
    figure.legend(list(handles.values()), list(handles), loc="outside upper left", ncols=6, frameon=False)
    return as_png(figure)


def _panels(names: Sequence[str], shape: float) -> list[Axes]:
    """One of height / width `shape` a name, in rows."""
    across = min(len(names), 2 if len(names) <= 4 and shape < 1.2 else 3 if shape < 1.2 else 4)
    down = math.ceil(len(names) / across)
    figure = new_figure(0.9 + down * (0.3 + (WIDTH / across - 0.35) * shape))
    axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False).ravel()
    for axis in axes[len(names) :]:
        axis.set_visible(False)
    return list(axes[: len(names)])


def _bounds(points: Array, landmarks: Array) -> tuple[Array, Array]:
    """Corners of what is drawn: the landmarks, and all but the outermost of the rest, since a GPS jumps."""
    low, high = np.quantile(points, [0.003, 0.997], axis=0)
    if len(landmarks):
        low, high = np.minimum(low, landmarks.min(axis=0)), np.maximum(high, landmarks.max(axis=0))
    room = 0.05 * (high - low).max() + 1e-9
    return low - room, high + room


def _draw_features(axis: Axes, features: Columns, landmarks: Array) -> None:
    """Dots: the first of each landmark, further ones of the same, and what no landmark is behind."""
    confirmed = features["confirmed"] > 0
    identity = features["identity"][confirmed].astype(int)
    x, y = features["x"][confirmed], features["y"][confirmed]
    first = np.zeros(len(identity), bool)
    first[np.unique(identity, return_index=True)[1]] = True
    if len(landmarks):
        axis.plot(*landmarks.T, "+", color=INK, markersize=8, markeredgewidth=1.0, label="true landmark")
    kinds = (
        ("landmark", first & (identity >= 0), _LANDMARK),
        ("duplicate", ~first & (identity >= 0), _DUPLICATE),
        ("from clutter", identity == SPURIOUS, _CLUTTER),
        ("unlabelled", identity < SPURIOUS, _UNLABELLED),
    )
    for label, rows, colour in kinds:
        if rows.any():
            axis.plot(x[rows], y[rows], ".", color=colour, markersize=4.5, label=label)


def errors_over_time(errors: Mapping[str, Columns]) -> bytes:
    """Distance to the reference, aligned, over the time of the log."""
    figure = new_figure(3.6)
    axis, colour = figure.subplots(), colours(list(errors))
    for name, error in errors.items():
        axis.plot(error["time"], error["error"], color=colour[name], linewidth=1.1, label=display_name(name))
    every = np.concatenate([error["error"] for error in errors.values()])
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
