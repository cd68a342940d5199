"""Maps, paths, scans and interpretation trees as matplotlib plots: `pip install 'slam_gym[agents]'` has matplotlib.

Every function draws into `ax`, by default a new one, and returns it. Lengths are in metres, in the frame of the data.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import count, cycle
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.association.compatibility import chi2_gate, individual
from slam_gym.association.prediction import Prediction
from slam_gym.association.tree import Node, Tree, branches, extend, root
from slam_gym.geometry import compose, transform
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.rendering.walls import wall_lines
from slam_gym.types import UNPAIRED, Array, Hypothesis, Scan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam_gym.simulation.episode import Episode

INK, GREY, LIGHT, BLUE, RED, GREEN, YELLOW = "#2f3640", "#b8bec6", "#8faad0", "#2b6ca3", "#c8553d", "#3a8a5c", "#e0a030"
Path = tuple[int, ...]  # the rows of a prediction that lead from the root of a tree to a node
_MOST_BRANCHES = 400  # in a tree that is still legible
_LEAP = 1.5  # [m] a trail is interrupted between points that are farther apart


def plot_map(stochastic_map: StochasticMap, ax: Axes | None = None, *, sigmas: float = 2.0, colour: str = BLUE) -> Axes:
    """Plot features with ellipses of `sigmas` standard deviations, provisional ones in grey, and the robot in red."""
    ax, m = _axes(ax), stochastic_map
    for chosen, drawn_in in ((~m.provisional, colour), (m.provisional, GREY)):
        ax.plot(*m.positions[chosen].T, "o", ms=3.0, mfc="none", mec=drawn_in, mew=0.9)
        _ellipses(ax, m.positions[chosen], m.covariances[chosen], drawn_in, sigmas)
    spread = sigmas * np.sqrt(np.diagonal(m.covariances, axis1=1, axis2=2))  # whole ellipses are shown
    ax.update_datalim(np.vstack([m.positions - spread, m.positions + spread]))
    x, y, heading = m.pose
    ax.plot(x, y, marker=(3, 0, np.degrees(heading) - 90.0), color=RED, ms=9)
    return ax


def plot_path(poses: ArrayLike, ax: Axes | None = None, **line: Any) -> Axes:
    """Plot poses (t, 3) or positions (t, 2) as a line; `**line` are arguments of `matplotlib.axes.Axes.plot`."""
    ax = _axes(ax)
    path = np.asarray(poses, np.float64)
    look: dict[str, Any] = {"color": RED, "lw": 1.0} | line
    ax.plot(path[:, 0], path[:, 1], **look)
    return ax


def plot_scan(
    scan: Scan,
    prediction: Prediction,
    hypothesis: Hypothesis | None = None,
    ax: Axes | None = None,
    *,
    right: Hypothesis | None = None,
) -> Axes:
    """Plot a scan in R: measurements as crosses, predicted features as circles with the gates of their individually
    compatible pairings, and the pairings of a hypothesis as arrows from feature to measurement.

    With the `right` hypothesis, right pairings are green, and wrong pairings red and dashed, with a bold cross.
    """
    ax = _axes(ax)
    candidates = individual(scan, prediction)
    rows = candidates.rows[candidates.slots]
    gates = prediction.covariances[rows] + scan.covariances[candidates.measured]
    _ellipses(ax, prediction.positions[rows], gates, GREY, float(np.sqrt(chi2_gate(2, prediction.confidence))))
    ax.plot(*prediction.positions.T, "o", mfc="white", color=INK, ms=4.5, mew=0.9)
    ax.plot(*scan.points.T, "x", color=INK, ms=6, mew=1.6, zorder=3)
    if hypothesis is not None:
        place = dict(zip(prediction.features.tolist(), prediction.positions))
        for i in np.flatnonzero(hypothesis.features != UNPAIRED):
            wrong = right is not None and hypothesis.features[i] != right.features[i]
            arrow: dict[str, Any] = {"arrowstyle": "-|>", "lw": 1.6, "shrinkA": 2.0, "shrinkB": 2.0}
            arrow |= {"color": RED if wrong else BLUE if right is None else GREEN, "ls": "--" if wrong else "-"}
            arrow |= {"connectionstyle": "arc3,rad=-0.35", "mutation_scale": 8.0}
            if wrong:
                ax.plot(*scan.points[i], "x", color=RED, ms=8, mew=2.8, zorder=4)
            ax.annotate("", scan.points[i], place[int(hypothesis.features[i])], arrowprops=arrow)
    return ax


def plot_tree(tree: Tree, answers: Mapping[str, Hypothesis] | None = None, ax: Axes | None = None) -> Axes:
    """Plot an interpretation tree, level by level from the root at the top. Branches that are not jointly compatible
    are dotted, and end there; the path of each of `answers` has a colour, and is dotted where it has left the tree.

    Raises ValueError where the tree has more than 400 branches.
    """
    legal: dict[Path, bool] = {}
    _grow(tree, root(tree), (), legal)
    row = dict(zip(tree.prediction.features.tolist(), range(len(tree.prediction.features)))) | {UNPAIRED: UNPAIRED}
    paths = {
        name: tuple(row[feature] for feature in answer.features[tree.candidates.measurements].tolist())
        for name, answer in (answers or {}).items()
    }
    for path in paths.values():
        legal |= {path[:k]: False for k in range(1, len(path) + 1) if path[:k] not in legal}
    place: dict[Path, float] = {}
    _lay_out((), legal, place, count())
    ax = _axes(ax, aspect="auto")

    def line(path: Path, colour: str, width: float) -> None:
        ends = [place[path[:-1]], place[path]], [1 - len(path), -len(path)]
        order = 1.0 if colour == GREY else 6.0 - width
        ax.plot(*ends, "-" if legal[path] else ":", color=colour, lw=width, zorder=order)

    for path, fits in legal.items():
        line(path, GREY, 0.8)
        ax.plot(place[path], -len(path), "o", ms=11, mfc="white", mec=GREY if fits else RED, mew=0.8, zorder=6)
        name = "*" if path[-1] == UNPAIRED else str(tree.prediction.features[path[-1]])
        ax.text(place[path], -len(path), name, ha="center", va="center", fontsize=7, color=INK, zorder=7)
    for k, ((name, path), colour) in enumerate(zip(paths.items(), cycle((RED, GREEN, BLUE, YELLOW, INK)))):
        for end in range(1, len(path) + 1):
            line(path[:end], colour, max(4.5 - 1.3 * k, 0.8))  # thinner ones above thicker ones
        ax.plot([], [], color=colour, lw=2.5, label=name)
    levels = [f"$z_{{{i}}}$" for i in tree.candidates.measurements.tolist()]
    ax.set(xticks=[], xlabel="", ylabel="measurement", yticks=-1 - np.arange(tree.levels), yticklabels=levels)
    ax.spines[:].set_visible(False)
    if paths:
        ax.legend(frameon=False)
    return ax


def _grow(tree: Tree, node: Node, path: Path, legal: dict[Path, bool]) -> None:
    """Add to `legal` whether each branch below `node` is jointly compatible, by its path."""
    if node.level == tree.levels:
        return
    if len(legal) > _MOST_BRANCHES:
        raise ValueError(f"the tree has more than {_MOST_BRANCHES} branches: take fewer of its measurements")
    offer = branches(tree, node)
    for row, fits in zip([*offer.rows.tolist(), UNPAIRED], [*offer.legal.tolist(), True]):
        legal[(*path, row)] = fits
        if fits:
            _grow(tree, extend(tree, node, row), (*path, row), legal)


def _lay_out(path: Path, legal: dict[Path, bool], place: dict[Path, float], leaves: Iterator[int]) -> float:
    """Set positions in `place`: leaves in the order of the search, parents above the middle of their children."""
    below = [_lay_out(other, legal, place, leaves) for other in legal if other[:-1] == path]
    place[path] = (below[0] + below[-1]) / 2.0 if below else float(next(leaves))
    return place[path]


def plot_error(poses: ArrayLike, truth: ArrayLike, ax: Axes | None = None, **line: Any) -> Axes:
    """Plot the distance [m] of poses (t, 2 or 3) from the true poses; `**line` are arguments of `Axes.plot`."""
    ax = _axes(ax, aspect="auto")
    error = np.hypot(*(np.asarray(poses, np.float64)[:, :2] - np.asarray(truth, np.float64)[:, :2]).T)
    ax.plot(error, **{"lw": 1.1} | line)
    ax.set(xlabel="step", ylabel="position error [m]")
    return ax


def plot_episode(episode: Episode, ax: Axes | None = None, *, errors: bool = False) -> Axes:
    """Plot an exploration in W: true walls in black, true features as grey dots, and the true path in grey; explored
    walls in light blue, mapped features in blue, and the estimated path in red.

    With `errors`, yellow lines lead from true features to their positions in the map.
    """
    ax, grid, plan, slam = _axes(ax), episode.grid, episode.site.plan, episode.slam
    from matplotlib.collections import LineCollection

    ax.set(xlabel=ax.get_xlabel() or "x [m]", ylabel=ax.get_ylabel() or "y [m]")
    points, lines = wall_lines(grid.cells, compose(episode.base, np.array([*grid.origin, 0.0])), grid.resolution)
    lines = np.concatenate([lines, np.tile(points, 2)])  # a cell without neighbours is a dot
    ax.add_collection(LineCollection([*lines.reshape(-1, 2, 2)], colors=LIGHT, linewidths=2.4, capstyle="round"))
    ax.plot(*plan.walls.reshape(-1, 2, 2).transpose(2, 1, 0), color=INK, lw=0.8)
    ax.plot(*plan.features.positions[episode.site.observable].T, ".", ms=3, color=GREY)
    ax.plot(*episode.landmarks.T, "o", ms=3.2, mfc="none", mec=BLUE, mew=0.9)
    if errors:
        sources, mapped = episode.identities.majority_of(slam.map.ids), transform(episode.base, slam.map.positions)
        known = (sources >= 0) & ~slam.map.provisional
        ends = np.stack([plan.features.positions[sources[known]], mapped[known]])
        ax.plot(*ends.transpose(2, 0, 1), color=YELLOW, lw=0.9)
    plot_path(trail(episode.poses), ax, color=GREY)
    return plot_path(transform(episode.base, trail(episode.estimates)), ax, lw=1.3)


def trail(poses: list[Array], most: int | None = None) -> Array:
    """Positions (t, 2) of poses, or of about `most` with the last; NaN in between where the robot was carried."""
    points = np.array([pose[:2] for pose in poses])
    leaps = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > _LEAP) + 1
    kept = np.arange(len(points))[:: -max(1, len(points) // (most or len(points)))][::-1]
    return np.insert(points[kept], np.unique(np.searchsorted(kept, leaps)), np.nan, axis=0)


def _axes(ax: Axes | None, aspect: Literal["equal", "auto"] = "equal") -> Axes:
    if ax is None:
        try:
            import matplotlib.pyplot as plt
        except ImportError as error:
            raise ImportError('plots need matplotlib: pip install "slam_gym[agents]"') from error
        ax = plt.subplots(layout="constrained")[1]
        ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect(aspect)
    return ax


def _ellipses(ax: Axes, centres: Array, covariances: Array, colour: str, scale: float) -> None:
    """Add ellipses of covariances (k, 2, 2) at `centres` (k, 2), `scale` standard deviations large."""
    from matplotlib.collections import EllipseCollection

    values, vectors = np.linalg.eigh(covariances)
    widths = 2.0 * scale * np.sqrt(np.maximum(values, 0.0))
    angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    look: dict[str, Any] = {"facecolors": colour + "18", "edgecolors": colour, "linewidths": 0.6}
    where: dict[str, Any] = {"units": "xy", "offsets": centres, "offset_transform": ax.transData}
    ax.add_collection(EllipseCollection(widths[:, 1], widths[:, 0], angles, **where, **look))
