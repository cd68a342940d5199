"""Draw the plots of the pages of results from the tables beside them: `python docs/results/plots.py`.

Each plot is drawn twice, for a light and for a dark page (`NAME-light.svg`, `NAME-dark.svg`).
"""

from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

MINUTES = 8.0  # of a core that a million decisions of training take
FOLDER = Path(__file__).parent
WIDTH = 7.2  # [in], so that 10 pt are 13 px on the page
THEMES = {
    "light": {"ink": "#2f3640", "grid": "#d5d9de", "grey": "#8a929c", "blue": "#2b6ca3", "red": "#c8553d"},
    "dark": {"ink": "#e3e6ec", "grid": "#4a5060", "grey": "#9aa3b0", "blue": "#6fb1e8", "red": "#f0876f"},
}
NAMES = {
    "nearest_neighbour": "nearest neighbour", "global_nearest_neighbour": "global nearest neighbour",
    "singles": "SINGLES", "one_point_ransac": "1-point RANSAC", "jcbb": "JCBB", "ipjc": "IPJC",
    "true_association": "true association", "map_hypothesis": "MAP hypothesis",
    "nearest_frontier": "nearest frontier", "information_gain": "information gain", "lawnmower": "lawn-mower",
}  # fmt: skip


def table(name: str) -> pd.DataFrame:
    return pd.read_csv(FOLDER / f"{name}.csv")


def named(names: pd.Series) -> list[str]:
    return [NAMES.get(name, name) for name in names]


def rows(axes: Axes, labels: list[str]) -> np.ndarray:
    """One row for each label, the first on top: their heights."""
    heights = np.arange(len(labels))[::-1]
    axes.set_yticks(heights, labels)
    axes.set_ylim(-0.6, len(labels) - 0.4)
    axes.grid(axis="x")
    return heights


def intervals(axes: Axes, data: pd.DataFrame, value: str, heights: np.ndarray, colour: str, **options: object) -> None:
    """A dot and its 95 % interval (columns `low`, `high`) in each row."""
    errors = np.abs(data[["low", "high"]].to_numpy().T - data[value].to_numpy())
    axes.errorbar(data[value], heights, xerr=errors, fmt="o", color=colour, markersize=5, linewidth=1.8, **options)


def associators(theme: dict[str, str]) -> Figure:
    suite, drift = table("suite"), table("drift").query("relocation == 'gcbb'").set_index("associator")
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH, 3.4), sharey=True)
    heights = rows(left, named(suite.associator))
    intervals(left, suite, "score", heights, theme["blue"])
    left.set(title="One scan: score in the suite", xlabel="0: refuses all, 1: the truth", xlim=(0, 1.04))
    right.grid(axis="x")
    right.plot(drift["mean"][suite.associator], heights, "o", color=theme["red"], markersize=5)
    right.set(title="A drive: mean map error", xlabel="0: perfect, 1: an empty map", xlim=(0.4, 1.04))
    return figure


def relocation(theme: dict[str, str]) -> Figure:
    lost = table("drift").pivot(index="associator", columns="relocation", values="lost").sort_values("none")
    figure, axes = plt.subplots(figsize=(WIDTH, 3.4))
    heights = rows(axes, named(lost.index.to_series()))
    axes.hlines(heights, lost["none"], lost["gcbb"], color=theme["grid"], linewidth=3, zorder=1)
    axes.plot(lost["none"], heights, "o", color=theme["grey"], label="without relocation")
    axes.plot(lost["gcbb"], heights, "o", color=theme["red"], label="with relocation and atlas")
    axes.set(xlabel="share of maps that are lost", xlim=(0, 0.75))
    axes.legend(loc="upper right")
    return figure


def cost(theme: dict[str, str]) -> Figure:
    step, locality = table("step"), table("locality").set_index("locality")
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH, 3.2))
    left.loglog(step.features, step.one_map, "o-", color=theme["red"], label="one map")
    left.loglog(step.features, step.local_maps, "o-", color=theme["blue"], label="local maps")
    left.set(title="Time of a SLAM step", xlabel="features in the map", ylabel="time (one map of 500 features: 1)")
    sizes = ["50", "800", "3200", "12800"]
    for name, colour in (("everything", "red"), ("two hops", "grey"), ("covisibility", "blue")):
        right.loglog([int(size) for size in sizes], locality.loc[name, sizes], "o-", color=theme[colour], label=name)
    right.set(title="Relocation with GCBB", xlabel="features in the map", ylabel="pairing tests a scan")
    for axes in (left, right):
        axes.legend()
        axes.grid()
    left.set_xticks([500, 1000, 2000, 5000], ["500", "1 000", "2 000", "5 000"])
    left.set_xticks([], minor=True)
    right.set_xticks([50, 800, 3200, 12800], ["50", "800", "3 200", "12 800"])
    right.set_xticks([], minor=True)
    return figure


