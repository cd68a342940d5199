"""Maps, paths and scans as matplotlib plots, for notebooks and papers: `pip install 'slam_gym[agents]'` has matplotlib.

Every function draws into `ax`, by default a new one, and returns it. Lengths are metres in the frame of what is drawn.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from slam_gym.association.compatibility import chi2_gate, individual
from slam_gym.association.prediction import Prediction
from slam_gym.geometry import transform
from slam_gym.mapping.stochastic_map import StochasticMap
from slam_gym.navigation.explored_grid import WALL
from slam_gym.types import UNPAIRED, Array, Hypothesis, Scan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from slam_gym.simulation.episode import Episode

INK, GREY, LIGHT, BLUE, RED = "#2f3640", "#b8bec6", "#c3ccd6", "#2b6ca3", "#c8553d"


def plot_map(stochastic_map: StochasticMap, ax: Axes | None = None, *, sigmas: float = 2.0) -> Axes:
    """Features with the ellipses of so many standard deviations, provisional ones hollow and grey; the robot in red."""
    ax, m = _axes(ax), stochastic_map
    for chosen, colour in ((~m.provisional, BLUE), (m.provisional, GREY)):
        ax.plot(*m.positions[chosen].T, "o", ms=3.0, mfc="none", mec=colour, mew=0.9)
        _ellipses(ax, m.positions[chosen], m.covariances[chosen], colour, sigmas)
    x, y, heading = m.pose
    ax.plot(x, y, marker=(3, 0, np.degrees(heading) - 90.0), color=RED, ms=9)
    return ax


def plot_path(poses: ArrayLike, ax: Axes | None = None, **line: Any) -> Axes:
    """Poses (t, 3) or positions (t, 2) as a line; other arguments are those of `matplotlib.axes.Axes.plot`."""
    ax = _axes(ax)
    path = np.asarray(poses, np.float64)
    look: dict[str, Any] = {"color": RED, "lw": 1.0} | line
    ax.plot(path[:, 0], path[:, 1], **look)
    return ax


def plot_scan(scan: Scan, prediction: Prediction, hypothesis: Hypothesis | None = None, ax: Axes | None = None) -> Axes:
    """A scan in R: measurements as crosses, predicted features as circles with the gates of the pairings that are
    individually compatible, and the pairings of a hypothesis as arrows from feature to measurement."""
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
            arrow = {"arrowstyle": "-|>", "color": BLUE, "lw": 1.6, "shrinkA": 3.0, "shrinkB": 3.0}
            ax.annotate("", scan.points[i], place[int(hypothesis.features[i])], arrowprops=arrow)
    return ax


def plot_episode(episode: Episode, ax: Axes | None = None) -> Axes:
    """An exploration in W: true walls black, true features grey dots; what the robot made of them on top, explored
    walls light, features of its map blue, its path red beside the true one in grey."""
    ax, grid, plan = _axes(ax), episode.grid, episode.site.plan
    rows, columns = np.nonzero(grid.cells == WALL)
    cells = grid.origin + grid.resolution * (np.column_stack([columns, rows]) + 0.5)
    ax.plot(*transform(episode.base, cells).T, "s", ms=2.6, color=LIGHT, mew=0)
    ax.plot(*plan.walls.reshape(-1, 2, 2).transpose(2, 1, 0), color=INK, lw=0.8)
    ax.plot(*plan.features.positions[episode.site.observable].T, ".", ms=3, color=GREY)
    ax.plot(*episode.landmarks.T, "o", ms=3.2, mfc="none", mec=BLUE, mew=0.9)
    plot_path(np.array(episode.poses), ax, color=GREY)
    return plot_path(transform(episode.base, np.array(episode.estimates)[:, :2]), ax, lw=0.9)


def _axes(ax: Axes | None) -> Axes:
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
        ax.set(xlabel="x [m]", ylabel="y [m]")
    ax.set_aspect("equal")
    return ax


def _ellipses(ax: Axes, centres: Array, covariances: Array, colour: str, scale: float) -> None:
    """Ellipses of covariances (k, 2, 2), so many standard deviations large."""
    from matplotlib.collections import EllipseCollection

    values, vectors = np.linalg.eigh(covariances)
    widths = 2.0 * scale * np.sqrt(np.maximum(values, 0.0))
    angles = np.degrees(np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1]))
    look: dict[str, Any] = {"facecolors": colour + "18", "edgecolors": colour, "linewidths": 0.6}
    where: dict[str, Any] = {"units": "xy", "offsets": centres, "offset_transform": ax.transData}
    ax.add_collection(EllipseCollection(widths[:, 1], widths[:, 0], angles, **where, **look))
