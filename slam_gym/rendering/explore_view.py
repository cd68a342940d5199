"""Pictures of a running episode: what is true, what the robot believes, and what it has just decided."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slam_gym.geometry import compose
from slam_gym.rendering import side_panel as legend
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, pygame
from slam_gym.rendering.figures_panel import Figures
from slam_gym.rendering.window import Window
from slam_gym.types import Array, BoolArray, IntArray


@dataclass(frozen=True, eq=False)
class Frame:
    """Everything that a picture shows, in W unless said otherwise."""

    walls: Array  # (s, 4) [m] x1 y1 x2 y2
    features: Array  # (N, 2) [m] true
    kinds: IntArray  # (N,) 0 corner, 1 door jamb, 2 pillar
    furniture: Array  # (f, 5) x, y, length, width [m], heading [rad]
    people: Array  # (p, 3) x, y, radius [m]
    robot_radius: float  # [m]
    true_pose: Array  # (3,) [m, m, rad]
    true_trail: Array  # (t, 2) [m]
    pose: Array  # (3,) estimated
    pose_covariance: Array  # (3, 3)
    trail: Array  # (t, 2) [m] estimated
    landmarks: Array  # (n, 2) [m] the map
    landmark_covariances: Array  # (n, 2, 2) [m²]
    provisional: BoolArray  # (n,) seen once
    scan_points: Array  # (m, 2) [m] as measured from the estimated pose
    decisions: IntArray  # (m,) `metrics.association.Decision`
    paired_positions: Array  # (m, 2) [m] of the landmark that each was paired with, NaN if none
    path: Array  # (p, 2) [m] what the robot is about to follow
    goals: Array  # (g, 2) [m] on offer
    covisibility: IntArray | None = None  # (e, 2) pairs of landmarks seen together; None = not drawn
    cells: NDArray[np.uint8] | None = None  # (h, w) explored grid: 0 unknown, 1 free, 2 wall; None = not drawn
    cells_origin: Array | None = None  # (2,) [m] its lower left corner, in B
    cells_base: Array | None = None  # (3,) pose of B
    cells_resolution: float = 1.0  # [m] a cell
    title: str = ""
    panel: Figures = ()


class Renderer:
    """Draws frames of a plan with `bounds` (4,) [m] xmin ymin xmax ymax; these may be set anew at any time.

    In `rgb_array` mode needs no display; in `human` mode keeps a window that follows the clock at `fps`. Colours and
    legend are the same in both.
    """

    def __init__(
        self,
        mode: Literal["rgb_array", "human"],
        bounds: Array,
        size: tuple[int, int] = (960, 720),
        fps: float = 10.0,
    ) -> None:
        """Raises ValueError for an unknown mode or a picture too small to hold anything."""
        if min(size) < 240:
            raise ValueError(f"the picture must be at least 240 pixels wide and high, got {size}")
        self.bounds, self.size = bounds, size
        self._window = Window(mode, size, "slam_gym", fps)

    def draw(self, frame: Frame) -> NDArray[np.uint8] | None:
        """The picture (h, w, 3) of a frame; None in `human` mode, where it goes to the window."""
        layout = legend.arrange(self.size, self.bounds)
        picture = pygame.Surface(self.size, depth=32)
        picture.fill(symbols.PAPER)
        canvas = Canvas(layout.map_size, layout.low, layout.scale, symbols.UNKNOWN_CELL)
        draw_map(canvas, frame)
        picture.blit(canvas.picture(), (0, 0))
        legend.draw(picture, layout, frame.title, frame.panel, _shown(frame))
        return self._window.show(picture)

    def close(self) -> None:
        """Close the window, if there is one. May be called twice; drawing again opens it anew."""
        self._window.close()


def draw_map(canvas: Canvas, frame: Frame) -> None:
    """Layer upon layer: explored cells, uncertainties, the true world, the map, the robot and its decisions."""
    if frame.cells is not None and frame.cells_origin is not None and frame.cells_base is not None:
        corner = compose(frame.cells_base, np.array([*frame.cells_origin, 0.0]))
        colours = [symbols.UNKNOWN_CELL, symbols.FREE_CELL, symbols.WALL_CELL]
        canvas.cells(frame.cells, colours, corner, frame.cells_resolution)
    symbols.uncertainties(canvas, frame.landmarks, frame.landmark_covariances, frame.provisional)
    if frame.covisibility is not None:
        ends = frame.landmarks[frame.covisibility]
        canvas.segments(ends.reshape(-1, 4), symbols.COVISIBLE, 0.7)
    symbols.furniture(canvas, frame.furniture)
    canvas.segments(frame.walls, symbols.WALL, 1.6)
    canvas.polyline(frame.true_trail, symbols.TRAIL, 2.0)
    canvas.polyline(frame.trail, symbols.ESTIMATED_TRAIL, 1.2)
    symbols.plan(canvas, frame.pose[:2], frame.path, frame.goals)
    size = min(1.0, max(0.65, canvas.scale / 25.0))  # marks shrink on floors so large that they would crowd
    symbols.true_features(canvas, frame.features, frame.kinds, 3.0 * size)
    symbols.landmarks(canvas, frame.landmarks, frame.provisional, 2.3 * size)
    symbols.people(canvas, frame.people)
    canvas.ellipses(frame.pose[None, :2], frame.pose_covariance[None, :2, :2], None, symbols.MAPPED)
    symbols.decisions(canvas, frame.pose[:2], frame.scan_points, frame.paired_positions, frame.decisions)
    symbols.robot_body(canvas, frame.true_pose, frame.robot_radius)
    symbols.robot_estimate(canvas, frame.pose, frame.robot_radius)


def _shown(frame: Frame) -> frozenset[str]:
    """Entries of the legend that not every map has."""
    optional = {
        "covisibility": frame.covisibility is not None,
        "plan": len(frame.path) + len(frame.goals) > 0,
        "cells": frame.cells is not None,
        "people": len(frame.people) > 0,
        "furniture": len(frame.furniture) > 0,
    }
    return frozenset(name for name, present in optional.items() if present)
