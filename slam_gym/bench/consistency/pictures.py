"""The picture of the benchmark of consistency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from slam_gym.bench.consistency.estimators import ASSOCIATORS, METHODS
from slam_gym.bench.figures import BLUE, GREEN, GREY, INK, RED, panels
from slam_gym.bench.records import Record, column, grouped
from slam_gym.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = dict(zip(METHODS, (RED, BLUE, INK, GREEN)))
_TITLES = {"ANEES": "ANEES of the pose", "final [m]": "final error [m]", "duplicates": "duplicates"}


def comparison(records: Sequence[Record]) -> Figure:
    """Every run a dot, the median a bar: by world, estimator and association."""
    worlds, rng = [key["world"] for key, _ in grouped(records, "world")], np.random.default_rng(0)
    size = (2.2 + 1.75 * len(worlds) * 1.2, 8.0)
    figure, axes = panels(len(_TITLES), len(ASSOCIATORS), size, sharex=True, sharey="row")
    for row, (name, title) in zip(axes, _TITLES.items()):
        for ax, associator in zip(row, ASSOCIATORS):
            for key, group in grouped([r for r in records if r["associator"] == associator], "world", "method"):
                _dots(ax, worlds.index(key["world"]), key["method"], column(group, name), rng)
            if name != "duplicates":
                ax.set_yscale("log")
            ax.set_xticks(range(len(worlds)), [world.replace(", ", "\n") for world in worlds])
            ax.tick_params(axis="x", length=0)
        row[0].set_ylabel(title, color=INK)
    for ax, associator in zip(axes[0], ASSOCIATORS):
        ax.axhline(1.0, color=GREY, linewidth=0.8, zorder=0)
        ax.set_title({"jcbb": "JCBB"}.get(associator, associator.replace("_", " ")))
    axes[0][1].legend(loc="upper right")
    return figure


def _dots(ax: Axes, world: int, method: str, values: Array, rng: np.random.Generator) -> None:
    """The runs of one method, beside those of the others."""
    x = world + 0.2 * (METHODS.index(method) - 1.5)
    jitter = rng.uniform(-0.06, 0.06, len(values))
    ax.plot(x + jitter, values, ".", color=COLOURS[method], alpha=0.45, markersize=4, linewidth=0)
    label = method if world == 0 else None
    ax.plot([x - 0.08, x + 0.08], 2 * [np.median(values)], color=COLOURS[method], lw=2.2, label=label)
