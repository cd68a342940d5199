"""How benchmarks draw: one style, and the only place that needs matplotlib, which is optional."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slam_gym.bench.records import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, GREY = "#2f3640", "#b8bec6"
BLUE, GREEN, YELLOW, PURPLE, BROWN, RED = "#2b6ca3", "#3a8a5c", "#e0a030", "#7d5ba6", "#9c755f", "#c8553d"
_STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": GREY,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "savefig.dpi": 150,
}


def panels(rows: int, columns: int, size: tuple[float, float], **shared: Any) -> tuple[Figure, Any]:
    """A figure of `size` [inches] and its axes, an array (rows, columns) of `Axes`; `shared` as for `subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def legend_below(figure: Figure, ax: Axes) -> None:
    """One legend for all panels, that of `ax`, below them."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))


def proportions(ax: Axes, rows: Sequence[Record], name: str, *, shift: float, **style: Any) -> None:
    """Fractions `name` of rows with their 95 % intervals, by what was `asked` for; the rule stands at the left end."""
    known = [(at + shift, row[name]) for at, row in enumerate(rows) if isfinite(row[name].estimate)]
    if known:
        x, y = [at for at, _ in known], [interval.estimate for _, interval in known]
        bars = [[i.estimate - i.low for _, i in known], [i.high - i.estimate for _, i in known]]
        ax.errorbar(x, y, bars, ms=4, lw=1.0, capsize=1.5, **{"ls": "", **style})
        ax.plot(x[1:], y[1:], color=style["color"], lw=1.4)
    ax.set_xticks(range(len(rows)), [row["asked"].removeprefix(">= ") for row in rows])


def save(folder: Path, drawings: Mapping[str, Callable[[], Figure]]) -> bool:
    """Draw each figure and write it as NAME.png. False, and nothing is drawn, where matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        return False
    import matplotlib

    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context(_STYLE):
        for name, draw in drawings.items():
            draw().savefig(folder / f"{name}.png")
    return True
