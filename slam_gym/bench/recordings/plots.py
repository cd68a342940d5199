"""The picture of relocation on real data. The only module of that benchmark that needs matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slam_gym.bench.locality.acceptance import RULE, share
from slam_gym.bench.locality.plots import INK, STYLE
from slam_gym.bench.recordings.recordings import LEAST, SEARCHES, Attempt, outcome

COLOURS = dict(zip(SEARCHES, ("#2b6ca3", "#e0a030", "#3a8a5c")))
_NAMES = {"gcbb": "GCBB", "rs": "RS", "indexed": "feature index"}


def save(rows: list[Attempt], folder: Path) -> None:
    """Write answers.png."""
    style: Any = STYLE
    with matplotlib.rc_context(style):
        answers([row for row in rows if row.locality == "covisibility"]).savefig(folder / "answers.png")


def answers(rows: list[Attempt]) -> Figure:
    """Right inside, wrong inside and wrong outside, with 95 % intervals, by the number of pairings asked for."""
    kinds = sorted({(row.place, row.sizes) for row in rows}, key=lambda kind: (kind[0], not kind[1]))
    figure = Figure(figsize=(10.5, 0.7 + 2.1 * len(kinds)), layout="constrained")
    axes = figure.subplots(len(kinds), 3, sharex=True, sharey=True, squeeze=False)
    for line, (place, sizes) in zip(axes, kinds):
        group = [row for row in rows if (row.place, row.sizes) == (place, sizes)]
        for search in SEARCHES:
            found = [outcome([row for row in group if row.search == search], least) for least in LEAST]
            parts = (
                [(o.right, o.inside) for o in found],
                [(o.wrong, o.inside) for o in found],
                [(o.wrong_outside, o.outside) for o in found],
            )
            for ax, counts in zip(line, parts):
                _series(ax, search, counts)
        diameters = {True: ", diameters used", False: ", diameters unknown" if place.startswith("park") else ""}
        line[0].set_title(f"{place}{diameters[sizes]}")
    for ax, title in zip(axes[0], ("right, inside", "wrong, inside", "wrong, outside")):
        ax.annotate(title, (0.5, 1.0), (0, 22), "axes fraction", "offset points", ha="center", color=INK, size=11)
    for ax in axes[-1]:
        ax.set_xticks(range(len(LEAST)), ["rule" if k == RULE else str(k) for k in LEAST])
        ax.set_xlabel("least number of pairings")
    for ax in axes[:, 0]:
        ax.set_ylabel("share of scans")
    axes[0][0].set_ylim(-0.03, 1.03)
    axes[0][2].legend(loc="upper right")
    return figure


def _series(ax: Axes, search: str, counts: list[tuple[int, int]]) -> None:
    shift = 0.16 * (SEARCHES.index(search) - 1)
    for at, (count, total) in enumerate(counts):
        if total:
            interval = share(count, total)
            x = at + shift
            ax.plot([x, x], [interval.low, interval.high], color=COLOURS[search], linewidth=1.2)
            label = _NAMES[search] if at == 0 else None
            ax.plot(x, interval.estimate, "o", color=COLOURS[search], markersize=3.5, label=label)