def recordings(theme: dict[str, str]) -> Figure:
    data = table("recordings")
    park = data.query("recording == 'victoria_park --every 10'")
    order = ["nearest_neighbour", "jcbb", "ipjc", "map_hypothesis", "marginal", "learned", "true_association"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH, 3.2), sharey=True)
    heights = rows(left, [NAMES.get(name, name) for name in order])
    worst = park.groupby("associator").ate.last()[order]
    left.plot(worst, heights, "o", color=theme["blue"])
    left.set(title="Victoria Park, every tenth scan", xlabel="ATE [m]", xscale="log", xlim=(1, 50))
    left.set_xticks([1, 2, 5, 10, 20, 50], ["1", "2", "5", "10", "20", "50"])
    left.set_xticks([], minor=True)
    robots = data[data.recording.str.startswith("mrclam")]
    for name, height in zip(order, heights):
        ate = robots[robots.associator == name].ate
        right.plot(ate, [height] * len(ate), "o", color=theme["grey"], markersize=4)
        right.plot(ate.mean(), height, "|", color=theme["red"], markersize=16, markeredgewidth=3)
    right.set(title="MR.CLAM: robots and mean", xlabel="ATE [m]", xlim=(0, 2.05))
    right.grid(axis="x")
    return figure


def learned(theme: dict[str, str]) -> Figure:
    data = table("learned")
    associator = data.query("learned == 'associator' and against == 'marginal'")
    driver = data.query("learned == 'driver'").set_index("where")
    driver = driver.loc[["office", "aliased", "hall", "crowd", "drift-2", "drift-3", "all six"]].reset_index()
    figure, (left, right) = plt.subplots(1, 2, figsize=(WIDTH, 3.2))
    intervals(left, associator, "difference", rows(left, list(associator["where"])), theme["blue"])
    left.set(title="Associator", xlabel="score − that of marginal (better →)", xlim=(-0.05, 0.3))
    intervals(right, driver, "difference", rows(right, list(driver["where"])), theme["red"])
    right.set(title="Driver", xlabel="difference in map error (← better)", xlim=(-0.065, 0.03))
    for axes in (left, right):
        axes.axvline(0, color=theme["ink"], linewidth=1)
    return figure


def training(theme: dict[str, str]) -> Figure:
    data, colours = table("training"), {"true_association": "ink", "marginal": "blue", "learned": "grey", "jcbb": "ink"}
    figure, axes = plt.subplots(figsize=(WIDTH, 3.2))
    seeds = data[data.seed.notna()]
    for seed, own in seeds.groupby("seed"):
        label = "in training, three seeds" if seed == 0 else None
        axes.plot(own.decisions / 1e6, own.train_score.interpolate(), color=theme["red"], lw=1, label=label)
    greedy = seeds.dropna(subset="held_out_return").groupby("decisions").held_out_return.mean()
    label = "held-out worlds, greedy, seed 0"
    axes.plot(greedy.index / 1e6, greedy, "o", color=theme["red"], clip_on=False, label=label)
    clone = data[data.who == "clone"]
    axes.plot(clone.decisions / 1e6, clone.train_score, color=theme["blue"], lw=1, label="begun as a clone of marginal")
    for who, colour in colours.items():
        level = data[data.who == who].held_out_return.iloc[0]
        axes.axhline(level, color=theme[colour], linewidth=1, linestyle=":" if who == "true_association" else "--")
        # so that names do not overlap
        shift = {"true_association": 0.05, "marginal": -0.04, "learned": -0.04}.get(who, 0.0)
        axes.text(2.03, level + shift, NAMES.get(who, who), va="center")
    axes.set(xlabel="million decisions", ylabel="score or return (0: refuses all)")
    axes.set(xlim=(0, 2.0), ylim=(-1.1, 1.05))
    minutes = axes.secondary_xaxis("top", (lambda x: x * MINUTES, lambda x: x / MINUTES))
    minutes.set_xlabel("minutes of one core")
    axes.legend(loc="lower right")
    return figure


def drivers(theme: dict[str, str]) -> Figure:
    data = table("drivers")
    figure, axes = plt.subplots(figsize=(WIDTH, 3.4))
    heights = rows(axes, list(data.scenario.unique()))
    shown = {"random": "ink", "nearest_frontier": "grey", "lawnmower": "red", "information_gain": "blue"}
    for k, (driver, colour) in enumerate(shown.items()):
        label = NAMES.get(driver, driver)
        part = data[data.driver == driver]
        intervals(axes, part, "map_error", heights + 0.24 - 0.16 * k, theme[colour], label=label)
    axes.set(xlabel="map error (0: perfect, 1: an empty map)", xlim=(0.1, 0.56))
    axes.legend(loc="upper center", bbox_to_anchor=(0.42, 1.16), ncols=4, columnspacing=1.2, handletextpad=0.2)
    return figure


PLOTS: dict[str, Callable[[dict[str, str]], Figure]] = {
    plot.__name__: plot for plot in (associators, relocation, cost, recordings, learned, training, drivers)
}


def style(theme: dict[str, str]) -> dict[str, object]:
    ink = dict.fromkeys(("text.color", "axes.labelcolor", "xtick.color", "ytick.color"), theme["ink"])
    return ink | {
        "font.size": 10, "axes.titlesize": 10, "axes.titleweight": "bold", "axes.edgecolor": theme["grid"],
        "axes.spines.top": False, "axes.spines.right": False, "grid.color": theme["grid"], "grid.linewidth": 0.6,
        "axes.axisbelow": True, "legend.frameon": False, "ytick.left": False, "ytick.minor.left": False,
        "axes.facecolor": "none", "figure.facecolor": "none", "figure.constrained_layout.use": True,
        "svg.hashsalt": "slam_gym",
    }  # fmt: skip


def main() -> None:
    for background, theme in THEMES.items():
        with mpl.rc_context(style(theme)):
            for name, plot in PLOTS.items():
                figure = plot(theme)
                figure.savefig(FOLDER / f"{name}-{background}.svg", transparent=True, metadata={"Date": None})
                plt.close(figure)


if __name__ == "__main__":
    main()
