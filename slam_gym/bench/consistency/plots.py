"""The picture of the benchmark of consistency. The only module of it that needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from slam_gym.bench.consistency.runs import ASSOCIATORS, METHODS, Result
from slam_gym.bench.locality.plots import GREY, INK, STYLE

COLOURS = dict(zip(METHODS, ("#c8553d", "#2b6ca3", "#3a8a5c")))
_ROWS = (
    ("anees", "ANEES of the pose", True),
    ("final", "final error [m]", True),
    ("duplicates", "duplicates", False),
)
_NAMES = {"jcbb": "JCBB"}


def save(rows: list[Result], folder: Path) -> None:
    """Write consistency.png."""
    style: Any = STYLE
    with matplotlib.rc_context(style):
        figure(rows).savefig(folder / "consistency.png")


def figure(rows: list[Result]) -> Figure:
    """Every run a dot, the median a bar: by world, estimator and association."""
    worlds = list(dict.fromkeys(r.world for r in rows))
    drawn = Figure(figsize=(2.2 + 1.75 * len(worlds) * 1.2, 8.0), layout="constrained")
    axes = drawn.subplots(len(_ROWS), len(ASSOCIATORS), sharex=True, sharey="row", squeeze=False)
    rng = np.random.default_rng(0)
    for line, (name, title, logarithmic) in zip(axes, _ROWS):
        for ax, associator in zip(line, ASSOCIATORS):
            for at, world in enumerate(worlds):
                for k, method in enumerate(METHODS):
                    key = world, associator, method
                    values = [getattr(r, name) for r in rows if (r.world, r.associator, r.method) == key]
                    x = at + 0.26 * (k - 1)
                    jitter = rng.uniform(-0.07, 0.07, len(values))
                    label = method if at == 0 else None
                    ax.plot(x + jitter, values, ".", color=COLOURS[method], alpha=0.45, markersize=4, linewidth=0)
                    ax.plot([x - 0.1, x + 0.1], 2 * [np.median(values)], color=COLOURS[method], lw=2.2, label=label)
            if logarithmic:
                ax.set_yscale("log")
            if name == "anees":
                ax.axhline(1.0, color=GREY, linewidth=0.8, zorder=0)
                ax.set_title(_NAMES.get(associator, associator))
            ax.set_xticks(range(len(worlds)), [w.replace(", ", "\n") for w in worlds])
            ax.tick_params(axis="x", length=0)
        line[0].set_ylabel(title, color=INK)
    axes[0][1].legend(loc="upper right")
    return drawn
